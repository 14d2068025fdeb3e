/* The path from above, coloured by deviation: before, after, difference; own or common colour scale. */
(() => {
  const { linked, stock_mm: stock } = KR.data;
  const BUCKETS = 900;
  const first = linked.passes[0];
  const several = linked.passes.length > 1;
  const ids = several ? ["before", "after", "difference"] : ["before"];
  KR.shownPass = () => (several ? Number(KR.by("pass").value) : 0);
  KR.commonScale = () => document.querySelector("input[name=scale]:checked")?.value === "common";

  const minus = (a, b) => a.map((v, i) => v - b[i]);
  const valuesOf = (id) => {
    const after = linked.passes[KR.shownPass()];
    return id === "before" ? first.side : id === "after" ? after.side : minus(after.side, first.side);
  };

  /* Whether a deviation counts while the filter is on: the difference by that of the shown pass. */
  const tolerance = KR.data.tolerance_um[0];
  const filtered = () => Boolean(tolerance) && KR.by("beyond").checked;
  const isBeyond = (value) => Math.abs(value) > tolerance;
  /* [mm] of the path that is scored where it deviates by more than the tolerance. */
  const lengthBeyond = (values) => values.reduce((sum, v, i) => sum + (i && linked.scored[i] && isBeyond(v) ? linked.distance[i] - linked.distance[i - 1] : 0), 0);

  /* Stations that a map draws: where the tool cuts and is scored, the largest value of each bucket remains. */
  function chosen(values) {
    const rows = [...values.keys()].filter((i) => linked.scored[i] && Number.isFinite(values[i]));
    if (rows.length <= 2 * BUCKETS) return rows;
    const step = linked.distance[linked.distance.length - 1] / BUCKETS;
    const best = new Map();
    for (const i of rows) {
      const bucket = Math.floor(linked.distance[i] / step);
      best.set(bucket, KR.largest(values, [best.get(bucket) ?? i, i]));
    }
    return [...best.values()];
  }

  const cuts = [...linked.x.keys()].filter((i) => linked.cutting[i]);
  const ends = [linked.x, linked.y].map((at) => cuts.map((i) => at[i])).map((at) => [Math.min(...at), Math.max(...at)]);
  const sizes = ends.map(([from, to], k) => [to - from, stock[k + 3] - stock[k]]);
  /* A path that is small in its stock fills the map. */
  const small = cuts.length > 0 && Math.max(...sizes.map(([path]) => path)) < 0.5 * Math.max(...sizes.map(([, block]) => block));
  const [xs, ys] = ends.map((at, k) => (small ? at : [stock[k], stock[k + 3], ...at]));
  const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const room = (small ? 0.2 : 0.04) * Math.max(right - left, high - low);
  const [x0, x1, y0, y1] = [left - room, right + room, low - room, high + room];
  const flat = (y1 - y0) / (x1 - x0) < 0.45;

  function draw(id, values, all, limit) {
    const worst = KR.largest(values, all);
    const judged = id === "difference" ? valuesOf("after") : values;
    const rows = filtered() ? all.filter((i) => isBeyond(judged[i])) : all;
    const x = rows.map((i) => linked.x[i]);
    const y = rows.map((i) => linked.y[i]);
    const text = rows.map((i) => `${KR.num(values[i], 2)} µm<br>${KR.plain(linked.features[linked.feature[i]])}`
      + `${linked.line[i] ? `, line ${linked.line[i]}` : ""}, XP${linked.point[i]}`);
    const scale = KR.diverging();
    const traces = [
      { x: KR.cut(linked.x), y: KR.cut(linked.y), mode: "lines", hoverinfo: "skip", line: { color: KR.css("--soft"), width: 0.6 } },
      { x, y, text, customdata: rows, mode: "markers", hovertemplate: "%{text}<extra></extra>",
        marker: { size: 5.5, color: rows.map((i) => values[i]), colorscale: scale, cmin: -limit, cmax: limit,
                  colorbar: { orientation: "h", thickness: 10, yref: "container", y: 0, yanchor: "bottom", ypad: 4, outlinewidth: 0, len: 0.9, nticks: 6, tickangle: 0 } } },
      { x: worst < 0 ? [] : [linked.x[worst]], y: worst < 0 ? [] : [linked.y[worst]], mode: "markers+text",
        text: [`${KR.num(values[worst], 1)} µm`], textposition: "top center", hoverinfo: "skip", cliponaxis: false,
        textfont: { color: KR.css("--ink"), size: 12 },
        marker: { symbol: "triangle-up", size: 11, color: KR.css("--ink") } },
    ];
    const layout = KR.layout({
      showlegend: false, hovermode: "closest", margin: { l: 50, r: 12, t: 8, b: 96 },
      xaxis: KR.axis("x [mm]", { range: KR.zoom?.x ?? [x0, x1], constrain: "domain" }),
      yaxis: KR.axis("y [mm]", { range: KR.zoom?.y ?? [y0, y1], scaleanchor: "x", constrain: "domain" }),
      shapes: [
        { type: "rect", x0: stock[0], x1: stock[3], y0: stock[1], y1: stock[4], layer: "below",
          fillcolor: KR.css("--shade"), line: { color: KR.css("--line"), width: 1 } },
        { type: "circle", xsizemode: "pixel", ysizemode: "pixel", xanchor: 0, yanchor: 0, x0: -8, x1: 8, y0: -8, y1: 8,
          line: { color: KR.css("--accent"), width: 3 } },
      ],
    });
    const element = KR.by(`map_${id}`);
    const name = id === "before" ? first.name : linked.passes[KR.shownPass()].name;
    const title = id === "difference" ? `${name} minus ${first.name}` : name;
    const beyond = filtered() ? `, ${KR.num(lengthBeyond(judged), 1)} mm beyond ±${KR.num(tolerance, 0)} µm` : "";
    KR.by(`map_${id}_title`).textContent = `${title}: at most ${KR.num(Math.abs(values[worst]), 1)} µm${beyond}`;
    element.setAttribute("aria-label", `Tool path from above, deviation of ${title}; the largest is `
      + `${KR.num(values[worst], 1)} µm at x ${KR.num(linked.x[worst], 1)}, y ${KR.num(linked.y[worst], 1)} mm.`);
    return KR.draw(`map_${id}`, traces, layout, KR.zoomable);
  }

  function drawAll() {
    const all = ids.map((id) => valuesOf(id));
    const rows = all.map(chosen);
    const own = all.map((values, k) => Math.abs(values[KR.largest(values, rows[k])]) || 1);
    return Promise.all(ids.map((id, k) => draw(id, all[k], rows[k], KR.commonScale() ? Math.max(...own) : own[k])));
  }

  function mark(i) {
    for (const id of ids) {
      Plotly.relayout(KR.by(`map_${id}`), { "shapes[1].xanchor": linked.x[i], "shapes[1].yanchor": linked.y[i] });
    }
  }

  KR.startMaps = () => {
    KR.mapIds = ids.map((id) => `map_${id}`);
    KR.mapFrame = [x0, x1, y0, y1];
    if (!tolerance) KR.by("filter").remove();
    KR.by("beyond")?.addEventListener("change", () => { drawAll(); mark(KR.place); });
    if (flat) KR.by("maps").classList.add("flat", "one");
    if (!several) {
      KR.by("maps").classList.add("one");
      for (const id of ["map_after", "map_difference"]) KR.by(id).closest("figure").remove();
      KR.by("pass").closest("label").remove();
      KR.by("scale").remove();
    } else {
      KR.by("pass").options[0].remove();
      KR.by("pass").value = String(KR.data.best || 1);
      KR.by("pass").addEventListener("change", () => KR.redraw());
      KR.by("scale").addEventListener("change", () => { drawAll(); mark(KR.place); });
    }
    KR.pictures.push({ draw: drawAll, mark, zooms: "maps" });
    drawAll();
    for (const id of ids) KR.hoverable(`map_${id}`);
  };
})();
