/* Deviation, force and correction over the way or the time, one row each, with tolerance and maxima. */
(() => {
  const { linked, engaged_s: engaged } = KR.data;
  const tolerance = { side: KR.data.tolerance_um[0], height: KR.data.tolerance_um[1] };
  const shown = (key, least) => linked.passes.some((p) => p[key].some((v, i) => linked.cutting[i] && Math.abs(v) > least));
  const ROWS = [
    { key: "side", name: "deviation_left_um", title: "deviation to the left [µm]", signed: true, gaps: true },
    { key: "height", name: "deviation_up_um", title: "deviation upwards [µm]", signed: true, gaps: true, least: 0.05 },
    { key: "force", name: "force_n", title: "force [N]", gaps: true },
    { key: "correction", name: "correction_left_um", title: "correction to the left [µm]", signed: true, least: 1e-3 },
    { key: "lift", name: "correction_up_um", title: "correction upwards [µm]", signed: true, least: 0.05 },
  ].filter((row) => row.least === undefined || shown(row.key, row.least));

  const along = () => document.querySelector("input[name=axis]:checked").value;
  const horizontal = () => (along() === "time" ? linked.time : linked.distance);

  function traces() {
    const at = Array.from(horizontal());
    const stations = Array.from(at, (_, i) => i);
    const result = [];
    ROWS.forEach((row, r) => {
      const axis = KR.nth(r);
      linked.passes.forEach((one, k) => {
        const values = one[row.key];
        const y = row.gaps ? KR.cut(values) : Array.from(values);
        result.push({ x: at, y, customdata: stations, name: r ? KR.plain(one.name) : `${KR.plain(one.name)}, at most ${KR.num(Math.abs(one.side[KR.worst(k)]), 1)} µm`, legendgroup: k, showlegend: r === 0,
          yaxis: `y${axis}`, xaxis: "x", mode: "lines", line: { color: KR.colour(k), width: row.key === "force" ? 0.8 : 1.4 },
          text: y.map((v) => KR.num(v, 2)), hovertemplate: "%{text}", connectgaps: false });
      });
    });
    result.push(...maxima(at));
    return result;
  }

  /* A value that would lie on another one is in the legend alone. */
  function maxima(at) {
    const span = at[at.length - 1] - at[0];
    const [low, high] = reach(ROWS[0]);
    const shown = [];
    return linked.passes.map((one, k) => {
      const i = KR.worst(k);
      const place = [(at[i] - at[0]) / span * KR.by("series").clientWidth, (one.side[i] - low) / (high - low) * 130];
      const free = shown.every(([x, y]) => Math.abs(x - place[0]) > 48 || Math.abs(y - place[1]) > 24);
      if (free) shown.push(place);
      return { x: [at[i]], y: [one.side[i]], customdata: [i], mode: "markers+text", xaxis: "x", yaxis: "y", showlegend: false,
        legendgroup: k, hoverinfo: "skip", marker: { color: KR.colour(k), size: 8, symbol: "circle-open", line: { width: 2 } },
        text: [free ? KR.num(one.side[i], 1) : ""], textposition: `${one.side[i] < 0 ? "bottom" : "top"} ${place[0] > KR.by("series").clientWidth - 120 ? "left" : "right"}`,
        textfont: { color: KR.colour(k), size: 11 }, cliponaxis: false };
    });
  }

  /* Stretches of one feature: [first station, last station, name]. */
  function stretches() {
    const result = [];
    let start = 0;
    for (let i = 1; i <= linked.feature.length; i++) {
      if (i === linked.feature.length || linked.feature[i] !== linked.feature[start]) {
        result.push([start, i - 1, linked.features[linked.feature[start]]]);
        start = i;
      }
    }
    return result;
  }

  function shapes(at) {
    const result = [{ type: "line", xref: "x", yref: "paper", x0: at[0], x1: at[0], y0: 0, y1: 1,
                     line: { color: KR.css("--accent"), width: 2 } }];
    if (KR.data.part) {
      stretches().forEach(([a, b], n) => { if (n % 2) result.push(KR.area(at[a], at[b])); });
    } else if (engaged < linked.time[linked.time.length - 1]) {
      result.push(KR.area(at[KR.stationAt(engaged)], at[at.length - 1]));
    }
    ROWS.forEach((row, r) => {
      for (const y of tolerance[row.key] ? [tolerance[row.key], -tolerance[row.key]] : []) {
        result.push({ type: "line", xref: "paper", yref: `y${KR.nth(r)}`, x0: 0, x1: 1, y0: y, y1: y,
                     line: { color: KR.css("--bad"), width: 1.5, dash: "dash" } });
      }
    });
    return result;
  }

  function annotations(at) {
    const result = ROWS.map((row, r) => KR.heading(row.title, "paper", r));
    ROWS.forEach((row, r) => {
      const y = tolerance[row.key];
      if (y) result.push(KR.note({ text: `tolerance ±${KR.num(y, 0)} µm`, xref: "paper", yref: `y${KR.nth(r)}`, x: 1, y,
                                  xanchor: "right", yanchor: "bottom", font: { color: KR.css("--bad"), size: 11 } }));
    });
    const span = at[at.length - 1] - at[0];
    const wide = KR.by("series").clientWidth;
    for (const [a, b, name] of KR.data.part ? stretches() : []) {
      if (((at[b] - at[a]) / span) * wide < 7 * name.length) continue;
      result.push(KR.note({ text: KR.plain(name), xref: "x", yref: "paper", x: (at[a] + at[b]) / 2, y: 0, yanchor: "bottom",
                           bgcolor: KR.css("--paper"), borderpad: 1, font: { size: 11, color: KR.css("--ink") } }));
    }
    return result;
  }

  /* Ends of a row's axis, with room for the marked values. */
  function reach(row) {
    const allowed = tolerance[row.key] ?? 0;
    let [low, high] = [-allowed, allowed];
    for (const one of linked.passes) {
      one[row.key].forEach((v, i) => { if (linked.cutting[i] || !row.gaps) [low, high] = [Math.min(low, v), Math.max(high, v)]; });
    }
    const room = (row.key === "side" ? 0.22 : 0.08) * (high - low || 1);
    return [row.signed ? low - room : 0, high + room];
  }

  function draw() {
    const at = horizontal();
    const gap = 0.055;
    const height = (1 - gap * (ROWS.length - 1)) / ROWS.length;
    const layout = KR.layout({
      hovermode: "x", margin: { l: 52, r: 14, t: 46, b: 44 }, shapes: shapes(at), annotations: annotations(at),
      xaxis: KR.axis(along() === "time" ? "time [s]" : "way along the path [mm]",
        { anchor: ROWS.length > 1 ? `y${ROWS.length}` : "y", range: KR.zoom ? [at[KR.zoom.first], at[KR.zoom.last]] : [at[0], at[at.length - 1]] }),
      legend: { orientation: "h", x: 0, y: 1.045, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" },
    });
    ROWS.forEach((row, r) => {
      const top = 1 - r * (height + gap);
      const [low, high] = reach(row);
      layout[`yaxis${KR.nth(r)}`] = KR.axis("", { domain: [Math.max(0, top - height), top], zeroline: Boolean(row.signed),
        zerolinecolor: KR.css("--soft"), zerolinewidth: 1, nticks: 6, range: [low, high] });
    });
    const sizes = linked.passes.map((p, k) => `${p.name} ${KR.num(Math.abs(p.side[KR.worst(k)]), 1)} µm`).join(", ");
    KR.by("series").setAttribute("aria-label", `Deviation, force and correction along the path; largest deviation: ${sizes}.`);
    return KR.draw("series", traces(), layout, KR.zoomable);
  }

  /* The stations on the screen of the passes that the legend shows; full series are in the CSV files of the passes. */
  function csv() {
    const hidden = new Set(KR.by("series").data.filter((t) => t.visible === "legendonly").map((t) => t.legendgroup));
    const passes = linked.passes.filter((_, k) => !hidden.has(k));
    const safe = (name) => name.replace(/[^\w-]+/g, "_").replace(/^-/, "_");
    const columns = [["time_s", linked.time], ["way_mm", linked.distance], ["x_mm", linked.x], ["y_mm", linked.y], ["z_mm", linked.z],
      ["line", linked.line], ["point", linked.point],
      ...passes.flatMap((one) => ROWS.map((row) => [`${safe(one.name)}_${row.name}`, one[row.key]]))];
    const [low, high] = KR.by("series")._fullLayout.xaxis.range;
    const rows = [...linked.time.keys()].filter((i) => horizontal()[i] >= low && horizontal()[i] <= high);
    const number = (v) => (Number.isFinite(v) ? String(Number(v.toPrecision(7))) : "");
    return [columns.map(([name]) => name), ...rows.map((i) => columns.map(([, values]) => number(values[i])))].map((row) => row.join(",")).join("\n") + "\n";
  }
  function download() {
    const link = Object.assign(KR.make("a"), { href: URL.createObjectURL(new Blob([csv()], { type: "text/csv" })), download: "series.csv" });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  }

  KR.startSeries = () => {
    KR.horizontal = horizontal;
    KR.by("csv").addEventListener("click", download);
    const picture = { draw, zooms: "series", mark: (i) => {
      const x = horizontal()[i];
      Plotly.relayout(KR.by("series"), { "shapes[0].x0": x, "shapes[0].x1": x });
    } };
    KR.pictures.push(picture);
    KR.by("series").style.height = `${Math.max(360, 175 * ROWS.length)}px`;
    draw();
    KR.hoverable("series");
    KR.by("axis").addEventListener("change", () => { draw(); picture.mark(KR.place); });
  };
})();
