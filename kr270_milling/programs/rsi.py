"""What a controller or a planner takes besides a program: RSI offset tables and joint trajectories as CSV."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.files import write_files
from kr270_milling.base.units import seconds
from kr270_milling.trajectory.offsets import offsets
from kr270_milling.trajectory.trajectory import Trajectory, TrajectoryError

__all__ = ["write_rsi_table", "write_joint_table", "RSI_TICKS_NS", "JOINT_NAMES"]

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
