"""A short text that tells whether two nodes mean the same trajectory."""

from __future__ import annotations

import zlib

from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["fingerprint"]


def fingerprint(trajectory: Trajectory) -> str:
    """CRC-32 of times, positions and velocities, whose bits a message keeps; 8 hexadecimal digits."""
    velocity = b"" if trajectory.velocity is None else trajectory.velocity.tobytes()
    return f"{zlib.crc32(trajectory.time_ns.tobytes() + trajectory.position.tobytes() + velocity):08x}"
