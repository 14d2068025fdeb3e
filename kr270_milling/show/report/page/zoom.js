/* One stretch of the path in all pictures: a zoom of the curves moves the maps, a zoom of a map moves the curves. */
(() => {
  const { linked } = KR.data;
  const ROOM = 1.15; // around the stretch
  const LEAST = 0.02; // share of the whole map that is shown at least
  let busy = false;
  KR.zoom = null; // or { first, last: stations; x, y: [mm] ranges of the maps }

  /* The frame of the maps that shows some stations, in the shape of the whole map. */
  function frameOf(stations) {
    const [x0, x1, y0, y1] = KR.mapFrame;
    const middle = (values) => [Math.min(...values), Math.max(...values)];
    const [x, y] = [linked.x, linked.y].map((at) => middle(stations.map((i) => at[i])));
    const share = Math.max(LEAST, ROOM * Math.max((x[1] - x[0]) / (x1 - x0), (y[1] - y[0]) / (y1 - y0)));
    const around = ([a, b], size) => [(a + b - size) / 2, (a + b + size) / 2];
    return { x: around(x, share * (x1 - x0)), y: around(y, share * (y1 - y0)) };
  }

  /* The stretch inside a frame that has the marked place; else the longest stretch. */
  function stretchIn(x, y) {
    const inside = (i) => linked.x[i] >= x[0] && linked.x[i] <= x[1] && linked.y[i] >= y[0] && linked.y[i] <= y[1];
    let [best, first] = [null, -1];
    for (let i = 0; i <= linked.x.length; i++) {
      const goes = i < linked.x.length && inside(i);
      if (goes && first < 0) first = i;
      if (goes || first < 0) continue;
      const here = first <= KR.place && KR.place < i;
      if (!best || here || (!best.here && i - first > best.last - best.first + 1)) best = { first, last: i - 1, here };
      if (here) break;
      first = -1;
    }
    return best && { first: Math.max(0, best.first - 1), last: Math.min(linked.x.length - 1, best.last + 1) };
  }

  async function show(zoom, source) {
    KR.zoom = zoom;
    busy = true;
    for (const picture of KR.pictures) if (picture.zooms && picture.zooms !== source) await picture.draw();
    KR.remark();
    busy = false;
  }
  function follow(id, change) {
    if (busy || !Object.keys(change).some((key) => /^[xy]axis/.test(key))) return;
    const { xaxis, yaxis } = KR.by(id)._fullLayout;
    if (id !== "series") {
      const stretch = stretchIn(xaxis.range, yaxis.range);
      if (stretch) show({ ...stretch, x: [...xaxis.range], y: [...yaxis.range] });
      return;
    }
    const [low, high] = xaxis.range;
    const stations = [...KR.horizontal().keys()].filter((i) => KR.horizontal()[i] >= low && KR.horizontal()[i] <= high);
    if (stations.length > 1) show({ first: stations[0], last: stations[stations.length - 1], ...frameOf(stations) }, id);
  }

  KR.startZoom = () => {
    for (const id of [...KR.mapIds, "series"]) {
      KR.by(id).on("plotly_relayout", (change) => follow(id, change));
      KR.by(id).on("plotly_doubleclick", () => { show(null); });
      // Plotly misses a double click whose second press a busy page handles late; the browser counts by the presses
      KR.by(id).addEventListener("mousedown", (event) => {
        if (event.detail !== 2 || !event.target.closest(".nsewdrag")) return;
        addEventListener("mouseup", () => { if (KR.zoom) show(null); }, { once: true });
      }, true);
    }
  };
})();
