"use strict";
/* Data, numbers in words, colours of the present theme: what every picture shares. */
const KR = {};
(() => {
  const KINDS = { f32: Float32Array, i32: Int32Array };

  /* Packed rows become typed arrays; two dimensions become an array of rows. */
  function unpack(value) {
    if (Array.isArray(value)) return value.map(unpack);
    if (value === null || typeof value !== "object") return value;
    const kind = "f32" in value ? "f32" : "i32" in value ? "i32" : null;
    if (!kind) return Object.fromEntries(Object.entries(value).map(([key, v]) => [key, unpack(v)]));
    const bytes = Uint8Array.from(atob(value[kind]), (c) => c.charCodeAt(0));
    const flat = new KINDS[kind](bytes.buffer);
    if (value.shape.length < 2) return flat;
    const [rows, columns] = value.shape;
    return Array.from({ length: rows }, (_, r) => flat.subarray(r * columns, (r + 1) * columns));
  }
  const element = document.getElementById("data");
  KR.data = element ? unpack(JSON.parse(element.textContent)) : {};

  KR.by = (id) => document.getElementById(id);
  KR.make = (tag, ...content) => {
    const element = document.createElement(tag);
    element.append(...content);
    return element;
  };
  KR.printing = false;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  KR.dark = () => dark.matches && !KR.printing;

  /* A number with a typographer's minus, never "-0"; a dash where there is none. */
  KR.num = (value, digits = 1) => {
    if (value === null || value === undefined || !Number.isFinite(value)) return "–";
    const text = value.toFixed(digits);
    return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "\u2212");
  };
  /* Plotly reads a few tags in texts; names from outside are shown letter by letter. */
  KR.plain = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

  /* Of the series, by number; of a scale about a neutral middle. The original pass has number 0. */
  const colours = JSON.parse(document.documentElement.dataset.colours);
  const theme = () => colours[KR.dark() ? "dark" : "light"];
  KR.colour = (k) => theme().series[k % theme().series.length];
  KR.diverging = () => theme().diverging;
  /* A colour or the scale of the light theme in the present one; any other value unchanged. */
  KR.themed = (value) => {
    if (Array.isArray(value)) return value[0]?.[1] === colours.light.diverging[0][1] ? KR.diverging() : value;
    const k = colours.light.series.indexOf(value);
    return k < 0 ? value : KR.colour(k);
  };

  KR.css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  KR.axis = (title, more = {}) => ({
    title: { text: title, standoff: 6, font: { size: 12 } }, gridcolor: KR.css("--grid"), zeroline: false,
    linecolor: KR.css("--line"), ticks: "outside", tickcolor: KR.css("--line"), automargin: true, ...more,
  });
  KR.layout = (more = {}) => ({
    colorway: theme().series, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", margin: { l: 56, r: 14, t: 12, b: 44 },
    font: { family: "system-ui, 'DejaVu Sans', Helvetica, Arial, sans-serif", size: 12, color: KR.css("--ink") },
    separators: ".", modebar: { bgcolor: "rgba(0,0,0,0)", color: KR.css("--soft"), activecolor: KR.css("--accent") },
    hoverlabel: { bgcolor: KR.css("--card"), bordercolor: KR.css("--line"), font: { color: KR.css("--ink") } },
    legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" }, ...more,
  });
  KR.config = { responsive: true, displaylogo: false, displayModeBar: matchMedia("(hover: none)").matches ? false : "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
                toImageButtonOptions: { format: "svg" } };

  KR.zoomable = { ...KR.config, doubleClick: false }; // zoom.js answers the double click

  /* Number of the n-th axis in plotly's names; texts and lines in a picture. */
  KR.nth = (n) => (n ? n + 1 : "");
  KR.note = (more) => ({ showarrow: false, ...more });
  KR.heading = (text, x, n) => KR.note({ text: `<b>${text}</b>`, xref: x, yref: `y${KR.nth(n)} domain`, x: 0, y: 1, xanchor: "left", yanchor: "bottom" });
  KR.area = (x0, x1, more) => ({ type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, layer: "below",
                                 fillcolor: KR.css("--shade"), line: { width: 0 }, ...more });
  /* The row with the largest magnitude; -1 where there is none. */
  KR.largest = (values, rows = values.keys()) => {
    let best = -1;
    for (const i of rows) if (Number.isFinite(values[i]) && !(Math.abs(values[i]) <= Math.abs(values[best]))) best = i;
    return best;
  };

  /* Every picture has draw(); those that show the place have mark(i) as well. */
  KR.pictures = [];
  KR.draw = (id, traces, layout, config = KR.config) => {
    const element = KR.by(id);
    element.drawn = true;
    return Plotly.react(element, traces, layout, config);
  };
  KR.redraw = () => {
    for (const picture of KR.pictures) picture.draw();
    if (KR.place !== undefined) KR.remark();
  };

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", KR.redraw);
  addEventListener("beforeprint", () => { KR.printing = true; KR.drawEverything?.(); KR.redraw(); });
  addEventListener("afterprint", () => { KR.printing = false; KR.redraw(); });

  KR.hasWebgl = Boolean(document.createElement("canvas").getContext("webgl"));
  KR.needsWebgl = (id) => {
    if (!KR.hasWebgl) KR.by(id).textContent = "This picture needs WebGL, which this browser does not offer.";
    return KR.hasWebgl;
  };
  /* Whether an element is on the screen, or nearly so. */
  KR.seen = (id) => {
    const box = KR.by(id).getBoundingClientRect();
    return box.bottom > -200 && box.top < innerHeight + 200;
  };
})();
