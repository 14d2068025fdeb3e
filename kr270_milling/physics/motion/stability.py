"""Stability limit of one engagement: the depth of cut above which vibration grows, and the chatter frequency."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from kr270_milling.base.column import column
from kr270_milling.physics.cutting.laws import Cutting
from kr270_milling.physics.cutting.tool import Tool
from kr270_milling.physics.motion.monodromy import Modes, directional_matrices, multipliers

__all__ = ["Lobe", "StabilityMap", "has_uniform_pitch", "limit_depth", "stability_map"]

DEPTHS = np.geomspace(1e-6, 0.1, 26)  #: [m], depths at which the limit is bracketed
NODES = 40, 200  #: least and most nodes of a tooth period
PER_PERIOD = 32  #: nodes in a period of the fastest mode
PRECISION = 1e-4  #: share of the limit depth


@dataclass(frozen=True)
class Lobe:
    """Limit depth at one spindle speed."""

    #: [rad/s]
    spindle_speed: float = column("spindle_speed_rpm", 30.0 / math.pi, unit="rpm", digits=0, short="spindle speed")
    #: [m]; infinite where no depth below 100 mm chatters
    depth_limit: float = column("depth_limit_mm", 1e3, unit="mm", digits=3, short="limit depth", infinite="above 100")
    #: [rad/s]; NaN where the limit is infinite
    chatter_frequency: float = column("chatter_hz", 0.5 / math.pi, unit="Hz", short="chatter")


@dataclass(frozen=True, eq=False)
class StabilityMap:
    """The regenerative loop of one engagement at one spindle speed."""

    modes: Modes  #: in axes with x along the feed
    matrices: np.ndarray  #: B at the nodes of a tooth period [N/m^2], (nodes, 3, 2)
    delay: float  #: tooth period tau [s]

    def stable(self, depth: float) -> bool:
        """Whether a cut of this depth [m] is stable."""
        return self.growth(depth) <= 0.0

    def growth(self, depth: float) -> float:
        """Magnitude of the largest Floquet multiplier, less 1."""
        return float(np.abs(multipliers(self.modes, self.matrices, depth, self.delay)).max()) - 1.0

    def limit(self, depths: np.ndarray = DEPTHS) -> tuple[float, float]:
        """Smallest depth [m] at which a multiplier leaves the unit circle, and the frequency there [rad/s].

        depths: ascending [m]; where a cut of the first of them is stable, so is every shallower cut.
        """
        first = next((i for i, depth in enumerate(depths) if not self.stable(depth)), None)
        if first is None:
            return math.inf, math.nan
        low = 0.0 if first == 0 else depths[first - 1]
        depth = float(brentq(self.growth, low, depths[first], xtol=1e-9, rtol=PRECISION))
        return depth, _frequency(self.modes, multipliers(self.modes, self.matrices, depth, self.delay), self.delay)


def limit_depth(modes: Modes, matrices: np.ndarray, delay: float) -> tuple[float, float]:
    """Smallest unstable depth [m] between 0 and 100 mm, and the chatter frequency there [rad/s]."""
    return StabilityMap(modes, matrices, delay).limit()


def has_uniform_pitch(tool: Tool) -> bool:
    """Whether all teeth have the same delay, as the limit supposes."""
    return not tool.pitch.size or bool(np.ptp(tool.pitch) < 1e-9)


def stability_map(
    modes: Modes, tool: Tool, cutting: Cutting, feed_per_tooth: float, entry: float, leave: float, speed: float
) -> StabilityMap:
    """entry, leave: angles of a tooth [rad] from the feed, in the sense of rotation; speed: of the spindle [rad/s]."""
    delay = 2.0 * math.pi / (speed * tool.teeth)
    nodes = int(np.clip(PER_PERIOD * delay * modes.frequency.max() / (2.0 * math.pi), *NODES))
    angles = entry + 0.5 * math.pi, leave + 0.5 * math.pi
    gradients = _gradients(cutting, feed_per_tooth)
    return StabilityMap(modes, directional_matrices(gradients, tool.sense, tool.teeth, *angles, nodes), delay)


def _frequency(modes: Modes, values: np.ndarray, delay: float) -> float:
    """(arg mu + 2 pi k) / tau of the largest multiplier mu, with the k that gives the frequency nearest to a mode.

    The multiplier is the same for all k; a chatter frequency lies near the mode that the cut excites.
    """
    angle = abs(float(np.angle(values[np.argmax(np.abs(values))])))
    turns = np.arange(-1000, 1001)
    candidates = np.concatenate([angle + 2.0 * np.pi * turns, -angle + 2.0 * np.pi * turns]) / delay
    candidates = candidates[candidates > 0.0]
    away = np.abs(candidates[:, None] / modes.frequency - 1.0).min(axis=1)
    return float(candidates[np.argmin(away)])


def _gradients(cutting: Cutting, feed_per_tooth: float) -> Callable:
    """K_t, K_r, K_a [N/m^2] at the chip thickness f_z s: dF/dh per depth of cut."""
    law = cutting.active
    return lambda sine: law.slopes(np.maximum(feed_per_tooth * sine, 1e-3 * feed_per_tooth))
