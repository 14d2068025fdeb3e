/* The robot with the solids of its URDF, in the posture that is commanded at the place. */
(() => {
  const { linked, robot } = KR.data;
  const BOX = { i: [0, 0, 4, 4, 0, 0, 2, 2, 0, 0, 1, 1], j: [3, 2, 7, 5, 5, 1, 7, 6, 6, 4, 7, 3], k: [1, 3, 6, 7, 4, 5, 3, 7, 2, 6, 5, 7] };
  const EYES = { robot: { x: 0.75, y: -1.25, z: 0.3 }, tool: { x: 0.75, y: -1.0, z: 0.4 } };
  let view = "robot";

  const times = (a, b) => a.map((row) => [0, 1, 2].map((c) => row[0] * b[0][c] + row[1] * b[1][c] + row[2] * b[2][c]));
  const apply = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
  const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];

  function turn(axis, angle) {
    const [x, y, z] = axis;
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    const d = 1 - c;
    return [[c + x * x * d, x * y * d - z * s, x * z * d + y * s], [y * x * d + z * s, c + y * y * d, y * z * d - x * s],
            [z * x * d - y * s, z * y * d + x * s, c + z * z * d]];
  }

  /* Joint positions at a time [s], joined by straight lines. */
  function jointsAt(time) {
    const at = robot.time;
    let k = 0;
    while (k < at.length - 2 && at[k + 1] < time) k++;
    const u = Math.max(0, Math.min(1, (time - at[k]) / (at[k + 1] - at[k] || 1)));
    return Array.from(robot.joints[k], (q, j) => q + u * (robot.joints[k + 1][j] - q));
  }

  /* Where every link is, in base_link: [{rotation, position}]. */
  function frames(joints) {
    const found = [];
    for (const link of robot.links) {
      let rotation = link.rotation;
      let position = link.xyz;
      if (link.parent >= 0) {
        const parent = found[link.parent];
        position = plus(parent.position, apply(parent.rotation, link.xyz));
        rotation = times(parent.rotation, link.rotation);
      }
      if (link.joint >= 0) rotation = times(rotation, turn(link.axis, joints[link.joint]));
      found.push({ rotation, position });
    }
    return found;
  }
  KR.toolAt = (i) => {
    const k = robot.links.findIndex((link) => link.name === "tool0");
    return frames(jointsAt(linked.time[i]))[k].position;
  };

  /* All solids of one colour as one mesh. */
  function vertices(colour, placed) {
    const found = { x: [], y: [], z: [] };
    robot.links.forEach((link, n) => {
      for (const mesh of link.meshes) {
        if (mesh.colour !== colour) continue;
        for (const v of mesh.vertex) {
          const p = plus(placed[n].position, apply(placed[n].rotation, v));
          found.x.push(p[0]); found.y.push(p[1]); found.z.push(p[2]);
        }
      }
    });
    return found;
  }
  function triangles(colour) {
    const found = { i: [], j: [], k: [] };
    let first = 0;
    for (const link of robot.links) {
      for (const mesh of link.meshes) {
        if (mesh.colour !== colour) continue;
        for (const t of mesh.triangle) { found.i.push(first + t[0]); found.j.push(first + t[1]); found.k.push(first + t[2]); }
        first += mesh.vertex.length;
      }
    }
    return found;
  }
  const colours = Object.keys(robot.colours).filter((c) => robot.links.some((l) => l.meshes.some((m) => m.colour === c)));

  function inBase(i) {
    return plus(robot.workpiece_xyz, apply(robot.workpiece_rotation, [linked.x[i] / 1e3, linked.y[i] / 1e3, linked.z[i] / 1e3]));
  }
  function ranges() {
    const tip = inBase(KR.place);
    if (view === "tool") return tip.map((v) => [v - 0.32, v + 0.32]);
    const reach = Math.max(1.2, Math.hypot(tip[0], tip[1]) + 0.35);
    const way = Math.hypot(tip[0], tip[1]) || 1;
    const middle = [(0.42 * reach * tip[0]) / way, (0.42 * reach * tip[1]) / way];
    const half = 0.68 * reach;
    return [[middle[0] - half, middle[0] + half], [middle[1] - half, middle[1] + half], [-0.02, 2 * half]];
  }

  function draw() {
    if (!KR.hasWebgl || !KR.by("robot").wanted) return null;
    const placed = frames(jointsAt(linked.time[KR.place]));
    const traces = colours.map((c) => ({ type: "mesh3d", ...vertices(c, placed), ...triangles(c), color: robot.colours[c],
      flatshading: true, hoverinfo: "skip", lighting: { ambient: 0.55, diffuse: 0.7, specular: 0.1 }, lightposition: { x: 2e3, y: -2e3, z: 4e3 } }));
    const corners = robot.stock_corners;
    const path = [...linked.x.keys()].filter((i) => i % Math.max(1, Math.ceil(linked.x.length / 600)) === 0).map(inBase);
    traces.push(
      { type: "mesh3d", x: corners.map((c) => c[0]), y: corners.map((c) => c[1]), z: corners.map((c) => c[2]), ...BOX,
        color: "#9fb4c7", opacity: 0.75, flatshading: true, hoverinfo: "skip" },
      { type: "scatter3d", mode: "lines", x: path.map((p) => p[0]), y: path.map((p) => p[1]), z: path.map((p) => p[2]),
        line: { color: KR.css("--accent"), width: 3 }, hoverinfo: "skip" });
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
    const q = jointsAt(linked.time[i]).map((v) => KR.num((v * 180) / Math.PI, 2));
    KR.by("robot_caption").textContent = `${robot.name}, joints that are commanded in pass '${robot.pass_name}' `
      + `[deg]: ${q.join(", ")}. Solids are simple shapes, not the maker's.`;
    KR.by("robot").setAttribute("aria-label", KR.by("robot_caption").textContent);
    clearTimeout(later);
    if (!KR.seen("robot")) return;
    const wait = 80 - (performance.now() - last);
    if (wait > 0) { later = setTimeout(() => mark(KR.place), wait); return; }
    last = performance.now();
    const placed = frames(jointsAt(linked.time[i]));
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
