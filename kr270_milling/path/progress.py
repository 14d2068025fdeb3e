"""Progress on a path: the projection of a point onto the path, in a window ahead of the last progress.

Override changes and stops do not matter, and a path may cross itself.
"""

from __future__ import annotations

import numpy as np


class PathProgress:
    """Place on the straight lines between points (n, 3) [m]; points at rest have one place.

    reach [m]: a point farther from the path gives no progress.
    """

    def __init__(self, position: np.ndarray, reach: float = 1e-3):
        step = np.linalg.norm(np.diff(position, axis=0), axis=1)
        self.moved = np.concatenate([[True], step > 0.0])  #: (n,) bool: points that do not repeat the one before
        self.distance = np.concatenate([[0.0], np.cumsum(step[step > 0.0])])  #: [m], of the points that moved
        self.progress = 0.0  #: [m] along the path
        self._point = position[self.moved]
        self.reach = reach

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.distance[-1])

    def advance(self, point: np.ndarray) -> float:
        """Move the progress to the projection of the point, and return the distance [m] of the point from it."""
        window = 10e-3  # [m], length of the path ahead of the last progress that is searched
        first = max(0, int(np.searchsorted(self.distance, self.progress, side="right")) - 1)
        last = min(int(np.searchsorted(self.distance, self.progress + window)), len(self.distance) - 1)
        first = min(first, len(self.distance) - 2)
        last = max(last, first + 1)
        start, along = self._point[first:last], np.diff(self._point[first : last + 1], axis=0)
        length = np.diff(self.distance[first : last + 1])
        share = np.clip(np.einsum("ij,ij->i", point - start, along) / length**2, 0.0, 1.0)
        reached = np.maximum(self.distance[first:last] + share * length, self.progress)
        share = (reached - self.distance[first:last]) / length
        distance = np.linalg.norm(point - start - share[:, None] * along, axis=1)
        least = np.concatenate([[np.inf], distance, [np.inf]])
        # of two places that are equally near within 20 um, the earlier place is the progress
        local = (distance <= least[:-2]) & (distance <= least[2:]) & (distance <= distance.min() + 2e-5)
        chosen = int(np.argmax(local))
        if distance[chosen] <= self.reach:
            self.progress = float(reached[chosen])
        return float(distance[chosen])
