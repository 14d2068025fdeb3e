"""What a controller runs, from a cell and its original and revised trajectory: programs, offsets, joint positions."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kr270_milling import __version__
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.base.frames import Pose, quaternion_from_rotation
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import commanded_joints
from kr270_milling.programs import krl, krl_motion
from kr270_milling.programs.manifest import manifest
from kr270_milling.programs.rsi import RSI_TICKS_NS, write_joint_table, write_rsi_table
from kr270_milling.robot import pose, status_turn
from kr270_milling.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.trajectory.trajectory import Trajectory
from kr270_milling.trajectory.trajectory_csv import write_csv

AT_ZERO = np.radians(1e-3)  #: an axis nearer to zero has no certain sign: points are written to 0.1 um
BESIDE = ((0.0, 0.0), (0.0, 2e-4), (2e-4, 2e-4))  #: [m], of the approach beside the first point, tried in this order
NOT_RELEASED = "NOT_RELEASED"  #: name of a program that must not be run

__all__ = ["as_commanded", "source_hash", "write_programs"]


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
    write_files({files["manifest"][0]: manifest(place, program, files, findings, tick, released)})
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
