"""``identify``: compliances, force coefficients and modes from measurements; ``compare``: what is to be identified."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kr270_milling import __version__
from kr270_milling.bag.reader import Recording
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import find_file, read_tree
from kr270_milling.base.record import build
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.sections import Workpiece
from kr270_milling.commands.console import Answer, Table, cell_of
from kr270_milling.commands.progress import progress
from kr270_milling.cutting import LAWS, Tool
from kr270_milling.identification import comparison, modes
from kr270_milling.identification import forces as laws
from kr270_milling.identification import plan as load_tests
from kr270_milling.identification.compliance import compliance_outcome, fit
from kr270_milling.identification.cuts import Sensor, force_series, read_cuts, turn_of
from kr270_milling.identification.materials import find_material, materials
from kr270_milling.identification.measurements import read_measurements
from kr270_milling.identification.outcome import Outcome, points
from kr270_milling.identification.problem import Problem
from kr270_milling.identification.signals import pose_series, read_signals
from kr270_milling.robot.analysis import read_arm
from kr270_milling.trajectory.trajectory_csv import read_csv

MATERIALS = "Linear-edge law [N/mm2, N/mm]"
COMPARED = ("quantity", "measured / simulated", "95 % +-", "offset", "difference RMS")


def _answer(args, outcome: Outcome) -> Answer:
    """What an outcome says; with --out also its files."""
    files = [str(path) for path in outcome.write(args.out)] if args.out else []
    found = outcome.result | ({"files": files} if args.out else {})
    return Answer(found, [*(Table(*table) for table in outcome.tables), *outcome.said, *files])


def compliance(args) -> Answer:
    """From load tests to compliances, or from a cell to a plan of load tests."""
    arm, mount = read_arm(find_file(args.arm))
    where = find_file(args.cell or args.arm)
    if args.cell:
        mount = read_arm(where)[1]
    pose = load_tests.at_posture(mount, np.radians(args.at)) if args.at else load_tests.read_test_pose(where, mount)
    if args.plan is not None:
        return _plan(args, arm, mount, pose)
    if args.measurements is None:
        raise InputError("identify compliance", "needs a table of load tests, or --plan N to make one")
    measured = read_measurements(find_file(args.measurements), arm, mount)
    sought = tuple(name.strip() for name in args.compensator.split(",") if name.strip())
    found = fit(Problem(arm, mount, measured, not args.no_gravity, sought), args.robust)
    return _answer(args, compliance_outcome(found, pose, Path(args.measurements).name))


def _plan(args, arm, mount, pose) -> Answer:
    """Table and program of load tests, and what the plan is worth."""
    if pose is None:
        raise InputError(
            "--plan", "needs the posture where the arm is to mill: name --cell CELL.yaml or --at A1,...,A6"
        )
    point = mount.xyz if args.point is None else 1e-3 * np.array(args.point)
    bench = load_tests.Bench(point, args.mass_kg, args.pull_n, 1e-6 * args.noise_um)
    choice = load_tests.candidates(arm, mount, bench, args.postures, args.seed)
    if args.plan > len(choice.tests):
        raise InputError("--plan", f"asks for {args.plan} load tests, but only {len(choice.tests)} are possible here")
    planner = load_tests.Planner(arm, mount, choice, pose, not args.no_gravity)
    names = ("planned for the test pose", "A-optimal", "D-optimal")
    designs = {name: planner.best(args.plan, c) for name, c in zip(names, load_tests.CRITERIA, strict=True)}
    rng = np.random.default_rng(args.seed)
    blind = sorted((planner.random(args.plan, rng) for _ in range(201)), key=lambda d: d.pose_error)
    best = designs[names[0]]
    designs["random (median of 201)"] = blind[100]
    plan = load_tests.in_order(choice.take(best.rows))
    result: dict = {
        "blind_spots": load_tests.blind_spots(best.relative),
        "designs": [{"name": name, "error_um": 1e6 * d.pose_error, "relative": d.relative.tolist(),
                     "determinant": d.determinant} for name, d in designs.items()],
        "tests": [{"joints_deg": np.degrees(q).tolist(), "wrench": w.tolist(), "load": load_tests.load_text(plan, i)}
                  for i, (q, w) in enumerate(zip(plan.tests.q, plan.tests.wrench, strict=True))],
    }  # fmt: skip
    if args.out:
        error = f"expected error {1e6 * best.pose_error:.3f} um per 100 N"
        notes = [f"load tests planned by kr270_milling {__version__}, {error}", *result["blind_spots"],
                 "measure the reflector without the load, then with it; dx, dy, dz: difference, base axes"]  # fmt: skip
        with staged(args.out) as (draft, final):
            result["files"] = [str(final(path)) for path in load_tests.write_plan(draft, plan, notes)]
    rows = [[name, f"{1e6 * d.pose_error:.3f}", f"{100 * d.relative.max():.1f}", f"{100 * d.determinant:.2f}"]
            for name, d in designs.items()]  # fmt: skip
    title = f"{args.plan} load tests: what 100 N at the cell's posture are known to (1 sigma)"
    tests = [[t["load"], " ".join(f"{a:7.2f}" for a in t["joints_deg"])] for t in result["tests"]]
    return Answer(result, [
        Table(title, ["choice", "error there [um]", "worst compliance [%]", "mean [%]"], rows),
        Table("The tests, in the order of the program", ["load", "A1 to A6 [deg]"], tests),
        *result["blind_spots"],
        *result.get("files", ()),
    ])  # fmt: skip


def forces(args) -> Answer:
    """Force coefficients from mean forces of cuts."""
    tool, down = _tool(args)
    turn = turn_of(args.sensor_abc)
    sensor = Sensor(args.topic, turn, args.sensor_on == "part", args.tare, args.sensor_mass_kg, down)
    cuts = read_cuts(find_file(args.cuts), tool, sensor)
    if args.law not in LAWS:
        raise InputError("--law", f"is {args.law}, must be one of {', '.join(LAWS)}")
    return _answer(args, laws.force_outcome(laws.fit_all(cuts, args.law), args.law, Path(args.cuts).name))


def _tool(args):
    """The tool, and where down is in workpiece axes."""
    tree: dict = {}
    down = np.array([0.0, 0.0, -1.0])
    if args.cell:
        file = find_file(args.cell)
        whole = read_tree(file)
        tree = whole.get("tool", {})
        down = build(Workpiece, whole.get("workpiece", {}), file, "workpiece.").pose.rotation.T @ down
    given = {"teeth": args.teeth, "diameter_mm": args.diameter_mm, "rotation": args.rotation,
             "spindle_speed_rpm": args.spindle_speed_rpm}  # fmt: skip
    tree = tree | {key: value for key, value in given.items() if value is not None}
    if not {"teeth", "diameter_mm"} <= set(tree):
        raise InputError("identify forces", "needs the tool: name --cell CELL.yaml, or --teeth and --diameter-mm")
    if "spindle_speed_rpm" not in tree:
        tree["spindle_speed_rpm"] = 1000.0  # only recordings need it, and those come with a cell
    return build(Tool, tree, args.cell or "command line", "tool."), down


def damping(args) -> Answer:
    """Frequency and damping of the modes from a ring-down or an impact."""
    signals = read_signals(args.recording, args.topic).window(args.start, args.stop)
    low, high = args.band
    found, shapes = modes.find_modes(signals, low, high, args.modes), None
    if args.hammer:
        shapes = modes.by_hammer(found, signals, args.hammer, args.quantity)
    elif args.cell:
        shapes = modes.by_compliance(found, signals, modes.tool_compliance(read_cell(find_file(args.cell))))
    title = f"Modes between {low:g} and {high:g} Hz from {Path(args.recording).name}"
    return _answer(args, modes.mode_outcome(found, signals, shapes, title))


def material(args) -> Answer:
    """Published force coefficients, as a table or as a file to include."""
    rows = find_material(args.name) if args.name else materials()
    entries = [
        {"material": m.name, "cutter": m.cutter, "lubrication": m.lubrication, "source": m.source}
        | dict(zip(laws.NAMES, (m.values / laws.SCALE).tolist(), strict=True))
        for m in rows
    ]
    sections = None
    if args.out:
        if not args.name or not 1 <= args.row <= len(rows):
            raise InputError("--out", f"needs one material, and a --row from 1 to {len(rows)}")
        sections = laws.law_sections("linear_edge", rows[args.row - 1].values, np.full(6, np.nan))
    columns = ["material", "cutter", *(name.split("_n_")[0] for name in laws.NAMES)]
    shown = [[m.name, m.cutter, *("-" if np.isnan(v) else f"{v:g}" for v in m.values / laws.SCALE)] for m in rows]
    sources = [f"{m.name}, {m.cutter}, {m.lubrication} [source: {m.source}]" for m in rows] if args.name else []
    name = (args.name or "").lower().replace(".", "_")
    table = (MATERIALS, columns, shown)
    return _answer(args, Outcome(name, MATERIALS, {"materials": entries}, [table], sources, sections=sections))


def compare(args) -> Answer:
    """A measured pass beside the simulated one."""
    cell = cell_of(args)
    measured = _measured(args)
    reference = read_csv(Path(args.reference))[0] if args.reference else None
    with progress("milling") as report:
        ran = simulate(cell, reference, progress=report).result
    simulated = comparison.Pass(comparison.Series(ran.time, ran.wrench[:, :3]), comparison.Series(ran.time, ran.actual))
    feed = cell.target().sample_velocity(ran.time_ns)
    found = comparison.compare(measured, simulated, ran.target, feed, 2 * np.pi / cell.tool.spindle_speed)
    channels, rows = zip(*map(_compared, found.channels), strict=True) if found.channels else ((), ())
    ringing = {name: {"frequency_hz": f, "damping_ratio": z} for name, (f, z) in found.ringing.items()}
    result = {"channels": list(channels), "lag_s": found.lags, "ringing": ringing, "advice": found.advice}
    lags = [f"the clock of the {name} is {1e3 * lag:.2f} ms behind that of the simulation"
            for name, lag in found.lags.items()]  # fmt: skip
    title = f"Measured against simulated: {Path(args.recording).name} and {Path(args.cell).name}"
    table = ("Measured against simulated", COMPARED, rows)
    said = [*lags, *found.advice]
    return _answer(args, Outcome("compare", title, result, [table], said, lambda: _figures(found)))


def _measured(args):
    """What the recording has of both topics."""
    with Recording(args.recording) as recording:
        last = [topic.rpartition("/")[2] for topic in recording.topics()] + list(recording.topics())
    sensor = Sensor(args.force_topic, turn_of(args.sensor_abc), args.sensor_on == "part")
    force = comparison.Series(*force_series(args.recording, sensor)) if args.force_topic in last else None
    pose = comparison.Series(*pose_series(args.recording, args.pose_topic)) if args.pose_topic in last else None
    return comparison.Pass(force, pose)


def _compared(channel) -> tuple[dict, list[str]]:
    """A channel as JSON and as a row."""
    scale, unit, shown = (1e6, "um", "um") if channel.unit == "m" else (1.0, "n", "N")
    line, offset = channel.line, scale * channel.line.offset
    rms = scale * float(((channel.measured - channel.simulated) ** 2).mean() ** 0.5)
    band = 1.96 * line.gain_sigma
    about = {
        "name": channel.name,
        "gain": line.gain,
        "gain_ci95": band,
        f"offset_{unit}": offset,
        f"residual_rms_{unit}": rms,
        f"residual_rms_smoothed_{unit}": scale * line.residual,
    }
    return about, [channel.name, f"{line.gain:.3f}", f"{band:.3f}", f"{offset:.2f} {shown}", f"{rms:.2f} {shown}"]


def _figures(found) -> list:
    figures = []
    for channel in found.channels:
        thin = slice(None, None, max(1, len(channel.time) // 5000))
        series = {"measured": (channel.time[thin], channel.measured[thin]),
                  "simulated": (channel.time[thin], channel.simulated[thin])}  # fmt: skip
        figures.append(points(channel.name, "time [s]", f"[{channel.unit}]", series, tuple(series)))
    return figures
