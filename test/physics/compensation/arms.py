"""An arm with one mode across the feed, on unevenly spaced knots."""

from __future__ import annotations

import numpy as np

from kr270_milling.physics.compensation.response import ArmResponse, Segments

OMEGA, ZETA = 42.0, 0.04
KNOTS = np.cumsum([0, 50, 50, 30, 70, 50, 50, 20, 80, 50, 50, 50, 50]) * 1_000_000  # unevenly spaced
SEGMENTS = Segments(KNOTS, 16)


def one_mode(frequency=OMEGA, damping=ZETA) -> ArmResponse:
    """A mass of 1 kg on a spring across the feed, y; the other axes are rigid."""
    m, axis = len(SEGMENTS), np.array([0.0, 1.0, 0.0])
    tile = np.ones((m, 1, 1))
    return ArmResponse(
        frequency=np.full((m, 1), frequency),
        damping=np.full((m, 1), damping),
        inward=tile * axis[None, None, :],
        outward=tile * axis[None, :, None],
        push=tile * np.concatenate([axis, np.zeros(3)])[None, None, :],
        carry=tile.copy(),
    )
