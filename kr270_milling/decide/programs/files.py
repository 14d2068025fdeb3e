"""Files for a controller, from a cell and its original and revised trajectory: programs, offsets, joint positions.

The manifest beside them says which file goes where, and in which order to try them.

The RSI context of a KR C4 (RSI 3) makes six corrections from ETHERNET to POSCORR, in $BASE. The numbers of objects and
parameters are those of two public projects that run such a context: otherworld-dev/rsi-pi (KR 16-2, KSS 8.3) and
cjlh/kuka-rsi-ros-interface (KR 3 R540, KSS 8.3, RSI 3.3). Precision and time-out are those of
ros-industrial/kuka_experimental. RSI 5 reads another format.
"""

from __future__ import annotations

import dataclasses
import ipaddress
import re
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.blocks import blocks
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.base.frames import JOINT_NAMES, TOOL0, Pose, lifted, quaternion_from_rotation, tool_axis
from kr270_milling.base.units import seconds
from kr270_milling.cell.arm import commanded_joints
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.sections import Program
from kr270_milling.decide.programs import krl, krl_motion
from kr270_milling.decide.programs.krl_motion import frame_row, frame_text
from kr270_milling.path.trajectory import Trajectory, TrajectoryError, offsets, write_csv
from kr270_milling.physics.robot import pose, status_turn
from kr270_milling.physics.robot.errors import JointLimitError, ReachError, SingularityError

RSI_TICKS_NS = (4_000_000, 12_000_000)
TABLES = ("joints", "rsi")  #: that ``write_programs`` can write beside the programs
NOT_RELEASED = "NOT_RELEASED"  #: name of a program that must not be run
OLDER = "older"  #: folder of the programs of earlier runs
#: names of what an operator may take: those of ``write_programs`` and ``write_gcode``
PROGRAMS = re.compile(rf"(krl|rsi|joints|gcode)_\w.*_\d{{8}}_[0-9a-f]{{8}}(\.\w+)?|{NOT_RELEASED}.*")


def set_aside(directory) -> list[str]:
    """Move the programs of earlier runs into the folder OLDER, where they replace files of the same name; their names.

    Programs of one name and another cell would lie side by side, and after the decision no they must not be run.
    """
    place = Path(directory)
    programs = sorted(path for path in place.iterdir() if PROGRAMS.fullmatch(path.name)) if place.is_dir() else []
    for path in programs:
        target = place / OLDER / path.name
        target.parent.mkdir(exist_ok=True)
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        path.replace(target)
    return [path.name for path in programs]


def kuka_frames(cell: Cell) -> tuple[str, str]:
    """$TOOL and $BASE that the programs set, as the display of the controller has them."""
    frames = (
        ("TOOL", cell.krl.tool_number, _tool_in_flange(cell)),
        ("BASE", cell.krl.base_number, cell.workpiece.pose),
    )
    rows = [(name, f"[{index}]" if index else "", krl_motion.frame_row(frame)) for name, index, frame in frames]
    tool, base = (
        f"${name}={{{krl_motion.frame_text(row)}}}, to compare with {name}_DATA{index}" for name, index, row in rows
    )
    return tool, base


def _tool_in_flange(cell: Cell) -> Pose:
    """tcp in KUKA's $FLANGE, whose z points out of the flange."""
    return TOOL0.inverse() @ cell.mount.pose


def write_manifest(directory, texts: Sequence[str], decision: Sequence[str] = (), released: bool = True) -> Path:
    """Write the one manifest of a directory: the decision, and the text of each tool; return its path."""
    path = Path(directory) / "MANIFEST.txt"
    head = krl.filled("manifest.txt", released=released, decision=decision)
    write_files({path: [head, *texts]})
    return path


def write_programs(
    directory,
    cell: Cell,
    original: Trajectory,
    revised: Trajectory,
    *,
    method: str,
    date: str,
    motions: Sequence[str] | None = (),
    source: str = "",
    decision: str = "",
    findings: Sequence[str] = (),
    released: bool = True,
    rsi: tuple[str, int] | None = None,
    tables: Collection[str] = TABLES,
) -> tuple[dict[str, list[Path]], str]:
    """Write all files for a controller or a planner; return the paths by kind, and the text for ``write_manifest``.

    "krl_spline", "krl_lin": the modules of both programs, for each of ``motions`` (default: ``program.motion``; None:
    no robot program), in a directory named after motion, method, date and hash; "rsi": revised minus original at each
    tick; "joints": joint positions of both, named as well; "trajectory": the revised one as CSV, which ``simulate`` and
    ``check`` read. In a program with several tools the name of the tool is in every name.

    method: for the names; date: ISO text; source: sha256 of what the original was made from; decision: its level, for
    every header; findings: lines of the check, for the manifest. A program that is not released has NOT_RELEASED for
    its name. rsi: address of the host of RSI, for ``rsi_context``; tables: which of "joints" and "rsi" are written.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", method):
        raise InputError("method", f"{method[:40]!r} cannot be part of a file name")
    place = Path(directory)
    joints = tuple(commanded_joints(arm_of(cell), cell.compensation, run) for run in (original, revised))
    commanded = as_commanded(cell, original, joints[0]), as_commanded(cell, revised, joints[1])
    suffix = cell.stage.suffix if cell.stage else ""
    program = cell.krl if released else cell.krl.replace(name=f"{NOT_RELEASED}{suffix}")
    named = f"{method}{suffix}"
    label = f"{named}_{date[:10].replace('-', '')}_{krl.trajectory_hash(commanded[1])[:8]}"
    setup = dataclasses.replace(_setup(cell), date=date, source_hash=source, method=method, decision=decision)
    notes, feeds = notes_of(path_of(cell), len(original)), knot_feeds(path_of(cell), len(original))
    files: dict[str, list[Path]] = {}
    programs: list[tuple] = []
    limits: list[str] = []
    parts = [(0, len(original) - 1)]
    for motion in dict.fromkeys(() if motions is None else motions or (program.motion,)):
        folder = place / f"krl_{motion.lower()}_{label}"
        written, points, ends = krl.write_krl(folder, program.replace(motion=motion), setup, *commanded, notes, feeds)
        files[f"krl_{motion.lower()}"] = written
        parts = parts if programs else ends  # of the first motion: RSI runs it
        size = program_bytes(written)
        about = f"{size / 1e6:.3g} MB for {len(points)} points, {size / len(points):.0f} bytes a point"
        programs.append((motion, folder.name, len(written), len(ends), about))
        limits = limits or krl.time_statements(program.replace(motion=motion), setup)
    if rsi and motions is not None:
        folder = place / f"rsi_{label}"
        limit, lines = cell.compensation.max_correction, setup.heading(program, "ORG", commanded[0])
        files["rsi_context"] = write_rsi_context(folder, program, setup, limit, rsi, lines, len(parts))
    tick_ns = cell.compensation.tick_ns
    tick_ns = tick_ns if tick_ns in RSI_TICKS_NS else RSI_TICKS_NS[-1]
    if "rsi" in tables:
        names = [f"_P{n}" for n in range(1, len(parts) + 1)] if len(parts) > 1 else [""]
        files["rsi"] = [place / f"rsi_offsets_{label}{name}.csv" for name in names]
        air = setup.top, setup.top + cell.krl.safe_height, cell.krl.approach_feed
        for path, (first, last) in zip(files["rsi"], parts, strict=True):
            before, after = (run.between(first, last) for run in commanded)
            write_rsi_table(path, before, after, tick_ns, air)
    if "joints" in tables:
        files["joints"] = [place / f"joints_original_{label}.csv", place / f"joints_{label}.csv"]
        for path, run, q in zip(files["joints"], (original, revised), joints, strict=True):
            write_joint_table(path, run, q)
    files["trajectory"] = [place / f"reference_{named}.csv"]
    write_csv(files["trajectory"][0], revised, joints[1])
    text = krl.filled(
        "manifest_tool.txt",
        stage=cell.stage,
        programs=programs,
        name=program.name,
        files=files,
        tick_ms=f"{tick_ns / 1e6:g}",
        findings=findings,
        limits=limits,
        time_law=time_law(path_of(cell)),
        turning=_turning(program, original),
        frames=kuka_frames(cell),
    )
    return files, text


def program_bytes(files: Iterable[Path]) -> int:
    """Return the size of the corrected program among the files of ``write_krl``."""
    return sum(path.stat().st_size for path in files if re.search(r"_CMP(_P?\d+)?\Z", path.stem))


def as_commanded(cell: Cell, run: Trajectory, joints) -> Trajectory:
    """The points that make a controller's own inverse kinematics arrive at ``joints`` [rad], (n, 6).

    They are the trajectory itself unless the link weights are for us to compensate, which the controller knows
    nothing of.
    """
    if cell.compensation.sag_compensated:
        return run
    tool = cell.workpiece.pose.inverse() @ pose(cell.arm, cell.mount, joints)
    return Trajectory(run.time_ns, tool.position, quaternion_from_rotation(tool.rotation), run.velocity, run.frame)


def _setup(cell: Cell) -> krl.Setup:
    """$TOOL is the mount, $BASE the workpiece."""
    mount = cell.mount
    centre = tuple(TOOL0.inverse().apply(mount.mass_centre).tolist())
    law = (cell.timing.acceleration, cell.timing.jerk) if timed_by_cell(path_of(cell)) else (0.0, 0.0)
    spindle = f"{cell.tool.spindle_speed * 30.0 / np.pi:.6g} rpm, {cell.tool.rotation}"
    fed = path_of(cell).fed
    return krl.Setup(
        _tool_in_flange(cell),
        cell.workpiece.pose,
        lambda run, knot: _approach(cell, run, knot),
        float(cell.stock.max[2]),
        mount.mass,
        centre,
        spindle,
        *law,
        fed.toolpath.program.external if fed else (0.0,) * 6,
    )


def _approach(cell: Cell, run: Trajectory, knot: int) -> tuple[np.ndarray, int, int]:
    """Above a knot, a little beside it where an axis would be at zero: its sign, the bit of T, would be
    left to rounding, and a controller that finds the other sign looks for the axis a whole turn away.

    Raises InputError where the arm cannot reach it.
    """
    safe = float(cell.stock.max[2]) + cell.krl.safe_height
    above = lifted(run.position[knot], tool_axis(run.quaternion[knot]), safe)[None]
    approaches = []
    beside = ((0.0, 0.0), (0.0, 2e-4), (2e-4, 2e-4))  # [m], of the approach beside the knot, tried in this order
    for shift in beside:
        try:
            joints = arm_of(cell).joints_at(above + [*shift, 0.0], run.quaternion[[knot]])[0]
        except (ReachError, JointLimitError, SingularityError) as error:
            raise InputError("program.safe_height_mm", f"the approach cannot be reached: {error}") from None
        status, turn = status_turn(cell.arm, joints)
        approaches.append((above[0] + [*shift, 0.0], int(status), int(turn)))
        # an axis nearer to zero has no certain sign: points are written to 0.1 um
        if np.abs(joints).min() > np.radians(1e-3):
            return approaches[-1]
    return approaches[0]


def timed_by_cell(path: CellPath) -> bool:
    """Return whether ``timing`` decides about the times of the points."""
    return path.timed is not None and not path.timed.timed_by_source


def time_law(path: CellPath) -> str:
    """The times of the points, on which every figure of a program rests, as one line."""
    if path.timed is None:
        feed = f"constant feed of {60 * path.feed_rate:.4g} m/min"
        return f"time law assumed: {feed} from point 1 to the last; give the program a run-in and a run-out"
    if path.timed.timed_by_source:
        return "time law assumed: the times of the recorded path"
    timing = path.timing
    return (
        f"time law assumed: acceleration {timing.acceleration:g} m/s2, jerk {timing.jerk:g} m/s3 along the path, a "
        f"knot of the plan every {1e3 * timing.controller_step:g} ms"
    )


def _turning(program: Program, run: Trajectory) -> str:
    """A sentence where the tool turns faster than the program lets it."""
    if not np.any(run.quaternion != run.quaternion[0]):
        return ""
    turned = Rotation.from_quat(run.quaternion)
    turn = (turned[:-1].inv() * turned[1:]).magnitude()
    rate = np.degrees(turn / (1e-9 * np.diff(run.time_ns)))
    growth = np.abs(np.diff(rate)) / (1e-9 * np.diff(run.time_ns)[1:])
    most = rate.max(initial=0.0), growth.max(initial=0.0)
    allowed = np.degrees([program.turn_speed, program.turn_acceleration])
    slower = "; more than $VEL.ORI or $ACC.ORI, the controller slows down there" if np.any(most > allowed) else ""
    return f"the tool turns at up to {most[0]:.3g} deg/s and {most[1]:.3g} deg/s2 in the plan{slower}"


def knot_feeds(path: CellPath, count: int) -> np.ndarray | None:
    """Return the programmed feed [m/s] of the block of each of ``count`` knots; NaN where the tool stops.

    None for a path without a program, and for a trajectory of other knots.
    """
    if path.timed is None or path.timed.timed_by_source or len(path.target) != count:
        return None
    toolpath, block = path.timed.toolpath, path.timed.block
    feed = np.where(toolpath.rapid, path.timing.rapid_feed, toolpath.feed)[block]
    return np.where(path.target.standing, np.nan, feed)


def notes_of(path: CellPath, count: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return lines and features of ``count`` knots for comments, (n,); None for a trajectory of other knots."""
    if path.timed is None or len(path.timed.block) != count:
        return None
    toolpath, block = path.timed.toolpath, path.timed.block
    return toolpath.line[block], np.array(toolpath.features, object)[toolpath.feature[block]]


def write_rsi_table(
    path,
    original: Trajectory,
    revised: Trajectory,
    tick_ns: int = RSI_TICKS_NS[0],
    air: tuple[float, float, float] | None = None,
) -> None:
    """Write the offsets at every RSI tick (4 or 12 ms): time_s, dX, dY, dZ [mm], dA, dB, dC [deg], X, Y, Z [mm].

    X, Y, Z: the programmed point, from which the command ``rsi`` takes the progress on the path. air: top of the stock
    and height of the retract [m], feed of the retract [m/s]; the correction then fades to zero above the stock, on the
    end of the path or, where that is too short, on the retract of the program.
    """
    if tick_ns not in RSI_TICKS_NS:
        raise TrajectoryError(f"RSI corrects every 4 or 12 ms, not every {tick_ns / 1e6:g} ms")
    time_ns, shift, turn = offsets(original, revised, tick_ns)
    rows = np.hstack([shift, turn, original.sample(time_ns)])
    if air is not None:
        rows = _faded(rows, 1e-9 * tick_ns, tool_axis(original.quaternion[-1]), *air)
        time_ns = tick_ns * np.arange(len(rows))
    rows = rows * np.repeat([1e3, 180.0 / np.pi, 1e3], 3) + 0.0  # -0.0 becomes 0.0
    _write_rows(path, "dX_mm,dY_mm,dZ_mm,dA_deg,dB_deg,dC_deg,X_mm,Y_mm,Z_mm", time_ns, rows, "{:.6f}".format)


def _faded(rows: np.ndarray, tick: float, axis: np.ndarray, top: float, safe: float, feed: float) -> np.ndarray:
    """Rows of shift, turn and place, (n, 9), whose correction ends at zero; with the retract where it is needed."""
    fade = 0.2  # [s], from the whole correction to none, as that of the command rsi by default
    wanted = int(np.ceil(fade / tick))
    if np.min(rows[-wanted:, 8]) < top and rows[-1, 8] < safe:
        step = feed * tick * axis[2]
        heights = np.append(np.arange(rows[-1, 8] + step, safe, step), safe)
        retract = np.repeat(rows[-1:], len(heights), axis=0)
        retract[:, 6:] = [lifted(rows[-1, 6:], axis, height) for height in heights]
        rows = np.concatenate([rows, retract])
    count = min(wanted, int(np.argmin(np.append(rows[::-1, 8] >= top, False))))
    rows[len(rows) - count :, :6] *= np.linspace(1.0, 0.0, count + 1)[1:, None]
    return rows


def write_joint_table(path, trajectory: Trajectory, joints) -> None:
    """A joint trajectory: time_s, then a column of positions [deg] for each joint; joints [rad], (n, 6)."""
    table = np.degrees(np.asarray(joints, float))
    if table.shape != (len(trajectory), len(JOINT_NAMES)) or not np.isfinite(table).all():
        raise TrajectoryError("a joint table needs one finite value per knot and joint")
    _write_rows(path, ",".join(f"{name}_deg" for name in JOINT_NAMES), trajectory.time_ns, table, repr)


def _write_rows(path, names: str, time_ns: np.ndarray, rows: np.ndarray, text: Callable[[float], str]) -> None:
    def lines() -> Iterator[str]:
        yield f"time_s,{names}\n"
        for part in blocks(len(rows)):
            for time, row in zip(time_ns[part].tolist(), rows[part].tolist(), strict=True):
                yield f"{seconds(time)},{','.join(map(text, row))}\n"

    write_files({path: lines()})


PORT = 49152  #: default port of the command ``rsi``


def rsi_address(text: str) -> tuple[str, int]:
    """Return host and port of "192.168.1.10" or "192.168.1.10:49152"; raise InputError."""
    host, _, port = text.partition(":")
    number = port or str(PORT)
    try:
        ipaddress.IPv4Address(host)
    except ValueError:
        raise InputError("--rsi", f"{text[:40]!r} needs the IPv4 address of the host, such as 192.168.1.10") from None
    if not (number.isascii() and number.isdecimal() and 1 <= int(number) <= 65535):
        raise InputError("--rsi", f"the port {number[:20]!r} must be a whole number from 1 to 65535")
    return host, int(number)


def write_rsi_context(
    directory,
    program: Program,
    setup: krl.Setup,
    limit: float,
    address: tuple[str, int],
    notes: list[str],
    parts: int = 1,
) -> list[Path]:
    """Write ETHERNET settings, context and frame program, which runs NAME_ORG; return the paths.

    limit [m]: largest displacement along each axis of $BASE; address: of the host of ``kr270_milling rsi``; notes:
    comment lines of the header; parts: a frame program for each part of NAME_ORG, NAME_RSI_P1 runs NAME_ORG_P1.
    """
    name, place = program.name, Path(directory)
    tool, base = (f"{{{frame_text(frame_row(frame))}}}" for frame in (setup.tool, setup.base))
    host, port = address
    limits = {f"LowerLim{axis}": f"{-1e3 * limit:g}" for axis in "XYZ"}  # [mm]
    limits |= {f"UpperLim{axis}": f"{1e3 * limit:g}" for axis in "XYZ"}
    limits["MaxRotAngle"] = "0.5"  # [deg], that of the command ``rsi`` by default
    words = dict(program=program, tool=tool, base=base, host=host, port=port, limits=limits.items())
    files: dict[Path, Iterable[str]] = {}
    for part in [f"_P{n}" for n in range(1, parts + 1)] if parts > 1 else [""]:
        body, context, model, ethernet = krl.filled("rsi_program.txt", part=part, **words).split("\u00b6\n")
        source = [*krl.HEAD, f"DEF {name}_RSI{part}( )", *notes, *body.splitlines(), "END"]
        files[place / f"{name}_RSI{part}.src"] = [f"{line}\r\n" for line in source]
    files |= {
        place / f"{name}.rsi.xml": [context],
        place / f"{name}.rsi": [model],
        place / f"{name}_ethernet.xml": [ethernet],
    }
    write_files(files, newline="")
    return list(files)
