/* The marked place: a station number, moved by pointer, slider, keys or play; every picture follows. */
(() => {
  const { linked } = KR.data;
  const count = linked.time.length;
  KR.place = 0;
  let waiting = false;
  let playing = null;
  const STEP_MS = 60;
  const ALL_S = 24; // of the play from one end to the other
  const ADDRESS_MS = 400; // of rest before the address follows: browsers limit how often it may change
  let address = null;

  function publish() {
    waiting = false;
    for (const picture of KR.pictures) picture.mark?.(KR.place);
    KR.by("slider").value = KR.place;
    KR.by("slider").setAttribute("aria-valuetext", words(KR.place));
    readout(KR.place);
  }
  KR.remark = publish;

  /* The place in the address of the page; a page inside another one has no address. */
  function writeAddress() {
    clearTimeout(address);
    if (location.protocol === "about:") return;
    address = setTimeout(() => {
      if (placeOfAddress() !== KR.place) history.replaceState(null, "", `#XP${linked.point[KR.place]}`);
    }, ADDRESS_MS);
  }
  function placeOfAddress() {
    const point = /^#XP(\d+)$/i.exec(location.hash)?.[1];
    return point === undefined ? undefined : KR.stationOfPoint(Number(point));
  }
  KR.openAddress = () => {
    const place = placeOfAddress();
    if (place === undefined) return;
    KR.go(place);
    KR.by("explore").scrollIntoView();
  };
  KR.go = (station) => {
    const place = Math.max(0, Math.min(count - 1, Math.round(station)));
    if (place === KR.place) return;
    KR.place = place;
    writeAddress();
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(publish);
  };

  function words(i) {
    const line = linked.line[i] ? `, line ${linked.line[i]}` : "";
    return `${linked.features[linked.feature[i]]}${line}, ${KR.num(linked.distance[i], 1)} mm`;
  }
  function readout(i) {
    const parts = [["", linked.features[linked.feature[i]]]];
    if (linked.line[i]) parts.push(["line", linked.line[i]]);
    parts.push(["point", `XP${linked.point[i]}`], ["t", `${KR.num(linked.time[i], 3)} s`],
      ["way", `${KR.num(linked.distance[i], 2)} mm`],
      ["x y z", `${KR.num(linked.x[i], 2)} ${KR.num(linked.y[i], 2)} ${KR.num(linked.z[i], 2)} mm`]);
    for (const one of linked.passes) {
      const correction = Math.abs(one.correction[i]) > 0.005 ? `, correction ${KR.num(one.correction[i], 1)} µm` : "";
      parts.push([one.name, `${KR.num(one.side[i], 2)} µm, ${KR.num(one.force[i], 1)} N${correction}`]);
    }
    KR.by("readout").replaceChildren(...parts.map(([label, value]) =>
      KR.make("span", KR.make("i", label ? `${label} ` : ""), KR.make("b", value))));
  }

  /* The station with the largest deviation of the pass that is looked at, where it counts. */
  const scored = [...linked.scored.keys()].filter((i) => linked.scored[i]);
  KR.worst = (pass) => Math.max(0, KR.largest(linked.passes[pass].side, scored));
  KR.stationAt = (time) => {
    const result = linked.time.findIndex((t) => t >= time);
    return result < 0 ? count - 1 : result;
  };
  /* Values where the tool cuts; null between two cuts, so that no line joins them. */
  KR.cut = (values) => Array.from(values, (v, i) => (linked.cutting[i] ? v : null));
  KR.stationOfPoint = (point) => {
    const result = linked.point.findIndex((p) => p >= point);
    return result < 0 ? count - 1 : result;
  };

  function play(on) {
    clearInterval(playing);
    playing = null;
    if (on) {
      if (KR.place >= count - 1) KR.go(0);
      const end = linked.time[count - 1];
      let [place, time, last] = [KR.place, linked.time[KR.place], performance.now()];
      playing = setInterval(() => {
        const now = performance.now();
        if (KR.place !== place) time = linked.time[KR.place]; // moved by hand
        time += (Number(KR.by("speed").value) || (end - linked.time[0]) / ALL_S) * (now - last) * 1e-3;
        last = now;
        KR.go(KR.stationAt(time));
        place = KR.place;
        if (place >= count - 1) play(false);
      }, STEP_MS);
    }
    KR.by("play").textContent = on ? "❚❚ pause" : "▶ play";
    KR.by("play").setAttribute("aria-pressed", String(on));
  }

  function onKey(event) {
    const inField = event.target.closest("input, select, textarea");
    if (event.ctrlKey || event.metaKey || event.altKey || inField) return;
    const step = event.shiftKey ? 10 : 1;
    const action = {
      ArrowRight: () => KR.go(KR.place + step), ArrowLeft: () => KR.go(KR.place - step),
      m: () => KR.go(KR.worst(KR.shownPass())), p: () => play(playing === null),
    }[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    action();
    event.preventDefault();
  }

  KR.startPlace = () => {
    const slider = KR.by("slider");
    slider.max = count - 1;
    slider.addEventListener("input", () => KR.go(Number(slider.value)));
    const clicks = { play: () => play(playing === null), back: () => KR.go(KR.place - 1), forth: () => KR.go(KR.place + 1),
                     worst: () => KR.go(KR.worst(KR.shownPass())) };
    for (const [id, action] of Object.entries(clicks)) KR.by(id).addEventListener("click", action);
    for (const button of document.querySelectorAll(".go")) {
      button.addEventListener("click", () => {
        KR.go(KR.stationOfPoint(Number(button.dataset.point)));
        KR.by("explore").scrollIntoView();
      });
    }
    document.addEventListener("keydown", onKey);
    addEventListener("hashchange", KR.openAddress);
  };
  KR.hoverable = (id) => {
    const element = KR.by(id);
    const follow = (event) => {
      const station = event.points.find((p) => p.customdata !== undefined)?.customdata;
      if (station !== undefined && playing === null) KR.go(station);
    };
    for (const event of ["plotly_hover", "plotly_click"]) element.on(event, follow);
  };
})();
