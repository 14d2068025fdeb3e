/* The other charts: curves on panels, drawn when they come on the screen. */
(() => {
  function trace(curve, n, chart) {
    const colour = KR.colour(curve.colour);
    const axis = KR.nth(n);
    const result = { x: curve.x, y: curve.y, name: KR.plain(curve.name), xaxis: `x${axis}`, yaxis: `y${axis}`, mode: "lines",
      legendgroup: curve.name, showlegend: curve.legend && chart.panels.some((p) => p.curves.length > 1),
      line: { color: colour, width: curve.look === "thin" ? 0.7 : 1.6, dash: curve.look === "dash" ? "dash" : "solid" },
      opacity: curve.look === "thin" ? 0.55 : 1, text: Array.from(curve.y, (v) => KR.num(v, 3)),
      hovertemplate: "%{text}", };
    if (curve.look === "points") Object.assign(result, { mode: "markers", marker: { color: colour, size: 5 } });
    if (curve.look === "area") Object.assign(result, { fill: "toself", fillcolor: KR.css("--shade"), hoverinfo: "skip", hovertemplate: undefined });
    if (curve.text) {
      const last = curve.x.length - 1;
      Object.assign(result, { mode: "lines+text", text: Array.from(curve.x, (_, i) => (i === last ? curve.text : "")),
        textposition: last ? "top center" : "middle center", hoverinfo: "skip", hovertemplate: undefined });
    }
    return result;
  }

  function marks(panel, n, shapes, annotations) {
    const [x, y] = [`x${KR.nth(n)}`, `y${KR.nth(n)}`];
    const grey = KR.css("--soft");
    const line = { color: grey, width: 1, dash: "dot" };
    const small = (more) => KR.note({ xanchor: "right", font: { size: 11, color: grey }, ...more });
    if (panel.title) annotations.push(KR.heading(panel.title, `${x} domain`, n));
    if (panel.shade) shapes.push(KR.area(...panel.shade, { xref: x, yref: `${y} domain` }));
    panel.uprights.forEach(([at, text], k) => {
      shapes.push({ type: "line", xref: x, yref: `${y} domain`, x0: at, x1: at, y0: 0, y1: 1, line });
      annotations.push(small({ text, xref: x, yref: `${y} domain`, x: panel.log ? Math.log10(at) : at, y: 1 - 0.08 * k, yanchor: "top" }));
    });
    for (const [at, text] of panel.levels) {
      shapes.push({ type: "line", xref: `${x} domain`, yref: y, x0: 0, x1: 1, y0: at, y1: at, line });
      if (text) annotations.push(small({ text: KR.plain(text).replace("-", "\u2212"), xref: `${x} domain`, yref: y, x: 1, y: at, yanchor: "bottom" }));
    }
  }

  function draw(chart) {
    const element = KR.by(`chart_${chart.name}`);
    const columns = element.clientWidth > 700 ? chart.columns : 1;
    const rows = Math.ceil(chart.panels.length / columns);
    element.style.height = `${chart.panels.some((p) => p.equal) ? 420 : 70 + 260 * rows}px`;
    const shapes = [];
    const annotations = [];
    const layout = KR.layout({ margin: { l: 64, r: 14, t: 52, b: 46 }, hovermode: "closest", shapes, annotations,
      legend: { orientation: "h", x: 0, y: 1 + 26 / (260 * rows), yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" } });
    const [gapX, gapY] = [0.1, rows > 1 ? 0.24 / rows + 0.04 : 0];
    const wide = (1 - gapX * (columns - 1)) / columns;
    const high = (1 - gapY * (rows - 1)) / rows;
    chart.panels.forEach((panel, n) => {
      const [row, column] = [Math.floor(n / columns), n % columns];
      const key = KR.nth(n);
      const ends = (range) => (range && panel.log ? range.map(Math.log10) : range ?? undefined);
      const top = 1 - row * (high + gapY);
      const kind = panel.log ? { type: "log", dtick: 1, exponentformat: "power", tickfont: { size: 10 } } : {};
      layout[`xaxis${key}`] = KR.axis(panel.x_label, { anchor: `y${key}`, range: ends(panel.x_range), ...kind, automargin: false,
        domain: [column * (wide + gapX), column * (wide + gapX) + wide], constrain: panel.equal ? "domain" : undefined });
      layout[`yaxis${key}`] = KR.axis(panel.y_label, { anchor: `x${key}`, range: ends(panel.y_range), ...kind, automargin: false,
        domain: [Math.max(0, top - high), top], scaleanchor: panel.equal ? `x${key}` : undefined, constrain: panel.equal ? "domain" : undefined });
      marks(panel, n, shapes, annotations);
    });
    return KR.draw(`chart_${chart.name}`, chart.panels.flatMap((p, n) => p.curves.map((c) => trace(c, n, chart))), layout);
  }

  KR.startCharts = () => {
    for (const chart of KR.data.charts) {
      const id = `chart_${chart.name}`;
      KR.pictures.push({ draw: () => KR.by(id).drawn && draw(chart) });
      KR.whenSeen(id, () => draw(chart));
    }
  };
})();
