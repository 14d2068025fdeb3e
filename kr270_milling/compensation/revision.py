"""Off-line revision of the reference trajectory at the controller step, Fig. 9(a), Fig. 14.

All methods need what a pass shows: when and where the tool was. A shift of the reference moves the tool by the same
shift while the displacement under load stays nearly what it was, so ``reference' = target - displacement``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.linalg import solveh_banded

from kr270_milling.errors import MillingError
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["PassRecord", "RevisionError", "revise", "spline_fit"]


class RevisionError(MillingError):
    """A pass from which no revision can be made."""


@dataclass(frozen=True, eq=False)
class PassRecord:
    """Where the tool tip was in one pass, simulated, measured or recorded."""

    time_ns: np.ndarray  #: [ns], (n,), increasing
    position: np.ndarray  #: [m], (n, 3), in the frame of the trajectories
    scored_from_ns: int = 0  #: the tool is fully engaged from here on
    wrench: np.ndarray | None = None  #: on the tool [N, N m], (n, 6), in the frame of the trajectories; for "mirror"

    def mean_wrench(self, knots_ns: np.ndarray) -> np.ndarray:
        """(k, 6): mean over the samples that are nearer to a knot than to any other; 0 where there is none."""
        if self.wrench is None:
            raise RevisionError("the method mirror needs the wrench of the pass")
        nearest = np.searchsorted(0.5 * (knots_ns[:-1] + knots_ns[1:]), self.time_ns)
        count = np.bincount(nearest, minlength=knots_ns.size)
        total = np.stack([np.bincount(nearest, w, knots_ns.size) for w in self.wrench.T], axis=1)
        return total / np.maximum(count, 1)[:, None]

    def displacement(self, reference: Trajectory) -> np.ndarray:
        """[m], (n, 3): what the load did to the reference that was run."""
        return self.position - reference.sample(self.time_ns)


def revise(
    method: str,
    target: Trajectory,
    reference: Trajectory,
    ran: PassRecord,
    *,
    criterion: str = "min_max",
    max_correction: float = np.inf,
) -> tuple[Trajectory, float]:
    """The next reference trajectory after a pass along ``reference``, and the largest correction [m] that was cut off.

    method: "linear" (the paper's: sampled displacement, straight lines between the knots), "spline" (C2 through the
    same knots) or "learned" (spline knots that minimise the remaining error of the last pass, to be repeated).
    Corrections larger than max_correction [m] are shortened to it; the second value tells by how much (0: none).
    """
    if len(ran.time_ns) < 2 or not np.all(np.isfinite(ran.position)):
        raise RevisionError("a pass of at least two finite tool positions is needed to revise the reference")
    nominal = target.sample(target.time_ns)
    learned = method == "learned"
    if learned:
        error = ran.position - target.sample(ran.time_ns)
        knots = reference.sample(target.time_ns) - nominal - spline_fit(target.time_ns, ran, error, criterion)
    else:
        shift = ran.displacement(reference)
        knots = -np.column_stack([np.interp(target.time_ns, ran.time_ns, axis) for axis in shift.T])
    size = np.linalg.norm(knots, axis=1, keepdims=True)
    knots = knots * np.minimum(1.0, max_correction / np.maximum(size, 1e-300))
    cut_off = float(max(0.0, size.max() - max_correction))
    if method == "linear":
        return target.with_position(nominal + knots), cut_off
    rate = CubicSpline(target.time, knots, bc_type="not-a-knot" if learned else "natural")(target.time, 1)
    return target.with_position(nominal + knots, target.sample_velocity(target.time_ns) + rate), cut_off


def spline_fit(knots_ns: np.ndarray, ran: PassRecord, error: np.ndarray, criterion: str) -> np.ndarray:
    """Values [m], (k, 3), at the knots of the C2 cubic spline that is nearest to ``error`` (n, 3) where it is scored.

    "least_squares", or "min_max" by Lawson's reweighting [Lawson1961]. The unscored part only keeps the spline
    bounded. Banded normal equations: cost and memory are linear in the length of the pass.
    """
    time, knots = ran.time_ns * 1e-9, knots_ns * 1e-9
    inside = (time >= knots[0]) & (time <= knots[-1])
    full = np.concatenate([np.repeat(knots[0], 3), _not_a_knot(knots), np.repeat(knots[-1], 3)])
    basis = BSpline.design_matrix(time[inside], full, 3).tocsr()
    scored = ran.time_ns[inside] >= ran.scored_from_ns
    values = np.empty((knots.size, error.shape[1]))
    for axis, e in enumerate(error[inside].T):
        weight = np.where(scored, 1.0, 1e-6)
        for _ in range(1 if criterion == "least_squares" else 200):
            fit = _banded_least_squares(basis, e, weight)
            rest = np.abs(e - basis @ fit)
            if criterion == "least_squares" or rest[scored].max() < 1e-12:
                break
            weight[scored] *= rest[scored] / rest[scored].max()
            weight[scored] = np.maximum(weight[scored] / weight[scored].mean(), 1e-4)
        values[:, axis] = BSpline(full, fit, 3)(knots)
    return values


def _not_a_knot(knots: np.ndarray) -> np.ndarray:
    """The knots without the second and the last but one: as many coefficients as knots."""
    return np.concatenate([knots[:1], knots[2:-2], knots[-1:]])


def _banded_least_squares(basis, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    weighted = basis.multiply(weight[:, None]).tocsr()
    normal = (basis.T @ weighted).todia()
    bands = np.zeros((4, basis.shape[1]))
    for offset in range(4):
        bands[offset, : basis.shape[1] - offset] = normal.diagonal(-offset)
    bands[0] += 1e-9 * bands[0].max()  # a knot span without a sample stays where it is
    return solveh_banded(bands, basis.T @ (weight * values), lower=True)
