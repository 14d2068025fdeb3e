"""Placements of the part in front of the arm: reach, limits, singularities and predicted static error along a path.

A row is one placement of the workpiece (x, y, z, turn about z), one turn of the tool about its axis and one branch of
the arm. With J(q) the Jacobian of the tool point and k the joint compliances, the point gives way by
C F = J diag(k) J^T F under the cutting force F of each place on the path; the error is the part of it across the feed.
The compensation takes that away as far as compliances and force coefficients are known: what is left is the error
times sqrt(s_k^2 + s_F^2), one standard deviation of ``uncertainty``.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field

import numpy as np

from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.robot import jacobian, singularity_measures
from kr270_milling.robot.arm import Arm
from kr270_milling.robot.inverse import branches

__all__ = ["COLUMNS", "Course", "Placements", "course_of", "moved_cell"]

PLACES = 24  #: along the path at which each placement is looked at
COLUMNS = (
    "x_mm", "y_mm", "z_mm", "turn_deg", "tool_turn_deg", "branch", "feasible", "reachable", "within_limits",
    "singularity", "compliance_um_per_n", "error_max_um", "error_mean_um", "compensated_max_um",
    "compensated_mean_um",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Course:
    """m places on the path of a cell, workpiece frame."""

    position: np.ndarray  #: of the tool tip [m], (m, 3)
    rotation: np.ndarray  #: of tool0, (m, 3, 3)
    feed: np.ndarray  #: unit vectors, (m, 3)
    force: np.ndarray  #: mean cutting force on the tool [N], (m, 3)


def course_of(cell: Cell, places: int = PLACES) -> Course:
    """Places where the tool cuts in one pass of the cell, with the mean force of the period there."""
    ran = simulate(cell)
    cutting = np.flatnonzero(ran.result.volume > 0.0)
    chosen = cutting[np.linspace(0, len(cutting) - 1, places).astype(int)]
    time_ns = ran.result.time_ns[chosen]
    target = cell.target()
    feed = target.sample_velocity(time_ns)
    feed = feed / np.maximum(np.linalg.norm(feed, axis=1, keepdims=True), 1e-12)
    window = max(1, round(2.0 * math.pi / cell.tool.spindle_speed / cell.exchange.period))  # a revolution
    mean = np.array([ran.result.wrench[max(0, k - window + 1) : k + 1, :3].mean(axis=0) for k in chosen])
    return Course(target.sample(time_ns), rotation_from_quaternion(target.sample_orientation(time_ns)), feed, mean)


@dataclass(frozen=True, eq=False)
class Placements:
    """A grid of placements; a worker makes any chunk of rows from its number alone."""

    cell: Cell
    course: Course
    axes: tuple[np.ndarray, ...]  #: x, y, z [m], turn [rad] of the workpiece; turn of the tool about its axis [rad]
    chunk: int = 500  #: placements a file, 8 rows each
    base: Pose = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "base", self.cell.workpiece.pose)

    def __len__(self) -> int:
        return math.prod(len(axis) for axis in self.axes)

    @property
    def chunks(self) -> int:
        """Number of files."""
        return -(-len(self) // self.chunk)

    def placements(self, first: int, last: int) -> np.ndarray:
        """x, y, z [m], turn [rad], turn of the tool [rad] of the numbers first to last, (n, 5)."""
        places = np.unravel_index(np.arange(first, last), [len(axis) for axis in self.axes])
        return np.column_stack([axis[i] for axis, i in zip(self.axes, places, strict=True)])

    def __call__(self, number: int) -> bytes:
        """The Parquet bytes of one chunk."""
        first = number * self.chunk
        chosen = self.placements(first, min(first + self.chunk, len(self)))
        return _parquet(chosen, self.rows(chosen))

    def rows(self, chosen: np.ndarray) -> dict[str, np.ndarray]:
        """The measures of placements (n, 5), each (n, 8): one a branch."""
        arm, course = self.cell.arm, self.course
        turn, tool_turn = _about_z(chosen[:, 3]), _about_z(chosen[:, 4])
        frame = turn @ self.base.rotation  # workpiece axes in base axes, (n, 3, 3)
        position = chosen[:, None, :3] + np.einsum("nij,mj->nmi", frame, course.position)
        rotation = np.einsum("nij,mjk,nkl->nmil", frame, course.rotation, tool_turn)
        middle = np.broadcast_to((arm.joint_lower + arm.joint_upper) / 2, (*position.shape[:2], 6))
        q, _ = branches(arm, self.cell.mount, Pose(position, rotation), middle)  # (n, m, 8, 6)
        reachable = np.isfinite(q).all(axis=(1, 3))
        q, within = _within(arm, np.nan_to_num(q))
        singular = singularity_measures(arm, q).min(axis=(1, 3))
        turned = jacobian(arm, self.cell.mount, q)[..., :3, :]  # (n, m, 8, 3, 6)
        force = np.einsum("nij,mj->nmi", frame, course.force)[:, :, None]
        torque = np.einsum("nmbij,nmbi->nmbj", turned, np.broadcast_to(force, turned.shape[:-1]))
        way = np.einsum("nmbij,j,nmbj->nmbi", turned, arm.joint_compliance, torque)
        feed = np.einsum("nij,mj->nmi", frame, course.feed)[:, :, None]
        across = np.linalg.norm(way - np.sum(way * feed, -1, keepdims=True) * feed, axis=-1)
        size = np.maximum(np.linalg.norm(force, axis=-1), 1e-12)
        left = math.hypot(self.cell.uncertainty.joint_compliance, self.cell.uncertainty.force_coefficient)
        feasible = reachable & within & (singular > 0.0)
        measures = {
            "singularity": singular,
            "compliance_um_per_n": 1e6 * (np.linalg.norm(way, axis=-1) / size).max(axis=1),
            "error_max_um": 1e6 * across.max(axis=1),
            "error_mean_um": 1e6 * across.mean(axis=1),
            "compensated_max_um": 1e6 * left * across.max(axis=1),
            "compensated_mean_um": 1e6 * left * across.mean(axis=1),
        }
        shown = {name: np.where(reachable, value, np.nan) for name, value in measures.items()}
        return {"feasible": feasible, "reachable": reachable, "within_limits": within, **shown}


def _about_z(angle: np.ndarray) -> np.ndarray:
    """Turns about z by angles (n,) [rad], (n, 3, 3)."""
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(len(angle))
    return np.stack([np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, zero + 1], -1)], 1)


def _within(arm: Arm, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n, m, 8, 6) unwrapped along the path and shifted by whole turns, and whether all lie in the limits."""
    q = np.unwrap(q, axis=1)
    low, high = q.min(axis=1), q.max(axis=1)
    turns = np.ceil((arm.joint_lower - low) / (2 * np.pi))
    turns = np.where(arm.joint_lower <= low, -np.floor((low - arm.joint_lower) / (2 * np.pi)), turns)
    inside = np.zeros(low.shape, bool)
    best = np.zeros(low.shape)
    for more in range(3):  # the lowest turn that is above the lower limit, and the next ones
        shift = 2 * np.pi * (turns + more)
        fits = (low + shift >= arm.joint_lower) & (high + shift <= arm.joint_upper) & ~inside
        best = np.where(fits, shift, best)
        inside |= fits
    return q + best[:, None], np.all(inside, axis=-1)


def _parquet(chosen: np.ndarray, rows: dict[str, np.ndarray]) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    shown = chosen * [1e3, 1e3, 1e3, 180.0 / np.pi, 180.0 / np.pi]
    columns = {name: np.repeat(shown[:, i], 8) for i, name in enumerate(COLUMNS[:5])}
    columns["branch"] = np.tile(np.arange(8), len(chosen))
    columns |= {name: values.reshape(-1) for name, values in rows.items()}
    sink = io.BytesIO()
    parquet.write_table(pa.table({name: pa.array(columns[name]) for name in COLUMNS}), sink, compression="zstd")
    return sink.getvalue()


def moved_cell(cell: Cell, course: Course, row: dict) -> dict:
    """What a parameter file must say for a placement: workpiece, mount, posture hint; lengths in mm, angles in deg."""
    turn = _about_z(np.radians([row["turn_deg"]]))[0]
    frame = Pose(np.array([row["x_mm"], row["y_mm"], row["z_mm"]]) * 1e-3, turn @ cell.workpiece.pose.rotation)
    tool_turn = _about_z(np.radians([row["tool_turn_deg"]]))[0]
    mount = Pose(cell.mount.pose.position, cell.mount.pose.rotation @ tool_turn.T)
    middle = len(course.position) // 2
    place = frame @ Pose(course.position[middle], course.rotation[middle] @ tool_turn)
    q, _ = branches(cell.arm, cell.mount, place, (cell.arm.joint_lower + cell.arm.joint_upper) / 2)
    hint, _ = _within(cell.arm, q[None, None, int(row["branch"])][:, :, None])
    return {
        "workpiece": {"xyz_mm": _listed(1e3 * frame.position), "abc_deg": _abc(frame), "at_start_joints": False},
        "mount": {"abc_deg": _abc(mount)},
        "posture_hint_deg": _listed(np.degrees(hint[0, 0, 0])),
    }


def _abc(pose: Pose) -> list[float]:
    from kr270_milling.base.frames import abc_from_rotation

    return _listed(np.degrees(abc_from_rotation(pose.rotation)))


def _listed(values: np.ndarray) -> list[float]:
    return [float(f"{v:.9f}") + 0.0 for v in values.tolist()]
