"""Stability of a cell: limit depth of cut and chatter frequency over spindle speed, and of each feature along its path.

Along the path the arm is looked at in several postures of a feature, and in each the cut goes in the direction of the
feed there: the modes are turned into axes with x along the feed, which is where the engagement of the teeth is counted
from.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.cell.cell import Cell
from kr270_milling.decision.check_cut import engagement as engagement_along
from kr270_milling.decision.part.course import course
from kr270_milling.identification.cuts import engagement
from kr270_milling.simulation.dynamics import ModalModel
from kr270_milling.studies.monodromy import Modes, directional_matrices, multipliers
from kr270_milling.studies.placements import about_z

__all__ = ["FeatureLimit", "Lobe", "feature_limits", "limit_depth", "lobes", "modes_of"]

DEPTHS = np.geomspace(1e-6, 0.1, 26)  #: [m], between which the first loss of stability is looked for
HALVINGS = 12  #: of such an interval, a factor of 1.6: to 0.01 % of the depth
NODES = 40, 200  #: least and most nodes of a tooth period
PER_PERIOD = 32  #: nodes in a period of the fastest mode
THREADS = 2
PLACES = 5  #: of each feature
CUTS = 1e-6  #: [m] of depth, less is rounding


@dataclass(frozen=True)
class Lobe:
    """One spindle speed."""

    spindle_speed: float  #: [rad/s]
    depth_limit: float  #: [m]; infinite where nothing below 100 mm chatters
    chatter_frequency: float  #: [rad/s]; NaN where there is none

    def as_dict(self) -> dict:
        """For JSON."""
        return {
            "spindle_speed_rpm": self.spindle_speed * 30.0 / math.pi,
            "depth_limit_mm": 1e3 * self.depth_limit,
            "chatter_hz": self.chatter_frequency / (2.0 * math.pi),
        }


def modes_of(cell: Cell, arm: bool = True, model: ModalModel | None = None) -> Modes:
    """The modes of the arm, and those of ``tool.modes``; arm: False leaves out the former.

    model: of the arm in another posture than where the path starts. Raises ParameterError where that leaves no mode.
    """
    tool = cell.tool.modes
    own = Modes(2.0 * np.pi * tool.frequency, tool.damping_ratio, tool.shapes.reshape(-1, 3))
    if not arm and not tool.frequency.size:
        raise ParameterError("tool.modes", [], "given where the arm is left out: there is no mode that could chatter")
    if not arm:
        return own
    model = model or cell.modal_model
    ratio = np.full(model.frequency.size, cell.dynamics.damping_ratio) if model.damping is None else model.damping
    return Modes(
        np.append(own.frequency, model.frequency),
        np.append(own.damping_ratio, ratio),
        np.vstack([own.shape, (model.output[:3] @ model.shape).T]),
    )


def lobes(
    cell: Cell, speeds: Sequence[float], arm: bool = True, progress: Callable[[int, int], None] | None = None
) -> list[Lobe]:
    """Limit depth at each spindle speed [rad/s], for the immersion of ``path`` and the feed per tooth of the cell."""
    modes = modes_of(cell, arm)
    found = []
    with ThreadPoolExecutor(THREADS) as pool:
        for lobe in pool.map(lambda speed: _lobe_at(cell, modes, speed), speeds):
            found.append(lobe)
            if progress is not None:
                progress(len(found), len(speeds))
    return found


def _lobe_at(cell: Cell, modes: Modes, speed: float) -> Lobe:
    """The limit depth at one spindle speed [rad/s]; modes: in axes with x along the feed."""
    tool = cell.tool
    if tool.pitch.size and np.ptp(tool.pitch) > 1e-9:
        raise ParameterError("tool.pitch_deg", np.degrees(tool.pitch).tolist(), "uniform: its lobes are those of tau")
    mode = "slot" if cell.path.radial_immersion >= 1.0 else cell.path.mode
    entry, leave = (float(angle) + 0.5 * math.pi for angle in engagement(mode, cell.path.radial_immersion, 1.0))
    delay = 2.0 * math.pi / (speed * tool.teeth)
    nodes = int(np.clip(PER_PERIOD * delay * modes.frequency.max() / (2.0 * math.pi), *NODES))
    matrices = directional_matrices(_gradients(cell), tool.sense, tool.teeth, entry, leave, nodes)
    return Lobe(speed, *limit_depth(modes, matrices, delay))


def limit_depth(modes: Modes, matrices: np.ndarray, delay: float) -> tuple[float, float]:
    """The smallest depth [m] at which a multiplier leaves the unit circle, and the frequency there [rad/s]."""

    def largest(depth: float) -> float:
        return float(np.abs(multipliers(modes, matrices, depth, delay)).max())

    first = next((i for i, depth in enumerate(DEPTHS) if largest(depth) > 1.0), None)
    if first is None:
        return math.inf, math.nan
    low, high = (0.0 if first == 0 else DEPTHS[first - 1]), DEPTHS[first]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if largest(middle) > 1.0 else (middle, high)
    return high, _frequency(modes, multipliers(modes, matrices, high, delay), delay)


def _frequency(modes: Modes, found: np.ndarray, delay: float) -> float:
    """Of the multiplier on the circle: (arg mu + 2 pi k) / tau, the k that lies nearest above or at a mode.

    The multiplier is the same for all k; a chatter frequency lies near the mode that it excites.
    """
    angle = abs(float(np.angle(found[np.argmax(np.abs(found))])))
    turns = np.arange(-1000, 1001)
    candidates = np.concatenate([angle + 2.0 * np.pi * turns, -angle + 2.0 * np.pi * turns]) / delay
    candidates = candidates[candidates > 0.0]
    away = np.abs(candidates[:, None] / modes.frequency - 1.0).min(axis=1)
    return float(candidates[np.argmin(away)])


def _gradients(cell: Cell):
    """K_t, K_r, K_a [N/m^2] at the chip thickness f_z s: dF/dh per depth, by a central difference of the law."""
    tool = cell.tool
    feed_per_tooth = 2.0 * np.pi * cell.feed_rate / (tool.spindle_speed * tool.teeth)

    def gradients(sine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        h = np.maximum(feed_per_tooth * sine, 1e-3 * feed_per_tooth)
        return cell.cutting.active.slopes(h)

    return gradients


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
    met = engagement_along(cell, 0.0)
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
    shape = modes.shape @ about_z(heading)  # rows: Rz(-heading) phi
    return _lobe_at(cell, dataclasses.replace(modes, shape=shape), cell.tool.spindle_speed)
