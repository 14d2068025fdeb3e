/* The figures of a study in the look of the report: its fonts, axes and colours. */
(() => {
  const plain = (value) => value !== null && typeof value === "object" && !ArrayBuffer.isView(value);
  /* A figure with the colours of the present theme. */
  function themed(value, key) {
    if (Array.isArray(value) && key !== "colorscale") return value.map((one) => themed(one));
    if (!plain(value) || Array.isArray(value)) return KR.themed(value);
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, themed(v, k)]));
  }

  const colorbar = { thickness: 10, outlinewidth: 0 };
  KR.by("missing").hidden = Boolean(window.Plotly);
  (window.Plotly ? KR.data.figures : []).forEach((figure, n) => {
    const id = `figure_${n}`;
    const draw = () => {
      const layout = KR.layout({ margin: { l: 60, r: 26, t: 30, b: 48 }, hovermode: "closest", ...themed(figure.layout) });
      for (const [key, { title, ...own }] of Object.entries(layout)) {
        if (/^[xy]axis/.test(key)) layout[key] = KR.axis(title?.text ?? "", { hoverformat: ".4~g", exponentformat: "none", ...own });
      }
      KR.by(id).style.height = `${layout.height}px`;
      return KR.draw(id, themed(figure.data).map((trace) => (trace.type === "heatmap" ? { colorbar, ...trace } : trace)), layout);
    };
    KR.pictures.push({ draw });
    draw();
  });
  document.documentElement.dataset.ready = "yes";
})();
