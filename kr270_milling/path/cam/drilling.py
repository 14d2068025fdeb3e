"""Drilling and boring cycles: what one hole is made of."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kr270_milling.path.cam.contour import NEAR

#: [m] how far above the last depth a peck starts again: 0.01 inch, as in LinuxCNC
CLEARANCE = 0.254e-3
MOST_PECKS = 10_000


@dataclass
class Cycle:
    """As the words of a block define it, lengths in [m]; each hole repeats it."""

    kind: int  #: 73, 76, 81, 82, 83, 85, 86, 89
    initial: float  #: height where the cycle was called
    retract: float  #: R
    bottom: float = math.nan  #: Z
    peck: float = 0.0  #: Q, 0: in one stroke

    def strokes(self) -> list[tuple[float, bool]]:
        """Heights [m] that the tool goes to from R on, each with whether it goes there rapidly; the last is R again.

        81, 82, 86: in, out rapidly; 76 also, without its small shift by Q at the bottom of the bored hole; 83: out to R
        after each peck; 73: back by the clearance; 85, 89: out at the feed.
        """
        if self.kind not in (73, 83) or not 0 < self.peck < self.retract - self.bottom:
            return [(self.bottom, False), (self.retract, self.kind not in (85, 89))]
        depth = self.retract
        path: list[tuple[float, bool]] = []
        while depth > self.bottom:  # a peck that ends at the bottom may differ from it by rounding
            above = min(self.retract, depth + CLEARANCE)
            if path:
                path += [(above, True)] if self.kind == 73 else [(self.retract, True), (above, True)]
            depth = depth - self.peck if depth - self.peck > self.bottom + NEAR else self.bottom
            path.append((depth, False))
            if len(path) > 3 * MOST_PECKS:
                raise ValueError(f"the hole takes more than {MOST_PECKS} pecks; wrong Q?")
        return [*path, (self.retract, True)]
