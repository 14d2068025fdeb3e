"""Trajectories as CSV files: one knot per row, SI units except the joint angles."""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.units import seconds
from kr270_milling.trajectory.files import ends_in_mid_line, read_lines, write_files
from kr270_milling.trajectory.trajectory import Trajectory, TrajectoryError

__all__ = ["write_csv", "read_csv"]

KNOT = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
VELOCITY = ("vx_m_per_s", "vy_m_per_s", "vz_m_per_s")
JOINTS = ("a1_deg", "a2_deg", "a3_deg", "a4_deg", "a5_deg", "a6_deg")


def write_csv(path, trajectory: Trajectory, joints=None) -> None:
    """Write the knots, their velocities if there are any, and joint angles [rad], (n, 6), if given.

    Every number but the angles is read back to the last bit.
    """
    header, columns = list(KNOT), [trajectory.position, trajectory.quaternion]
    if trajectory.velocity is not None:
        header += VELOCITY
        columns.append(trajectory.velocity)
    if joints is not None:
        header += JOINTS
        columns.append(np.degrees(np.asarray(joints, float)).reshape(len(trajectory), 6))
    rows = np.hstack(columns).tolist()
    times = map(seconds, trajectory.time_ns.tolist())
    lines = (f"{time},{','.join(map(repr, row))}\n" for time, row in zip(times, rows, strict=True))
    write_files({path: (line for part in ([",".join(header) + "\n"], lines) for line in part)})


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
            rows.append(_row(path, number, line, len(header)))
            numbers.append(number)
    table = np.array(rows).reshape(-1, len(header))
    velocity = table[:, 8:11] if "vx_m_per_s" in header else None
    joints = np.radians(table[:, -6:]) if "a1_deg" in header else None
    try:
        run = Trajectory(np.rint(table[:, 0] * 1e9).astype(np.int64), table[:, 1:4], table[:, 4:8], velocity, frame)
    except TrajectoryError as error:
        raise InputError(path, error.reason, None if error.index is None else numbers[error.index]) from None
    return run, joints


def _row(path, number: int, line: str, width: int) -> list[float]:
    fields = line.split(",")
    if len(fields) != width:
        raise InputError(path, f"has {len(fields)} values where the header has {width}", number)
    try:
        values = [float(field) for field in fields]
    except ValueError:
        raise InputError(path, "a value is no number", number) from None
    if not all(map(math.isfinite, values)) or abs(values[0]) > 9e9:
        raise InputError(path, "a value is not finite or too large", number)
    return values
