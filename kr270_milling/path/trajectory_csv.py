"""Trajectories as CSV files: one knot per row, in mm, mm/s and degrees as all our tables."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from decimal import Decimal

import numpy as np

from kr270_milling.base.blocks import blocks
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.base.table import read_table
from kr270_milling.base.units import seconds
from kr270_milling.path.trajectory import Trajectory, TrajectoryError

KNOT = ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
VELOCITY = ("vx_mm_per_s", "vy_mm_per_s", "vz_mm_per_s")
JOINTS = ("a1_deg", "a2_deg", "a3_deg", "a4_deg", "a5_deg", "a6_deg")


def write_csv(path, trajectory: Trajectory, joints=None) -> None:
    """Write the knots, their velocities if there are any, and joint angles [rad], (n, 6), if given.

    Every number but the angles is read back to the last bit.
    """
    header, columns = list(KNOT), [_in_mm(trajectory.position), _texts(trajectory.quaternion)]
    if trajectory.velocity is not None:
        header += VELOCITY
        columns.append(_in_mm(trajectory.velocity))
    if joints is not None:
        header += JOINTS
        columns.append(_texts(np.degrees(np.asarray(joints, float)).reshape(len(trajectory), 6)))
    rows = (itertools.chain.from_iterable(parts) for parts in zip(*columns, strict=True))
    times = map(seconds, trajectory.time_ns.tolist())
    lines = (f"{time},{','.join(row)}\n" for time, row in zip(times, rows, strict=True))
    write_files({path: (line for part in ([",".join(header) + "\n"], lines) for line in part)})


def _texts(values: np.ndarray) -> Iterator[list[str]]:
    for part in blocks(len(values)):
        yield from (list(map(repr, row)) for row in values[part].tolist())


def _in_mm(values: np.ndarray) -> Iterator[list[str]]:
    """Metres as texts in mm: the decimal point is moved, so that no bit is lost."""
    for part in blocks(len(values)):
        yield from ([str(Decimal(repr(v)).scaleb(3)) for v in row] for row in values[part].tolist())


def read_csv(path, frame: str = "workpiece") -> tuple[Trajectory, np.ndarray | None]:
    """Read what ``write_csv`` wrote: the trajectory and the joint angles [rad], (n, 6), or None."""
    table = read_table(path, KNOT + VELOCITY + JOINTS, KNOT, whole=True)
    column = dict(zip(table.names, table.numbers(table.names).T, strict=True))
    for name in (name for name in table.names if "_mm" in name):  # in m or m/s, without losing a bit
        column[name] = np.array([float(Decimal(text).scaleb(-3)) for text in table.texts(name)])
    several = {part[0]: [name in column for name in part] for part in (VELOCITY, JOINTS)}
    if any(any(there) != all(there) for there in several.values()):
        raise InputError(path, f"the header must be {','.join(KNOT)}, then velocities and joint angles if any", 1)
    latest = 9e9  # [s], what nanoseconds in 64 bits hold
    table.refuse(np.abs(column["time_s"]) > latest, "a time is too large")

    def columns(names) -> np.ndarray:
        return np.stack([column[name] for name in names], -1)

    time_ns = np.rint(column["time_s"] * 1e9).astype(np.int64)
    joints = columns(JOINTS) if JOINTS[0] in column else None
    velocity = columns(VELOCITY) if VELOCITY[0] in column else None
    try:
        run = Trajectory(time_ns, columns(KNOT[1:4]), columns(KNOT[4:]), velocity, frame)
    except TrajectoryError as error:
        raise InputError(path, error.reason, None if error.index is None else table.lines[error.index]) from None
    return run, None if joints is None else np.radians(joints)
