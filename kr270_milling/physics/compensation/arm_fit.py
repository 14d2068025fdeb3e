"""The arm fitted to passes: frequency and damping of the modes that matter, static gain and compliance.

Fitted to (deviation now - deviation of the uncorrected pass) = response to the correction and, where the wrench of the
passes is known, to deviation of the uncorrected pass = displacement under wrench and inertia + a constant offset. All
are factors on the model's values with log-normal priors, so the model stays where the passes show nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from kr270_milling.physics.compensation.response import ArmResponse, Segments

#: assumed: standard deviations of the logarithms of gain, compliance, frequencies and damping ratios before any pass
PRIOR = {"gain": 0.1, "softness": 0.2, "frequency": 0.2, "damping": 0.7}
KEPT = 4  #: latest corrected passes that are fitted
MOST_FITTED = 8192  #: segments; of a longer path PIECES are fitted
PIECES, PIECE = 4, 1024  #: pieces, evenly spread over the path, and segments of each


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of a pass: the cubics of its correction, deviation and wrench in each part."""

    cubic: np.ndarray  #: (m, 4, 3)
    deviation: np.ndarray  #: [m], (m, parts, 3)
    wrench: np.ndarray | None  #: [N, N m], (m, parts, 6)
    on_path: np.ndarray | None = None  #: wrench on a tool on its path [N, N m], (m, parts, 6)


class _Problem:
    """Residuals of one fit; its numbers are log gain, log softness, log factors of the modes, offset."""

    def __init__(self, arm: ArmResponse, segments: Segments, path, approach, passes, weight, noise):
        self.arm, self.segments, self.path, self.approach = arm, segments, path, approach
        self.first, self.later = passes[0], passes[1:][-KEPT:]
        self.weight = weight[..., None]
        # assumed: the model of the cut leaves 1 um of the uncorrected pass unexplained, and 0.3 um of the difference of
        # two passes, in which most of the error cancels
        self.sigma = np.hypot(1e-6, noise), np.hypot(0.3e-6, np.sqrt(2.0) * noise)
        self.modes = self._sensitive()
        n = self.modes.size
        spread = [PRIOR["gain"], PRIOR["softness"]] + [PRIOR["frequency"]] * n + [PRIOR["damping"]] * n
        # assumed: a constant offset between arm and part has a standard deviation of 50 um
        self.prior = np.array(spread + [50e-6] * 3)

    def start(self, frequency: float, damping: float) -> np.ndarray:
        n = self.modes.size
        return np.concatenate([[0.0, 0.0], np.full(n, np.log(frequency)), np.full(n, np.log(damping)), np.zeros(3)])

    def arm_of(self, numbers: np.ndarray) -> ArmResponse:
        """Return the arm; modes that are not fitted take the mean factors of the fitted modes."""
        fitted = numbers[2:-3].reshape(2, -1)  # logarithms, of frequencies and of damping ratios
        mean = fitted.mean(axis=1, keepdims=True) if fitted.size else np.zeros((2, 1))
        factors = np.tile(np.exp(mean), (1, self.arm.order))
        factors[:, self.modes] = np.exp(fitted)
        return self.arm.scaled(factors[0], factors[1], float(np.exp(numbers[0])), float(np.exp(numbers[1])))

    def residuals(self, numbers: np.ndarray) -> np.ndarray:
        arm, first, (single, double) = self.arm_of(numbers), self.first, self.sigma
        parts = [numbers / self.prior]
        if first.wrench is not None:
            model = self._uncorrected(arm) + numbers[-3:]
            parts.append((self.weight * (model - first.deviation) / single).ravel())
        for evidence in self.later:
            model = arm.follow(self.segments, evidence.cubic) - arm.follow(self.segments, first.cubic)
            if first.wrench is not None and evidence.wrench is not None:
                model = model + arm.deflect(self.segments, evidence.wrench - first.wrench)
            parts.append((self.weight * (model - (evidence.deviation - first.deviation)) / double).ravel())
        return np.concatenate(parts)

    def _uncorrected(self, arm: ArmResponse) -> np.ndarray:
        swing = arm.swing(self.segments, self.path, self.approach)
        return swing if self.first.wrench is None else arm.deflect(self.segments, self.first.wrench) + swing

    def _sensitive(self) -> np.ndarray:
        """Modes whose frequency changes what the passes show, and slow enough for the means over the parts."""
        effect = np.zeros(self.arm.order)
        for mode in range(self.arm.order):
            factor = np.where(np.arange(self.arm.order) == mode, 1.05, 1.0)
            effect[mode] = sum(np.sum((self.weight * change) ** 2) for change in self._changes(factor))
        # 1 rad of a mode within a part: means over the parts say little about a faster mode
        slow = self.arm.frequency[0] * float(np.median(self.segments.duration)) / self.segments.parts < 1.0
        # a fitted mode has at least 0.3 % of the sensitivity to all modes
        return np.flatnonzero(slow & (effect > 0.003 * max(effect.sum(), 1e-300)))

    def _changes(self, factor: np.ndarray):
        other = self.arm.scaled(factor, 1.0)
        if self.first.wrench is not None:
            yield self._uncorrected(other) - self._uncorrected(self.arm)
        for evidence in self.later:
            yield other.follow(self.segments, evidence.cubic) - self.arm.follow(self.segments, evidence.cubic)


def fit_arm(
    arm: ArmResponse,
    segments: Segments,
    path: np.ndarray,
    approach: np.ndarray,
    passes: tuple[Evidence, ...],
    weight: np.ndarray,
    noise: float,
) -> tuple[ArmResponse, dict | None]:
    """Return the arm that explains the passes, the uncorrected pass first, and the fitted values as written to JSON.

    The gain is that of the response to the reference; modes that the passes do not show are missing.

    path: cubics of the programmed path, (m, 4, 3); approach: its velocity before [m/s], (3,); weight: (m, parts);
    noise: standard deviation of the deviation of a part [m]. Nothing is fitted before the first corrected pass where
    the wrench is not known.
    """
    if not arm.order or (passes[0].wrench is None and not passes[1:]):
        return arm, None
    whole = arm
    if len(segments) > MOST_FITTED:
        arm, segments, path, passes, weight = _pieces(arm, segments, path, passes, weight)
    problem = _Problem(arm, segments, path, approach, passes, weight, noise)
    best = problem.start(1.0, 1.0)
    rest = problem.residuals(best)
    scan = np.exp(np.arange(-0.4, 0.41, 0.05)), (0.4, 1.0, 2.5)  # factors on frequency and damping that are tried first
    if rest @ rest > rest.size:  # the model leaves more than the errors that are supposed
        starts = [problem.start(frequency, damping) for frequency in scan[0] for damping in scan[1]]
        best = min(starts, key=lambda numbers: float(np.sum(problem.residuals(numbers) ** 2)))
    numbers = least_squares(problem.residuals, best, x_scale=problem.prior, ftol=1e-6, xtol=1e-6, max_nfev=30).x
    fitted, problem.arm = problem.arm_of(numbers), whole
    modes = [
        {"mode": mode + 1, "frequency_hz": float(frequency), "damping_ratio": float(damping)}
        for mode, frequency, damping in zip(
            problem.modes.tolist(),
            fitted.frequency[0, problem.modes] / (2.0 * np.pi),
            fitted.damping[0, problem.modes],
            strict=True,
        )
    ]
    return problem.arm_of(numbers), {"gain": fitted.gain, "compliance_factor": fitted.softness, "modes": modes}


def _pieces(arm: ArmResponse, segments: Segments, path, passes: tuple[Evidence, ...], weight):
    """These arguments of ``_Problem`` for some pieces of a long path, one after another as if they were one path.

    A handful of numbers does not need every segment, and the cost of the fit does not grow with the path.
    """
    starts = np.linspace(0, len(segments) - PIECE, PIECES).astype(int)
    rows = (starts[:, None] + np.arange(PIECE)).ravel()
    time_ns = np.concatenate([[0], np.cumsum(np.diff(segments.time_ns)[rows])])
    # 3 s at the start of a piece do not count: a mode of 7 Hz and 4 % forgets how the piece began
    settling = min(PIECE // 2, int(3.0 / np.median(segments.duration)))
    counts = (np.arange(rows.size) % PIECE >= settling) | (rows < PIECE)
    shown = tuple(
        Evidence(
            evidence.cubic[rows], evidence.deviation[rows], None if evidence.wrench is None else evidence.wrench[rows]
        )
        for evidence in (passes[0], *passes[1:][-KEPT:])
    )
    part = Segments(time_ns, segments.parts)
    return arm.cut(rows), part, path[rows], shown, np.where(counts[:, None], weight[rows], 0.0)
