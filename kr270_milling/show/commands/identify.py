"""``identify``: compliances, force coefficients and modes from measurements; ``compare``: what to identify again."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import find_file, read_tree
from kr270_milling.base.record import build
from kr270_milling.base.version import __version__
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_of, modal_model_of, path_of
from kr270_milling.cell.sections import Workpiece
from kr270_milling.decide.programs.files import rsi_address, write_manifest, write_programs
from kr270_milling.exchange.replay.recorded import passes_from_recording
from kr270_milling.path.trajectory import read_csv
from kr270_milling.physics.cutting import LAWS
from kr270_milling.physics.cutting.laws import find_material, materials
from kr270_milling.physics.cutting.tool import Tool
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.recordings.bag.reader import Recording, remapping
from kr270_milling.show.commands.console import Answer, now, progress
from kr270_milling.show.commands.reports import STAMPS
from kr270_milling.show.report.identification.comparison import comparison_outcome, wall_outcome
from kr270_milling.show.report.identification.compliance import (
    compliance_outcome,
    plan_as_dict,
    plan_tables,
    write_plan,
)
from kr270_milling.show.report.identification.forces import force_outcome, material_outcome
from kr270_milling.show.report.identification.modes import backlash_outcome, mode_outcome, servo_outcome
from kr270_milling.studies.identification import comparison, modes
from kr270_milling.studies.identification import forces as laws
from kr270_milling.studies.identification import plan as load_tests
from kr270_milling.studies.identification.compliance import Problem, fit_compliance, read_measurements
from kr270_milling.studies.identification.doubts import Doubt, hammer_doubts, refuse_units
from kr270_milling.studies.identification.forces import Sensor, force_series, read_cuts, turn_of
from kr270_milling.studies.identification.play import fit_backlash, read_pushes
from kr270_milling.studies.identification.servo import identified_servo, moved_along, read_move
from kr270_milling.studies.identification.signals import pose_series, read_signals
from kr270_milling.studies.identification.wall import compare_wall, read_wall

#: what to record of a test move
RECORD = (
    "record time_s, commanded_mm and measured_mm across the line (y of the workpiece frame) at 100 % override, every "
    "4 ms or faster, from half a second before the move:",
    "with RSI run SERVOTEST_ORG, and 'kr270_milling rsi' with the table rsi_offsets_servo; its recording has both",
    "without RSI run SERVOTEST_CMP, and trace commanded and actual positions on the controller, or use a tracker",
)


def _answer(args, outcome) -> Answer:
    """Print an outcome; with --out also write its files."""
    files = [str(path) for path in outcome.write(args.out, getattr(args, "self_contained", False))] if args.out else []
    result = outcome.result | ({"files": files} if args.out else {})
    refusal = ["no parameter file: the result must not be used"] if outcome.refused else []
    return Answer(result, [*outcome.tables, *outcome.sentences, *refusal, *files], int(outcome.refused))


def identify_compliance(args) -> Answer:
    """Identify compliances from load tests, or plan load tests for a cell."""
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
    compensator = tuple(name.strip() for name in args.compensator.split(",") if name.strip())
    problem = Problem(arm, mount, measured, not args.no_gravity, compensator, args.base)
    refuse_units(problem, args.measurements)
    identified = fit_compliance(problem, args.robust)
    return _answer(args, compliance_outcome(identified, pose, Path(args.measurements).name))


def _plan(args, arm, mount, pose) -> Answer:
    """Plan load tests; write their table and program."""
    blind_designs = 201  # random designs, of which the median is shown
    criteria = ("planned for the test pose", "A-optimal", "D-optimal")  # names of ``load_tests.CRITERIA``
    if pose is None:
        raise InputError(
            "--plan", "needs the posture where the arm is to mill: name --cell CELL.yaml or --at A1,...,A6"
        )
    point = mount.xyz if args.point is None else 1e-3 * np.array(args.point)
    loads = args.mass_kg, args.pull_n, 1e-6 * args.noise_um
    choice = load_tests.candidates(arm, mount, args.postures, args.seed, point, *loads)
    if args.plan > len(choice.tests):
        raise InputError("--plan", f"asks for {args.plan} load tests, but only {len(choice.tests)} are possible here")
    planner = load_tests.Planner(arm, mount, choice, pose, not args.no_gravity, args.base)
    designs = {name: planner.best(args.plan, c) for name, c in zip(criteria, load_tests.CRITERIA, strict=True)}
    rng = np.random.default_rng(args.seed)
    blind = sorted((planner.random(args.plan, rng) for _ in range(blind_designs)), key=lambda d: d.pose_error)
    designs[f"random (median of {blind_designs})"] = blind[blind_designs // 2]
    best = designs[criteria[0]]
    plan = load_tests.sorted_tests(choice.take(best.rows))
    result = plan_as_dict(plan, designs, best, planner.names)
    if args.out:
        error = f"expected error {1e6 * best.pose_error:.3f} um per 100 N"
        notes = [
            f"load tests planned by kr270_milling {__version__}, {error}",
            *result["blind_spots"],
            "measure the reflector without the load, then with it; dx, dy, dz: difference, base axes",
        ]
        with staged(args.out) as (draft, final):
            result["files"] = [str(final(path)) for path in write_plan(draft, plan, notes)]
    return Answer(result, [*plan_tables(plan, designs), *result["blind_spots"], *result.get("files", ())])


def identify_forces(args) -> Answer:
    """Identify force coefficients from mean forces of cuts."""
    tool, down = _tool(args)
    turn = turn_of(args.sensor_abc)
    sensor = Sensor(args.topic, turn, args.sensor_on == "part", args.tare, args.sensor_mass_kg, down)
    cuts = read_cuts(find_file(args.cuts), tool, sensor)
    if args.law not in LAWS:
        raise InputError("--law", f"is {args.law}, must be one of {', '.join(LAWS)}")
    agreeing = laws.agreeing_cuts(cuts) if args.robust else np.ones(len(cuts), bool)
    left_out = (np.flatnonzero(~agreeing) + 1).tolist()
    return _answer(
        args, force_outcome(laws.fit_all(cuts.take(agreeing), args.law), args.law, Path(args.cuts).name, left_out)
    )


def _tool(args):
    """Return the tool, and the direction of gravity in workpiece axes."""
    tree: dict = {}
    down = np.array([0.0, 0.0, -1.0])
    if args.cell:
        file = find_file(args.cell)
        whole = read_tree(file)
        tree = whole.get("tool", {})
        workpiece = build(Workpiece, whole.get("workpiece", {}), file, "workpiece.")
        down = (read_cell(file).workpiece if workpiece.at_start_joints else workpiece).pose.rotation.T @ down
    options = {
        "teeth": args.teeth,
        "diameter_mm": args.diameter_mm,
        "rotation": args.rotation,
        "spindle_speed_rpm": args.spindle_speed_rpm,
    }
    tree = tree | {key: value for key, value in options.items() if value is not None}
    if not {"teeth", "diameter_mm"} <= set(tree):
        raise InputError("identify forces", "needs the tool: name --cell CELL.yaml, or --teeth and --diameter-mm")
    if "spindle_speed_rpm" not in tree:
        tree["spindle_speed_rpm"] = 1000.0  # only recordings need the speed, and a recording has a cell
    return build(Tool, tree, args.cell or "command line", "tool."), down


def identify_damping(args) -> Answer:
    """Identify frequency and damping of the modes from a ring-down or an impact."""
    source = find_file(args.recording) if args.recording.lower().endswith(".csv") else args.recording
    low, high = args.band
    signals = read_signals(source, args.topic).window(args.start, args.stop)
    signals = modes.free_decay(signals, low, high)
    doubts = [Doubt(note) for note in signals.notes]
    cell = read_cell(find_file(args.cell)) if args.cell else None
    (identified, faint), shapes = modes.split_modes(signals, low, high, args.modes), None
    known = (arm_of(cell), path_of(cell).target) if cell else None
    if args.hammer:
        quantity = args.quantity or signals.quantity or "displacement"
        note = modes.check_hammer(identified, signals, args.hammer, quantity)
        shapes = modes.by_hammer(identified, signals, args.hammer, quantity)
        expected: tuple = (None,)
        if cell and known:
            soft = np.diag([*2 * (cell.tool.lateral_compliance,), 0.0, 0.0, 0.0, 0.0])
            expected = modes.tool_compliance(*known) + soft, modal_model_of(cell).frequency[0]
        doubts += [Doubt(note)] * bool(note) + hammer_doubts(identified, shapes, args.hammer, *expected)
    elif known:
        shapes = modes.by_compliance(identified, signals, modes.tool_compliance(*known))
    title = f"Modes between {low:g} and {high:g} Hz from {Path(args.recording).name}"
    return _answer(args, mode_outcome(identified, faint, signals, shapes, title, doubts))


def identify_servo(args) -> Answer:
    """Identify the servo lag from a test move, or write the program of the move."""
    if args.plan:
        return _plan_move(args)
    if args.series is None:
        raise InputError("identify servo", "needs a series of a test move, or --plan to write its program")
    source = find_file(args.series) if args.series.lower().endswith(".csv") else args.series
    move = read_move(source)
    servo, doubts = identified_servo(move)
    title = f"Servo lag from {Path(args.series).name}"
    return _answer(args, servo_outcome(servo, move, doubts, title, not args.other_clock))


def _plan_move(args) -> Answer:
    """Write the programs of a test move across a slow straight line in the air, and state what to record."""
    if not (args.cell and args.out):
        raise InputError("--plan", "needs --cell CELL.yaml, above whose stock the tool moves, and --out DIR")
    cell = read_cell(find_file(args.cell))
    cell = cell.replace(krl=cell.krl.replace(name="SERVOTEST", spindle_on=("; no spindle",), spindle_off=()))
    middle = 0.5 * (cell.stock.min + cell.stock.max)
    middle[2] = cell.stock.max[2] + cell.krl.safe_height
    along, across, speed = np.eye(3)[0], np.eye(3)[1], 10e-3  # [m/s]: the corrector of ``rsi`` follows the place
    line, moved = moved_along(middle, along, across, speed)
    with staged(args.out) as (draft, final):
        files, text = write_programs(
            draft,
            cell,
            line,
            moved,
            method="servo",
            date=now(),
            rsi=args.rsi and rsi_address(args.rsi),
            tables=("rsi",),
        )
        write_manifest(draft, [text, *RECORD], ["a test move in the air, no cut"], True)
        result = {kind: [str(final(path)) for path in paths] for kind, paths in files.items()}
    paths = [path for rows in result.values() for path in rows]
    return Answer({"programs": result, "record": list(RECORD)}, [*RECORD, *paths])


def identify_backlash(args) -> Answer:
    """Identify the backlash of the joints from push and pull at the tool."""
    arm, mount = read_arm(find_file(args.arm))
    file = find_file(args.pushes)
    result = fit_backlash(arm, mount, read_pushes(file), str(file))
    return _answer(args, backlash_outcome(result, f"Backlash from {Path(args.pushes).name}"))


def identify_material(args) -> Answer:
    """Print published force coefficients, or write a file to include."""
    rows = find_material(args.name) if args.name else materials()
    if args.out and (not args.name or not 1 <= args.row <= len(rows)):
        raise InputError("--out", f"needs one material, and a --row from 1 to {len(rows)}")
    return _answer(args, material_outcome(rows, args.name, rows[args.row - 1] if args.out else None))


def run_identify(args) -> Answer:
    identify = {
        "compliance": identify_compliance,
        "forces": identify_forces,
        "damping": identify_damping,
        "servo": identify_servo,
        "backlash": identify_backlash,
        "material": identify_material,
    }
    return identify[args.what](args)


def run_compare(args) -> Answer:
    """Compare a measured pass with the simulated pass."""
    cell = read_cell(find_file(args.cell), args.set)
    reference = read_csv(Path(args.reference))[0] if args.reference else None
    if Path(args.recording).suffix.lower() == ".csv":
        measured_wall = read_wall(find_file(args.recording))
        with progress("plants") as report:
            wall = compare_wall(cell, measured_wall, reference, args.plants, progress=report)
        return _answer(args, wall_outcome(wall, Path(args.recording).name, Path(args.cell).name))
    passes = _recorded_passes(args)
    measured, name = None, Path(args.recording).name
    if passes:
        number = getattr(args, "pass") or len(passes)
        if number > len(passes):
            raise InputError("--pass", f"{args.recording} has {len(passes)} passes")
        chosen, recorded = passes[number - 1]
        reference = chosen.reference if reference is None else reference
        if len(passes) > 1 or recorded.stamps != "exchange":
            measured, name = _series_of(args, chosen.result), chosen.name + STAMPS[recorded.stamps]
    measured = measured or _measured(args, chosen.reference.start_ns if passes else 0)
    with progress("milling") as report:
        simulated = simulate(cell, reference, progress=report).result
    series = {"force": (simulated.time, simulated.wrench[:, :3]), "pose": (simulated.time, simulated.actual)}
    feed = path_of(cell).target.sample_velocity(simulated.time_ns)
    compared = comparison.compare(measured, series, simulated.target, feed, 2 * np.pi / cell.tool.spindle_speed)
    return _answer(args, comparison_outcome(*compared, name, Path(args.cell).name))


def _recorded_passes(args) -> list:
    """Return the passes of a recording of the nodes or of RSI; none of a recording of a sensor or a tracker alone."""
    remap = remapping(args.remap)
    with contextlib.suppress(RecordingError):
        return passes_from_recording(args.recording, remap=remap)
    return []


def _series_of(args, recorded):
    """Return force and place of the tool in a recorded pass, a PassResult."""
    sign = -1.0 if args.sensor_on == "part" else 1.0
    force = sign * recorded.wrench[:, :3] @ turn_of(args.sensor_abc).T
    series = {"pose": (recorded.time, recorded.actual)}
    return series | ({"force": (recorded.time, force)} if recorded.wrench.any() else {})


def _measured(args, start_ns: int):
    """Read force and pose of the recording, from the start of the pass, as far as the recording has them."""
    with Recording(args.recording) as recording:
        names = {topic.rpartition("/")[2] for topic in recording.topics()}
    remap = {own.rpartition("/")[2]: name for own, name in remapping(args.remap).items()}
    recorded = {name: name for name in names & {"wrench", "tool_pose"}} | remap
    measured = {}
    if topic := recorded.get("wrench"):
        sensor = Sensor(topic, turn_of(args.sensor_abc), args.sensor_on == "part")
        time, values = force_series(args.recording, sensor)
        measured["force"] = time - 1e-9 * start_ns, values
    if topic := recorded.get("tool_pose"):
        time, values = pose_series(args.recording, topic)
        measured["pose"] = time - 1e-9 * start_ns, values
    return measured
