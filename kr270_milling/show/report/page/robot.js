/* The robot with the solids of its URDF, in the posture that is commanded at the place. */
(() => {
  const { linked, robot } = KR.data;
  const BOX = { i: [0, 0, 4, 4, 0, 0, 2, 2, 0, 0, 1, 1], j: [3, 2, 7, 5, 5, 1, 7, 6, 6, 4, 7, 3], k: [1, 3, 6, 7, 4, 5, 3, 7, 2, 6, 5, 7] };
  const EYES = { robot: { x: 0.75, y: -1.25, z: 0.3 }, tool: { x: 0.75, y: -1.0, z: 0.4 } };
  let view = "robot";

  /* A frame in its parent; columns of the matrix one after the other, as DOMMatrix wants them. */
  const matrix = (r, p) => new DOMMatrix([0, 1, 2].flatMap((c) => [r[0][c], r[1][c], r[2][c], 0]).concat([...p, 1]));
  const apply = (m, [x, y, z]) => {
    const p = m.transformPoint({ x, y, z });
    return [p.x, p.y, p.z];
  };
  const columns = (points) => Object.fromEntries(["x", "y", "z"].map((axis, k) => [axis, points.map((p) => p[k])]));
  const degrees = (angle) => (angle * 180) / Math.PI;

  /* Joint positions at a time [s], joined by straight lines. */
  function jointsAt(time) {
    const at = robot.time;
    let k = 0;
    while (k < at.length - 2 && at[k + 1] < time) k++;
    const u = Math.max(0, Math.min(1, (time - at[k]) / (at[k + 1] - at[k] || 1)));
    return Array.from(robot.joints[k], (q, j) => q + u * (robot.joints[k + 1][j] - q));
  }

  /* Names of the joints in the order of their positions: links are listed parents first. */
  const names = robot.links.map((link) => link.joint).filter(Boolean);

  /* Where every link is at a time, in base_link. */
  function framesAt(time) {
    const joints = jointsAt(time);
    const result = [];
    for (const link of robot.links) {
      const own = matrix(link.rotation, link.xyz);
      const frame = link.parent < 0 ? own : result[link.parent].multiply(own);
      result.push(link.joint ? frame.rotateAxisAngle(...link.axis, degrees(joints[names.indexOf(link.joint)])) : frame);
    }
    return result;
  }
  KR.toolAt = (i) => apply(framesAt(linked.time[i])[robot.links.findIndex((link) => link.name === "tcp")], [0, 0, 0]);

  /* All solids of one colour as one mesh: [number of the link, mesh], vertices at a time, triangles. */
  const solids = (colour) => robot.links.flatMap((link, n) => link.meshes.filter((m) => m.colour === colour).map((m) => [n, m]));
  const vertices = (colour, placed) => columns(solids(colour).flatMap(([n, mesh]) => mesh.vertex.map((v) => apply(placed[n], v))));
  function triangles(colour) {
    let first = 0;
    const result = solids(colour).flatMap(([, mesh]) => {
      const shifted = mesh.triangle.map((t) => Array.from(t, (v) => first + v));
      first += mesh.vertex.length;
      return shifted;
    });
    const { x: i, y: j, z: k } = columns(result);
    return { i, j, k };
  }
  const colours = Object.keys(robot.colours).filter((c) => solids(c).length);

  const workpiece = matrix(robot.workpiece_rotation, robot.workpiece_xyz);
  const inBase = (i) => apply(workpiece, [linked.x[i] / 1e3, linked.y[i] / 1e3, linked.z[i] / 1e3]);
  function ranges() {
    const tip = inBase(KR.place);
    if (view === "tool") return tip.map((v) => [v - 0.32, v + 0.32]);
    const reach = Math.max(1.2, Math.hypot(tip[0], tip[1]) + 0.35);
    const radius = Math.hypot(tip[0], tip[1]) || 1;
    const middle = [(0.42 * reach * tip[0]) / radius, (0.42 * reach * tip[1]) / radius];
    const half = 0.68 * reach;
    return [[middle[0] - half, middle[0] + half], [middle[1] - half, middle[1] + half], [-0.02, 2 * half]];
  }

  function draw() {
    if (!KR.hasWebgl || !KR.by("robot").wanted) return null;
    const placed = framesAt(linked.time[KR.place]);
    const traces = colours.map((c) => ({ type: "mesh3d", ...vertices(c, placed), ...triangles(c), color: robot.colours[c],
      flatshading: true, hoverinfo: "skip", lighting: { ambient: 0.55, diffuse: 0.7, specular: 0.1 }, lightposition: { x: 2e3, y: -2e3, z: 4e3 } }));
    const path = [...linked.x.keys()].filter((i) => i % Math.max(1, Math.ceil(linked.x.length / 600)) === 0).map(inBase);
    traces.push(
      { type: "mesh3d", ...columns(robot.stock_corners), ...BOX, color: "#9fb4c7", opacity: 0.75, flatshading: true, hoverinfo: "skip" },
      { type: "scatter3d", mode: "lines", ...columns(path), line: { color: KR.css("--accent"), width: 3 }, hoverinfo: "skip" });
    const [x, y, z] = ranges();
    const axis = (range) => ({ range, title: { text: "" }, gridcolor: KR.css("--grid"), color: KR.css("--soft"),
                                      backgroundcolor: "rgba(0,0,0,0)", zeroline: false, nticks: 6, showticklabels: false, showspikes: false });
    const layout = KR.layout({
      showlegend: false, margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: view,
      scene: { xaxis: axis(x), yaxis: axis(y), zaxis: axis(z), aspectmode: "cube", camera: { eye: EYES[view] } },
    });
    return KR.draw("robot", traces, layout);
  }

  let last = 0;
  let later = null;
  function mark(i) {
    if (!KR.by("robot").drawn) return;
    const q = jointsAt(linked.time[i]).map((v) => KR.num(degrees(v), 2));
    KR.by("robot_caption").textContent = `${robot.name}, joints that are commanded in pass '${robot.pass_name}' `
      + `[deg]: ${q.join(", ")}. Solids are simple shapes, not the maker's.`;
    KR.by("robot").setAttribute("aria-label", KR.by("robot_caption").textContent);
    clearTimeout(later);
    if (!KR.seen("robot")) return;
    const wait = 80 - (performance.now() - last);
    if (wait > 0) { later = setTimeout(() => mark(KR.place), wait); return; }
    last = performance.now();
    const placed = framesAt(linked.time[i]);
    const moved = colours.map((c) => vertices(c, placed));
    Plotly.restyle("robot", { x: moved.map((m) => m.x), y: moved.map((m) => m.y), z: moved.map((m) => m.z) }, [...colours.keys()]);
  }

  KR.startRobot = () => {
    if (!KR.needsWebgl("robot")) return;
    KR.pictures.push({ draw, mark });
    KR.catchUp("robot", mark);
    for (const name of ["robot", "tool"]) {
      KR.by(`view_${name}`).addEventListener("click", () => { view = name; draw(); });
    }
    KR.whenSeen("robot", () => { KR.by("robot").wanted = true; draw(); mark(KR.place); });
  };
})();
