"""What a controller runs, from a cell and its original and revised trajectory: programs, offsets, joint positions."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kr270_milling import __version__
from kr270_milling.base.errors import InputError
from kr270_milling.base.frames import Pose, quaternion_from_rotation
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import commanded_joints
from kr270_milling.programs import krl
from kr270_milling.programs.rsi import RSI_TICKS_NS, write_joint_table, write_rsi_table
from kr270_milling.robot import pose, status_turn
from kr270_milling.trajectory.trajectory import Trajectory
from kr270_milling.trajectory.trajectory_csv import write_csv

NOT_RELEASED = "NOT_RELEASED"  #: name of a program that must not be run

__all__ = ["as_commanded", "remove_stale", "source_hash", "write_programs"]


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

    "krl_spline", "krl_lin": the modules of both programs in a directory of that name, for each of ``motions`` (default:
    ``program.motion``; None: no robot program); "rsi": revised minus original at each tick; "joints": joint positions of both; "trajectory":
    the revised one as CSV, which ``simulate`` and ``check`` read. method: for the file names; date: as text;
    source: sha256 of what the original was made from; findings: lines of the check, which stand in every header.
    A program that is not released has NOT_RELEASED for its name.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", method):
        raise InputError("method", f"{method[:40]!r} cannot be part of a file name")
    place = Path(directory)
    joints = [commanded_joints(cell, run) for run in (original, revised)]
    shown = [as_commanded(cell, run, q) for run, q in zip((original, revised), joints, strict=True)]
    files: dict[str, list[Path]] = {}
    program = cell.program if released else cell.program.replace(name=NOT_RELEASED)
    motions = () if motions is None else motions or (cell.program.motion,)
    for motion in dict.fromkeys(motions):
        folder = place / f"krl_{motion.lower()}"
        folder.mkdir(parents=True, exist_ok=True)
        files[folder.name] = krl.write_krl(
            folder, program.replace(motion=motion), _controller(cell, *shown), *shown, __version__, date, source,
            findings,
        )  # fmt: skip
    tick = cell.compensation.tick_ns
    tables = [place / "joints_original.csv", place / f"joints_{method}.csv"]
    files["rsi"] = [place / "rsi_offsets.csv"]
    files["joints"], files["trajectory"] = tables, [place / f"reference_{method}.csv"]
    write_rsi_table(files["rsi"][0], *shown, tick if tick in RSI_TICKS_NS else RSI_TICKS_NS[-1])
    for path, run, q in zip(tables, (original, revised), joints, strict=True):
        write_joint_table(path, run, q)
    write_csv(files["trajectory"][0], revised, joints[1])
    return files


def remove_stale(folder, name: str, kept: Sequence[Path]) -> list[Path]:
    """Remove modules of a longer program of this name that was in the folder before; returns them."""
    pattern, kept = re.compile(rf"{re.escape(name)}_(ORG|CMP)(_[0-9]{{3}})?\.(src|dat)"), {path.name for path in kept}
    found = [p for p in sorted(Path(folder).iterdir()) if pattern.fullmatch(p.name) and p.name not in kept]
    for path in found:
        path.unlink()
    return found


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


def _controller(cell: Cell, original: Trajectory, revised: Trajectory) -> krl.Cell:
    """$TOOL is the mount, $BASE the workpiece, status and turn those of the first point of each program."""
    starts = [cell.joints_at(run.position[:1], run.quaternion[:1])[0] for run in (original, revised)]
    (status, turn), (revised_status, revised_turn) = (map(int, status_turn(cell.arm, q)) for q in starts)
    mount, to_kuka = cell.mount, KUKA_FLANGE.inverse()
    return krl.Cell(
        to_kuka @ mount.pose, cell.workpiece.pose, status, turn, mount.mass,
        tuple(to_kuka.apply(mount.mass_centre).tolist()), revised_status, revised_turn,
    )  # fmt: skip
