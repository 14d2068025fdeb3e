"""Trajectories as CSV files: one knot per row, in mm, mm/s and degrees as all our tables."""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.base.units import seconds
from kr270_milling.trajectory.files import ends_in_mid_line, read_lines
from kr270_milling.trajectory.trajectory import Trajectory, TrajectoryError

__all__ = ["write_csv", "read_csv"]

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
    rows = (sum(parts, []) for parts in zip(*columns, strict=True))
    times = map(seconds, trajectory.time_ns.tolist())
    lines = (f"{time},{','.join(row)}\n" for time, row in zip(times, rows, strict=True))
    write_files({path: (line for part in ([",".join(header) + "\n"], lines) for line in part)})


def _texts(values: np.ndarray) -> list[list[str]]:
    return [list(map(repr, row)) for row in values.tolist()]


def _in_mm(values: np.ndarray) -> list[list[str]]:
    """Metres as texts in mm: the decimal point is moved, so that no bit is lost."""
    return [[str(Decimal(repr(v)).scaleb(3)) for v in row] for row in values.tolist()]


def read_csv(path, frame: str = "workpiece") -> tuple[Trajectory, np.ndarray | None]:
    """Read what ``write_csv`` wrote: the trajectory and the joint angles [rad], (n, 6), or None."""
    lines = read_lines(path)
    ends_in_mid_line(path, lines)
    header = tuple(name.strip() for name in lines[0].split(","))
    allowed = [KNOT + velocity + joints for velocity in ((), VELOCITY) for joints in ((), JOINTS)]
    if header not in allowed:
        raise InputError(path, f"the header must be {','.join(KNOT)}, then velocities and joint angles if any", 1)
    rows, numbers = [], []
    for number, line in enumerate(lines[1:], 2):
        if line.strip():
            rows.append(_row(path, number, line, header))
            numbers.append(number)
    table = np.array(rows).reshape(-1, len(header))
    velocity = table[:, 8:11] if "vx_mm_per_s" in header else None
    joints = np.radians(table[:, -6:]) if "a1_deg" in header else None
    try:
        run = Trajectory(np.rint(table[:, 0] * 1e9).astype(np.int64), table[:, 1:4], table[:, 4:8], velocity, frame)
    except TrajectoryError as error:
        raise InputError(path, error.reason, None if error.index is None else numbers[error.index]) from None
    return run, joints


def _row(path, number: int, line: str, header: tuple[str, ...]) -> list[float]:
    """The values of one line, lengths and speeds in m and m/s."""
    fields = line.split(",")
    if len(fields) != len(header):
        raise InputError(path, f"has {len(fields)} values where the header has {len(header)}", number)
    try:
        values = [float(field) for field in fields]
        shifted = [i for i, name in enumerate(header) if "_mm" in name and math.isfinite(values[i])]
        for i in shifted:
            values[i] = float(Decimal(fields[i].strip()).scaleb(-3))
    except (ValueError, ArithmeticError):
        raise InputError(path, "a value is no number", number) from None
    if not all(map(math.isfinite, values)) or abs(values[0]) > 9e9:
        raise InputError(path, "a value is not finite or too large", number)
    return values
