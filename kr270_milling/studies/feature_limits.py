"""Stability along a path: the limit depth of each feature at the spindle speed of the cell.

The arm is looked at in several postures of the feature, and in each the cut goes in the direction of the feed there:
the modes are turned into axes with x along the feed, which is where the engagement of the teeth is counted from.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.decision.check_cut import engagement
from kr270_milling.decision.part.course import course
from kr270_milling.studies.lobes import Lobe, lobe_at, modes_of
from kr270_milling.studies.placements import about_z

__all__ = ["FeatureLimit", "feature_limits"]

PLACES = 5  #: of each feature
CUTS = 1e-6  #: [m] of depth, less is rounding


@dataclass(frozen=True)
class FeatureLimit:
    """One feature of the path."""

    name: str
    depth: float  #: deepest cut of the program [m]
    limit: Lobe  #: the least of its places

    def as_dict(self) -> dict:
        """For JSON."""
        return {"feature": self.name, "depth_mm": 1e3 * self.depth, **self.limit.as_dict(),
                "stable": self.depth < self.limit.depth_limit}  # fmt: skip


def feature_limits(cell: Cell, arm: bool = True) -> list[FeatureLimit]:
    """The limit depth of each feature that cuts, in the order of the path."""
    met = engagement(cell, 0.0)
    time_ns = np.minimum(np.round(1e9 * met.time).astype(np.int64), cell.target().duration_ns)
    path = course(cell, time_ns)
    cutting = (met.depth > CUTS) & ~met.rapid
    found = []
    for number in dict.fromkeys(path.feature[cutting].tolist()):
        rows = np.flatnonzero(cutting & (path.feature == number))
        some = rows[np.linspace(0, len(rows) - 1, PLACES).astype(int)]
        limits = [_limit(cell, arm, int(time_ns[k]), float(path.heading[k])) for k in dict.fromkeys(some.tolist())]
        least = min(limits, key=lambda lobe: lobe.depth_limit)
        found.append(FeatureLimit(path.features[number], float(met.depth[rows].max()), least))
    return found


def _limit(cell: Cell, arm: bool, time_ns: int, heading: float) -> Lobe:
    """At the posture of a time, with the feed at the angle ``heading`` [rad] from x of the workpiece."""
    run, model = cell.target(), None
    if arm:
        place, turn = (sample(np.array([time_ns])) for sample in (run.sample, run.sample_orientation))
        model = cell.modes_at(cell.joints_at(place, turn))[0]
    modes = modes_of(cell, arm, model)
    shape = modes.shape @ about_z(np.array([heading]))[0]  # rows: Rz(-heading) phi
    return lobe_at(cell, dataclasses.replace(modes, shape=shape), cell.tool.spindle_speed)
