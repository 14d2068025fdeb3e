"""What a controller runs, from a cell and its original and revised trajectory: programs, offsets, joint positions.

The manifest beside them says which file goes where, and in which order to try them.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from kr270_milling import __version__
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.base.frames import Pose, quaternion_from_rotation
from kr270_milling.base.units import seconds
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import commanded_joints
from kr270_milling.cell.sections import Program
from kr270_milling.programs import krl, krl_motion
from kr270_milling.robot import pose, status_turn
from kr270_milling.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.trajectory.trajectory import Trajectory, TrajectoryError, offsets
from kr270_milling.trajectory.trajectory_csv import write_csv

__all__ = ["RSI_TICKS_NS", "as_commanded", "source_hash", "write_joint_table", "write_programs", "write_rsi_table"]

AT_ZERO = np.radians(1e-3)  #: an axis nearer to zero has no certain sign: points are written to 0.1 um
BESIDE = ((0.0, 0.0), (0.0, 2e-4), (2e-4, 2e-4))  #: [m], of the approach beside the first point, tried in this order
NOT_RELEASED = "NOT_RELEASED"  #: name of a program that must not be run


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
    findings: Sequence[str] = (),
    released: bool = True,
) -> dict[str, list[Path]]:
    """Write everything that a controller or a planner takes; returns the paths by kind.

    "krl_spline", "krl_lin": the modules of both programs, for each of ``motions`` (default: ``program.motion``; None:
    no robot program), in a directory named after motion, method, date and hash; "rsi": revised minus original at each
    tick; "joints": joint positions of both, named as well; "trajectory": the revised one as CSV, which ``simulate`` and
    ``check`` read; "manifest": which file goes where, in which order to try them, and what the columns are.

    method: for the names; date: ISO text; source: sha256 of what the original was made from; findings: lines of the
    check, which stand in every header. A program that is not released has NOT_RELEASED for its name.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", method):
        raise InputError("method", f"{method[:40]!r} cannot be part of a file name")
    place = Path(directory)
    joints = [commanded_joints(cell, run) for run in (original, revised)]
    shown = [as_commanded(cell, run, q) for run, q in zip((original, revised), joints, strict=True)]
    program = cell.program if released else cell.program.replace(name=NOT_RELEASED)
    heading = krl.Heading(__version__, date, source, method, tuple(findings))
    motions = () if motions is None else motions or (program.motion,)
    label = f"{method}_{date[:10].replace('-', '')}_{krl.trajectory_hash(shown[1])[:8]}"
    setup, origin = _setup(cell, *shown), _source(cell, len(original))
    files: dict[str, list[Path]] = {}
    for motion in dict.fromkeys(motions):
        folder = place / f"krl_{motion.lower()}_{label}"
        folder.mkdir(parents=True, exist_ok=True)
        written = krl.write_krl(folder, program.replace(motion=motion), setup, shown[0], shown[1], heading, origin)
        files[f"krl_{motion.lower()}"] = written
    tick = cell.compensation.tick_ns
    tick = tick if tick in RSI_TICKS_NS else RSI_TICKS_NS[-1]
    files |= _tables(place, (original, revised), shown, joints, tick, label)
    files["manifest"] = [place / "MANIFEST.txt"]
    write_files({files["manifest"][0]: _manifest(place, program, files, findings, tick, released)})
    return files


def _tables(place: Path, runs, shown, joints, tick_ns: int, label: str) -> dict[str, list[Path]]:
    """label: method, date, hash."""
    files = {
        "rsi": [place / f"rsi_offsets_{label}.csv"],
        "joints": [place / f"joints_original_{label}.csv", place / f"joints_{label}.csv"],
        "trajectory": [place / f"reference_{label.rsplit('_', 2)[0]}.csv"],
    }
    write_rsi_table(files["rsi"][0], shown[0], shown[1], tick_ns)
    for path, run, q in zip(files["joints"], runs, joints, strict=True):
        write_joint_table(path, run, q)
    write_csv(files["trajectory"][0], runs[1], joints[1])
    return files


def as_commanded(cell: Cell, run: Trajectory, joints) -> Trajectory:
    """The points that make a controller's own inverse kinematics arrive at ``joints`` [rad], (n, 6).

    They are the trajectory itself unless the link weights are for us to compensate, which the controller knows
    nothing of.
    """
    if cell.compensation.sag_compensated:
        return run
    tool = cell.workpiece.pose.inverse() @ pose(cell.arm, cell.mount, joints)
    return Trajectory(run.time_ns, tool.position, quaternion_from_rotation(tool.rotation), run.velocity, run.frame)


def source_hash(cell: Cell) -> str:
    """SHA-256 of the tool path file, or "" for a straight cut."""
    if not cell.path.file:
        return ""
    digest = hashlib.sha256()
    with open(cell.path.file, "rb") as stream:
        for block in iter(lambda: stream.read(1 << 20), b""):
            digest.update(block)
    return digest.hexdigest()


#: the controller's $FLANGE in ``flange``: its z axis points out of the flange, as x does here (kuka_experimental sets
#: its tool0 frame, "the $FLANGE coordinate system of the KRC", by the same turn)
KUKA_FLANGE = Pose.from_abc(np.zeros(3), [0.0, np.pi / 2, 0.0])


def _setup(cell: Cell, original: Trajectory, revised: Trajectory) -> krl.Setup:
    """$TOOL is the mount, $BASE the workpiece."""
    safe_z = float(cell.stock.max[2]) + cell.program.safe_height
    mount, to_kuka = cell.mount, KUKA_FLANGE.inverse()
    return krl.Setup(
        tool=to_kuka @ mount.pose,
        base=cell.workpiece.pose,
        approaches=(_approach(cell, original, safe_z), _approach(cell, revised, safe_z)),
        safe_z=safe_z,
        load_mass=mount.mass,
        load_centre=tuple(to_kuka.apply(mount.mass_centre).tolist()),
    )


def _approach(cell: Cell, run: Trajectory, safe_z: float) -> krl.Approach:
    """Above the first point, a little beside it where an axis would stand at zero: its sign, the bit of T, would be
    left to rounding, and a controller that finds the other sign looks for the axis a whole turn away.

    Raises InputError where the arm cannot reach it.
    """
    above = run.position[:1].copy()
    above[0, 2] = max(above[0, 2], safe_z)
    found = []
    for shift in BESIDE:
        try:
            joints = cell.joints_at(above + [*shift, 0.0], run.quaternion[:1])[0]
        except (ReachError, JointLimitError, SingularityError) as error:
            raise InputError("program.safe_height_mm", f"the approach cannot be reached: {error}") from None
        status, turn = status_turn(cell.arm, joints)
        found.append(krl.Approach(above[0] + [*shift, 0.0], int(status), int(turn)))
        if np.abs(joints).min() > AT_ZERO:
            return found[-1]
    return found[0]


def _source(cell: Cell, count: int) -> krl_motion.Source | None:
    """Line and feature of each knot, of a tool path file."""
    timed = cell.timed_path
    if timed is None or len(timed.block) != count:
        return None
    features = timed.toolpath.features
    numbers = timed.toolpath.feature[timed.block].tolist()
    return krl_motion.Source(timed.toolpath.line[timed.block], tuple(features[n] for n in numbers))


def _manifest(
    place: Path,
    program: Program,
    files: Mapping[str, Sequence[Path]],
    findings: Sequence[str],
    tick_ns: int,
    released: bool,
) -> list[str]:
    """Lines of text; files: paths by kind, below ``place``; tick_ns: of the RSI table."""
    lines = [
        "Files for the controller, written by kr270_milling. A simulation result: verify it on the machine.\n",
        "Names carry method, date and the hash of the corrected trajectory: files of one name belong together.\n",
        "\n",
    ]
    if not released:
        lines += ["NOT RELEASED: the check forbids to run this path. Its programs are for looking at.\n", "\n"]
    for kind, paths in files.items():
        if kind.startswith("krl_"):
            lines += _program(place, program, kind, paths)
    rsi, (first, second), (trajectory,) = files["rsi"][0].name, files["joints"], files["trajectory"]
    lines += [
        f"{rsi}: for RSI on top of the original program.\n",
        f"  time_s: every {tick_ns / 1e6:g} ms from the start of the path, point 1. dX_mm, dY_mm, dZ_mm: correction\n",
        "  along the axes of $BASE, the whole of it, not the step from the tick before. dA_deg, dB_deg, dC_deg: its\n",
        "  turn about z, y', x'' of $BASE.\n",
        f"{first.name}, {second.name}: for a joint trajectory controller, as programmed and corrected.\n",
        "  time_s: from the start of the path. joint_a1_deg to joint_a6_deg: positions, signs as KUKA counts them.\n",
        f"{trajectory.name}: the corrected trajectory for 'simulate --reference' and 'check --reference'.\n",
        "  time_s, then mm, mm/s, deg; qx to qw: orientation of the tool in the workpiece frame.\n",
        "\n",
        "Findings of the check:\n",
        *(f"  {line}\n" for line in findings or ["none were asked for"]),
    ]
    return lines


def _program(place: Path, program: Program, kind: str, paths: Sequence[Path]) -> list[str]:
    folder = paths[0].parent.relative_to(place)
    name, motion = program.name, kind.removeprefix("krl_").upper()
    return [
        f"{folder}: {len(paths)} files, {motion} motions. Copy all of them to KRC:\\R1\\Program on the controller.\n",
        f"  {name}_ORG runs the programmed path, {name}_CMP the corrected one; points have the same numbers.\n",
        "  1. T1, 10 % override, spindle off, the tool well above the part (raise $BASE): ORG, then CMP.\n",
        "  2. T1, 10 %, spindle on, an air cut at the height of the part: CMP.\n",
        "  3. T1 at full height of the part with the spindle on, then AUT with rising override: CMP.\n",
        "\n",
    ]


RSI_TICKS_NS = (4_000_000, 12_000_000)
JOINT_NAMES = ("joint_a1", "joint_a2", "joint_a3", "joint_a4", "joint_a5", "joint_a6")


def write_rsi_table(path, original: Trajectory, revised: Trajectory, tick_ns: int = RSI_TICKS_NS[0]) -> None:
    """The offsets at every RSI tick (4 or 12 ms): time_s, dX, dY, dZ [mm], dA, dB, dC [deg]."""
    if tick_ns not in RSI_TICKS_NS:
        raise TrajectoryError(f"RSI corrects every 4 or 12 ms, not every {tick_ns / 1e6:g} ms")
    time_ns, shift, turn = offsets(original, revised, tick_ns)
    rows = np.hstack([shift * 1e3, np.degrees(turn)]) + 0.0  # + 0.0 turns -0.0 into 0.0
    lines = ["time_s,dX_mm,dY_mm,dZ_mm,dA_deg,dB_deg,dC_deg\n"]
    for time, row in zip(time_ns.tolist(), rows.tolist(), strict=True):
        lines.append(f"{seconds(time)}," + ",".join(f"{v:.6f}" for v in row) + "\n")
    write_files({path: lines})


def write_joint_table(path, trajectory: Trajectory, joints) -> None:
    """A joint trajectory: time_s, then a column of positions [deg] for each joint; joints [rad], (n, 6)."""
    table = np.degrees(np.asarray(joints, float))
    if table.shape != (len(trajectory), len(JOINT_NAMES)) or not np.isfinite(table).all():
        raise TrajectoryError("a joint table needs one finite value per knot and joint")
    lines = ["time_s," + ",".join(f"{name}_deg" for name in JOINT_NAMES) + "\n"]
    for time, row in zip(trajectory.time_ns.tolist(), table.tolist(), strict=True):
        lines.append(f"{seconds(time)}," + ",".join(map(repr, row)) + "\n")
    write_files({path: lines})
