"""Off-line revision of the reference trajectory at the controller step, Fig. 9(a), Fig. 14, in three components.

Every method needs the times and positions of the tool in a pass. A shift of the reference moves the tool by the same
shift, and the displacement under load stays nearly the same, so ``reference' = target - displacement``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ModelError
from kr270_milling.path.controller_motion import block_ends, controller_motion, spline_slopes
from kr270_milling.path.trajectory import Trajectory, slerp
from kr270_milling.physics.compensation.limiting import UNBOUNDED, Bounds, Limited, describe, limit_change

ROUNDS = 30  #: rounds of tightening the limits at the knots until the spline between them keeps them too


@dataclass(frozen=True, eq=False)
class PassRecord:
    """Positions of the tool tip in a pass, simulated, measured or recorded."""

    time_ns: np.ndarray  #: [ns], (n,), increasing
    position: np.ndarray  #: [m], (n, 3), in the frame of the trajectories
    scored_from_ns: int = 0  #: the tool is fully engaged from here on
    wrench: np.ndarray | None = None  #: on the tool [N, N m], (n, 6), in the frame of the trajectories; for "mirror"
    revolution_ns: float = 0.0  #: [ns], of the spindle: what the teeth do within it is no error that a knot can follow
    noise: float = 0.0  #: [m], stated standard deviation of each position along each axis

    @property
    def scored(self) -> np.ndarray:
        """(n,) bool: fully engaged and, where the wrench is known, cutting; the last sample if there is no other."""
        engaged = self.time_ns >= min(self.scored_from_ns, int(self.time_ns[-1]))
        if self.wrench is None:
            return engaged
        cutting = engaged & self.wrench.any(axis=1)
        return cutting if cutting.any() else engaged

    def mean_wrench(self, knots_ns: np.ndarray) -> np.ndarray:
        """(k, 6): mean over the samples that are nearer to a knot than to any other; 0 where there is none."""
        if self.wrench is None:
            raise ModelError("the method needs the wrench of the pass, which was not measured")
        nearest = np.searchsorted(0.5 * (knots_ns[:-1] + knots_ns[1:]), self.time_ns)
        count = np.bincount(nearest, minlength=knots_ns.size)
        total = np.stack([np.bincount(nearest, w, knots_ns.size) for w in self.wrench.T], axis=1)
        return total / np.maximum(count, 1)[:, None]

    def sampled_displacement(self, reference: Trajectory, knots_ns: np.ndarray) -> np.ndarray:
        """[m], (k, 3): what the load did to the reference that was run, at the knots.

        Each is the mean over one revolution, so that no tooth passing is aliased.
        """
        time, shift = self.time_ns.astype(float), self.position - reference.sample(self.time_ns)
        steps = 0.5 * (shift[1:] + shift[:-1]) * np.diff(time)[:, None]
        area = np.concatenate([np.zeros((1, shift.shape[1])), np.cumsum(steps, axis=0)])
        knots = np.clip(knots_ns.astype(float), time[0], time[-1])
        half = np.minimum(0.5 * self.revolution_ns, np.minimum(knots - time[0], time[-1] - knots))
        wide = half > 0.0
        means = []
        for axis, total in zip(shift.T, area.T, strict=True):
            mean = np.interp(knots, time, axis)
            over = np.interp((knots + half)[wide], time, total) - np.interp((knots - half)[wide], time, total)
            mean[wide] = over / (2.0 * half[wide])
            means.append(mean)
        return np.column_stack(means)


def sampled_correction(target: Trajectory, reference: Trajectory, record: PassRecord) -> np.ndarray:
    """c_k = -delta(t_k) [m], (k, 3), Fig. 14: the displacement of a pass along ``reference`` at the target's knots."""
    if len(record.time_ns) < 2 or not np.all(np.isfinite(record.position)):
        raise ModelError("a pass of at least two finite tool positions is needed to revise the reference")
    return -record.sampled_displacement(reference, target.time_ns)


def corrected(
    target: Trajectory,
    offset: np.ndarray,
    smooth: bool,
    bounds: Bounds = UNBOUNDED,
    *,
    quaternion: np.ndarray | None = None,
) -> tuple[Trajectory, tuple[Limited, ...]]:
    """Add a correction to the target within bounds; return the reference, and where the correction was limited.

    offset: the correction [m] of the knots, (k, 3); quaternion: orientations that belong to the offset, (k, 4),
    None: those of the target.

    Straight lines between the knots are what a controller runs as LIN motions: on a curved target these are its chords
    (see ``chord_error``). A smooth reference is the motion that the controller runs through its points in SPLINE blocks
    (``controller_motion``): C2 in time, and at rest at the first point, at the stops of the target and at the last
    point. While the target rests the correction stays at its mean: the chips end with the feed, and a tool that
    follows the fading load would leave a mark that no program point can remove.
    """
    ends = block_ends(target)

    def slopes(knots: np.ndarray) -> np.ndarray | None:
        return spline_slopes(target.time, knots, ends) if smooth else None

    wanted = _rested(target, np.asarray(offset, float))
    size = np.linalg.norm(wanted, axis=1, keepdims=True)
    shorter = wanted * np.minimum(1.0, bounds.max_correction / np.maximum(size, 1e-300))
    shorter = _smaller(target, shorter, slopes, bounds)
    knots = _slower(target, shorter, slopes, bounds)
    limited = describe("size", target.time, wanted, shorter) + describe("change", target.time, shorter, knots)
    turned = target.quaternion
    if quaternion is not None:
        share = np.linalg.norm(knots, axis=1, keepdims=True) / np.maximum(size, 1e-300)
        turned = slerp(target.quaternion, quaternion, np.where(size > 0, np.minimum(share, 1.0), 1.0))
    position = target.sample(target.time_ns) + knots
    reference = Trajectory(target.time_ns, position, turned, None, target.frame)
    return controller_motion(reference, target) if smooth else reference, limited


def resting_segments(target: Trajectory) -> np.ndarray:
    """(k - 1,) True for segments along which the target rests."""
    still = target.standing
    # rounding in a file moves the knots of a rest by up to 10 nm
    return still[1:] & still[:-1] & (np.linalg.norm(np.diff(target.position, axis=0), axis=1) < 1e-8)


def _rested(target: Trajectory, correction: np.ndarray) -> np.ndarray:
    """Replace the corrections of all knots of a rest of the target by their mean."""
    same = resting_segments(target)
    if not same.any():
        return correction
    rest = np.concatenate([[0], np.cumsum(~same)])
    mean = np.stack([np.bincount(rest, axis) for axis in correction.T], axis=1) / np.bincount(rest)[:, None]
    return mean[rest]


def _ticks(target: Trajectory, tick: float) -> np.ndarray:
    """[ns], every ``tick`` [s] of the target and one beyond its end."""
    return np.rint(np.arange(0.0, target.time[-1] + tick, tick) * 1e9).astype(np.int64)


def _smaller(target: Trajectory, wanted: np.ndarray, slopes, bounds: Bounds) -> np.ndarray:
    """Corrections [m] of which no tick sees more than is allowed: a spline overshoots its shortened knots."""
    largest = bounds.max_correction
    if not np.isfinite(largest):
        return wanted
    ticks = _ticks(target, bounds.tick)
    before = np.clip(np.searchsorted(target.time_ns, ticks, side="right") - 1, 0, len(target) - 2)
    knots = wanted
    for _ in range(ROUNDS):
        size = np.linalg.norm(target.with_position(knots, slopes(knots)).sample(ticks), axis=1)
        over = size > largest * (1.0 + 1e-9)
        if not over.any():
            return knots
        share = np.ones(len(knots))
        for beside in (before[over], before[over] + 1):
            np.minimum.at(share, beside, 0.999 * largest / size[over])
        knots = _rested(target, knots * share[:, None])
    return knots * (largest / size.max())


def _slower(target: Trajectory, wanted: np.ndarray, slopes, bounds: Bounds) -> np.ndarray:
    """Corrections [m] that change by no more than is allowed in a tick; slopes(knots): those of the spline, or None."""
    max_change = bounds.max_change
    if not np.isfinite(max_change):
        return wanted
    ticks = _ticks(target, bounds.tick)
    first, last = (target.locate(t)[0] for t in (ticks[:-1], np.minimum(ticks[1:], target.duration_ns) - 1))
    knots, most = wanted, np.diff(target.time) * (max_change / bounds.tick)
    for tried in range(ROUNDS):
        run = target.with_position(knots, slopes(knots))
        change = np.linalg.norm(np.diff(run.sample(ticks), axis=0), axis=1)
        over = change > max_change * (1.0 + 1e-6)
        if not over.any():
            return knots
        for segment in (first, last) if tried else ():
            np.multiply.at(most, segment[over], 0.999 * max_change / change[over])
        knots = limit_change(wanted, most)
    return knots * (max_change / change.max())  # the slope of a spline scales with its height


def chord_error(target: Trajectory) -> float:
    """Largest distance [m] of the chords between the knots from the target, which straight lines add on arcs."""
    middle = (target.time_ns[1:] + target.time_ns[:-1]) // 2
    off = target.sample(middle) - 0.5 * (target.position[1:] + target.position[:-1])
    move = np.diff(target.position, axis=0)
    along = np.sum(off * move, axis=1, keepdims=True) / np.maximum(np.sum(move**2, axis=1, keepdims=True), 1e-300)
    return float(np.max(np.linalg.norm(off - along * move, axis=1)))
