"""Drilling and boring cycles as single strokes of the tool."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Cycle", "strokes"]

#: [m] how far above the last depth a peck starts again: 0.01 inch, as in LinuxCNC
CLEARANCE = 0.254e-3
MOST_PECKS = 10_000


@dataclass
class Cycle:
    """A cycle as its words define it, lengths in [m]; each hole repeats it."""

    kind: int  #: 73, 81, 82, 83, 85, 86, 89
    initial: float  #: height where the cycle was called
    retract: float  #: R
    bottom: float  #: Z
    peck: float = 0.0  #: Q, 0: in one stroke


def strokes(cycle: Cycle) -> list[tuple[float, bool]]:
    """Heights [m] that the tool goes to from R on, each with whether it goes there rapidly; the last one is R again.

    81, 82: in, out rapidly; 83: out to R after each peck; 73: back by the clearance; 85, 89: out at the feed.
    """
    if cycle.kind in (85, 89):
        return [(cycle.bottom, False), (cycle.retract, False)]
    if cycle.kind not in (73, 83) or not 0 < cycle.peck < cycle.retract - cycle.bottom:
        return [(cycle.bottom, False), (cycle.retract, True)]
    depth = cycle.retract
    path: list[tuple[float, bool]] = []
    while depth > cycle.bottom:
        depth = max(cycle.bottom, depth - cycle.peck)
        if path and cycle.kind == 83:
            path.append((min(cycle.retract, path[-2][0] + CLEARANCE), True))
        path.append((depth, False))
        path.append((min(cycle.retract, depth + CLEARANCE) if cycle.kind == 73 else cycle.retract, True))
        if len(path) > 3 * MOST_PECKS:
            raise ValueError(f"the hole takes more than {MOST_PECKS} pecks; wrong Q?")
    path[-1] = (cycle.retract, True)
    return path
