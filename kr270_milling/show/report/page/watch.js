/* Events of the running graph into figures that grow, some times a second. */
(() => {
  const DRAW_MS = 150;
  const ROWS = [["side", "deviation to the left [µm]"], ["up", "deviation upwards [µm]"], ["force", "force [N]"]];
  const LEVELS = ["", "warning: ", "error: ", "silent: "]; // so that the colour is not needed
  const WAITING = "Connected. The page waits for the first pass: for messages on reference_trajectory, tool_pose and wrench. "
    + "'kr270_milling run CELL.yaml' in another terminal publishes them.";
  const passes = [];
  const waiting = [];
  const nodes = new Map();
  let largest = 0;
  KR.watch = { passes, samples: 0, ended: false };

  /* Ends of an axis, given and not left to the picture: it does not widen an axis that is tied to another one. */
  function span(values) {
    const [low, high] = values.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    const room = 5 + 0.04 * (high - low);
    return low <= high ? [low - room, high + room] : [-50, 50];
  }

  function drawMap() {
    const one = passes[passes.length - 1];
    const limit = one.side.reduce((m, v) => Math.max(m, Math.abs(v)), 0) || 1;
    const trace = { x: one.x, y: one.y, mode: "markers", hovertemplate: "%{text}<extra></extra>",
      text: one.side.map((v) => `${KR.num(v, 1)} µm`),
      marker: { size: 6, color: one.side, colorscale: KR.diverging(), cmin: -limit, cmax: limit,
                colorbar: { thickness: 10, outlinewidth: 0, len: 0.9 } } };
    const last = one.x.length - 1;
    const here = { x: last < 0 ? [] : [one.x[last]], y: last < 0 ? [] : [one.y[last]], mode: "markers", hoverinfo: "skip",
                   marker: { size: 15, symbol: "circle-open", color: KR.css("--accent"), line: { width: 3 } } };
    KR.draw("live_map", [trace, here], KR.layout({ showlegend: false, xaxis: KR.axis("x [mm]", { range: span(one.x), constrain: "domain" }), uirevision: "keep",
      yaxis: KR.axis("y [mm]", { range: span(one.y), scaleanchor: "x", constrain: "domain" }) }));
  }

  function drawSeries() {
    const traces = [];
    const layout = KR.layout({ margin: { l: 52, r: 14, t: 46, b: 44 }, annotations: [], uirevision: "keep",
      legend: { orientation: "h", x: 0, y: 1.07, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" },
      xaxis: KR.axis("time of the pass [s]", { anchor: "y3" }) });
    ROWS.forEach(([key, title], r) => {
      const axis = r ? r + 1 : "";
      const top = 1 - r * 0.345;
      layout[`yaxis${axis}`] = KR.axis("", { domain: [Math.max(0, top - 0.29), top], zeroline: true, zerolinecolor: KR.css("--soft") });
      layout.annotations.push({ text: `<b>${title}</b>`, showarrow: false, xref: "paper", yref: `y${axis} domain`, x: 0, y: 1,
                                xanchor: "left", yanchor: "bottom" });
      passes.forEach((one, k) => traces.push({ x: one.t, y: one[key], name: `pass ${one.number}`, legendgroup: k, showlegend: r === 0,
        yaxis: `y${axis}`, xaxis: "x", mode: "lines", line: { color: KR.colour(k), width: 1.4 },
        text: one[key].map((v) => KR.num(v, 2)), hovertemplate: "%{text}" }));
    });
    KR.draw("live_series", traces, layout);
  }

  function take(event) {
    if (event.kind === "pass") {
      passes.push({ number: event.number, duration: event.duration_s, t: [], x: [], y: [], side: [], up: [], force: [] });
      largest = 0;
      KR.by("now").textContent = `pass ${event.number} is running`;
    } else if (event.kind === "sample" && passes.length) {
      const one = passes[passes.length - 1];
      for (const key of ["t", "x", "y", "side", "up", "force"]) one[key].push(event[key]);
      largest = Math.max(largest, Math.abs(event.side));
      KR.watch.samples += 1;
      const of = one.duration ? ` of ${KR.num(one.duration, 2)}` : "";
      KR.by("time").textContent = `${one.number}, ${KR.num(event.t, 2)}${of} s`;
      KR.by("side").textContent = `${KR.num(event.side, 1)} µm`;
      KR.by("largest").textContent = `${KR.num(largest, 1)} µm`;
      KR.by("force").textContent = `${KR.num(event.force, 1)} N`;
    } else if (event.kind === "state") {
      if (!nodes.has(event.node)) {
        const item = document.createElement("li");
        item.append(document.createElement("b"), document.createElement("span"));
        item.firstChild.textContent = event.node;
        nodes.set(event.node, item);
        KR.by("nodes").append(item);
      }
      nodes.get(event.node).dataset.level = event.level;
      nodes.get(event.node).lastChild.textContent = LEVELS[event.level] + event.message;
    } else if (event.kind === "end") {
      KR.watch.ended = true;
      KR.by("now").textContent = "the graph is closed; what was seen stays here";
    }
  }

  function draw() {
    KR.by("figures").hidden = !passes.length; // empty axes would say nothing
    if (!passes.length) return;
    drawMap();
    drawSeries();
  }
  const source = new EventSource("/events");
  source.onmessage = (message) => {
    const event = JSON.parse(message.data);
    waiting.push(event);
    if (event.kind === "end") source.close(); // at once: the server is about to go
  };
  source.onopen = () => { if (!passes.length) KR.by("now").textContent = WAITING; };
  setInterval(() => {
    if (!waiting.length) return;
    for (const event of waiting.splice(0)) take(event);
    draw();
  }, DRAW_MS);
  KR.pictures.push({ draw });
  draw();
  document.documentElement.dataset.ready = "yes";
})();
