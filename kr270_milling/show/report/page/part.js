/* The part as machined: its height as a surface coloured by the error, the walls, the tool path. */
(() => {
  const { linked, surface } = KR.data;
  const FLATTEST = 0.16; // share of the longer side that the height shows as
  const floats = (rows) => rows.map((row) => Array.from(row, (v) => (Number.isFinite(v) ? v : 0)));
  let here = -1;

  const largest = (pass) => Math.max(...[...pass.floor, pass.wall].map((row) => Math.abs(row[KR.largest(row)]) || 0)) || 1;
  function sizes() {
    const [x, y] = [surface.x, surface.y].map((at) => at[at.length - 1] - at[0]);
    const heights = surface.z.flatMap((row) => [...row]);
    const z = heights.reduce((a, b) => Math.max(a, b)) - heights.reduce((a, b) => Math.min(a, b));
    const longest = Math.max(x, y);
    const times = Math.max(1, Math.round((FLATTEST * longest) / Math.max(z, 1e-6)));
    return { x: x / longest, y: y / longest, z: (z * times) / longest, times, lift: 0.04 * z };
  }

  /* The tool path of a pass with its deviation drawn so many times too large, a little above the floor. */
  function displaced(pass, times, size) {
    const last = linked.x.length - 1;
    const along = (at, i) => at[Math.min(last, i + 1)] - at[Math.max(0, i - 1)];
    const mm = times * 1e-3;
    const [x, y] = [[linked.x, -1, linked.y], [linked.y, 1, linked.x]].map(([at, sign, other]) => KR.cut(at.map((v, i) =>
      v + sign * pass.side[i] * mm * (along(other, i) / (Math.hypot(along(linked.x, i), along(linked.y, i)) || 1)))));
    return { x, y, z: KR.cut(linked.z.map((v, i) => v + size.lift + (pass.height[i] * mm) / size.times)) };
  }
  /* How many times too large: the largest deviation is drawn as 5 % of the part. */
  function magnification(passes) {
    const most = Math.max(...passes.map((k) => Math.abs(linked.passes[k].side[KR.worst(k)]) || 0));
    const longest = Math.max(...[surface.x, surface.y].map((at) => at[at.length - 1] - at[0]));
    const times = (0.05 * longest) / (1e-3 * (most || 1));
    const ten = 10 ** Math.floor(Math.log10(times));
    return Math.max(1, Math.round(times / ten) * ten);
  }

  function draw() {
    if (!KR.hasWebgl || !KR.by("part").wanted) return null;
    const pass = surface.passes[KR.shownPass()];
    const limit = KR.commonScale() ? Math.max(...surface.passes.map(largest)) : largest(pass);
    const size = sizes();
    const scale = KR.diverging();
    const place = KR.by("part").clientWidth > 600 ? { len: 0.7, x: 1, xanchor: "right" }
      : { orientation: "h", len: 0.8, y: 0, yanchor: "bottom" };
    const narrow = "orientation" in place;
    const unit = narrow ? "" : " [mm]"; // else two titles lie on each other
    const eye = narrow ? 1.6 : 1.12; // farther away, so that no corner is cut off
    const traces = [
      { type: "surface", x: surface.x, y: surface.y, z: surface.z, surfacecolor: floats(pass.floor), cmin: -limit, cmax: limit,
        colorscale: scale, lighting: { ambient: 0.75, diffuse: 0.5, specular: 0.05 }, hoverinfo: "skip",
        colorbar: { thickness: 10, outlinewidth: 0, title: { text: "µm" }, ...place } },
      { type: "scatter3d", mode: "markers", x: surface.wall_x, y: surface.wall_y, z: surface.wall_z,
        marker: { size: 3, color: pass.wall, cmin: -limit, cmax: limit, colorscale: scale }, showlegend: false,
        text: Array.from(pass.wall, (v) => `wall ${KR.num(v, 1)} µm`), hovertemplate: "%{text}<extra></extra>" },
      { type: "scatter3d", mode: "lines", x: KR.cut(linked.x), y: KR.cut(linked.y), z: KR.cut(linked.z), name: "tool path",
        showlegend: false, hoverinfo: "skip", line: { color: KR.css("--soft"), width: 2 }, connectgaps: false },
      { type: "scatter3d", mode: "markers", x: [linked.x[KR.place]], y: [linked.y[KR.place]], z: [linked.z[KR.place]],
        showlegend: false, hoverinfo: "skip", marker: { size: 9, color: KR.css("--accent"), symbol: "diamond" } },
    ];
    here = 3;
    const shown = [...new Set([0, KR.shownPass()])];
    const times = magnification(shown);
    for (const k of shown) {
      traces.push({ type: "scatter3d", mode: "lines", name: KR.plain(linked.passes[k].name), hoverinfo: "skip", connectgaps: false,
        line: { color: KR.colour(k), width: 3 }, ...displaced(linked.passes[k], times, size) });
    }
    const axis = (title) => ({ title: { text: title }, gridcolor: KR.css("--grid"), color: KR.css("--soft"),
                               backgroundcolor: "rgba(0,0,0,0)", zeroline: false, nticks: narrow ? 3 : 5 });
    const layout = KR.layout({
      showlegend: true, legend: { orientation: "h", x: 0, y: 1, yanchor: "top", bgcolor: "rgba(0,0,0,0)" }, margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "keep",
      scene: { domain: { y: [narrow ? 0.14 : 0, 1] }, xaxis: axis(`x${unit}`), yaxis: axis(`y${unit}`), zaxis: { ...axis(`z${unit}`), nticks: narrow ? 2 : 3 }, aspectmode: "manual",
               aspectratio: { x: 1.35 * size.x, y: 1.35 * size.y, z: 1.35 * Math.max(size.z, 0.02) },
               camera: { eye: { x: -0.5 * eye, y: -0.9 * eye, z: 1.3 * eye }, center: { x: 0, y: 0, z: -0.12 } } },
    });
    KR.by("part_caption").textContent = `Pass '${pass.name}'. Colour: error of floors (surface) and walls (dots) that remain, `
      + `+ material left, \u2212 cut too deep; neutral: not machined or too near to a wall. Largest ${KR.num(largest(pass), 1)} µm. `
      + `Heights are drawn ${size.times} times too large. Lines: the tool path of ${shown.map((k) => `'${linked.passes[k].name}'`).join(" and ")}, `
      + `its deviation ${times} times too large; grey: as programmed. Diamond: the place of the tool tip.`;
    KR.by("part").setAttribute("aria-label", KR.by("part_caption").textContent);
    return KR.draw("part", traces, layout);
  }

  KR.startPart = () => {
    if (!KR.needsWebgl("part")) return;
    const mark = (i) => {
      if (here < 0 || !KR.seen("part")) return;
      Plotly.restyle("part", { x: [[linked.x[i]]], y: [[linked.y[i]]], z: [[linked.z[i]]] }, [here]);
    };
    KR.pictures.push({ draw, mark });
    KR.catchUp("part", mark);
    KR.by("scale")?.addEventListener("change", draw);
    KR.whenSeen("part", () => { KR.by("part").wanted = true; draw(); });
  };
})();
