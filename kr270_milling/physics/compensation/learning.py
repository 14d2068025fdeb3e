"""The methods ``inverse``, ``learned`` and ``robust``: passes, the arm that explains them, and the correction.

A pass is explained by deviation = displacement under wrench and inertia + response to the correction + rest. The next
correction removes the modelled deviation of a tool that runs on its path. It also removes the share
g = max(0, 1 - noise^2 / rest^2) of the rest, averaged over the passes and, if noisy, over the distance of two knots:
nothing of a rest below the stated noise of the measurement, all of a rest without noise.

The arm is fitted to passes: frequency and damping of the modes that matter, static gain and compliance, such that
(deviation now - deviation of the uncorrected pass) = response to the correction and, where the wrench of the passes is
known, deviation of the uncorrected pass = displacement under wrench and inertia + a constant offset. All are factors on
the model's values with log-normal priors, so the model stays where the passes show nothing.

``robust`` changes the correction of ``inverse`` by the c with the least mean square over simulated robots:

    E_k |d_k + H_k c|^2 + S c^2 -> min,   d_k = d_model + (pass of robot k - pass of the model)

The mean over a sample replaces the expectation [Kleywegt2002]. Both passes run along the reference of ``inverse``, so
d_k contains backlash and the answer of the cut; H_k is the response of the robot: arm, base, servo lag and delay. The
cut also answers the correction, which H_k leaves out: the robots run again along the new reference, and c is added to.

A robot may swing by itself, which no H_k contains. So the cost of a robot grows with the logarithm where the square of
its largest deviation l exceeds m^2, the median along ``inverse``; s_k is the share of its square [Huber1981]:

    cost = min(l^2, m^2) + m^2 log(max(l^2 / m^2, 1)),   s_k = min(1, m^2 / l_k^2)
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares

from kr270_milling.base.errors import ModelError
from kr270_milling.path.controller_motion import block_ends, controller_motion
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.ensemble import least_mean_square
from kr270_milling.physics.compensation.lifted import KnotConditions, Lifted, knots
from kr270_milling.physics.compensation.response import ArmResponse, Segments, cubic_coefficients
from kr270_milling.physics.compensation.revision import PassRecord, corrected, resting_segments
from kr270_milling.physics.motion.dynamics import ArmFactors

#: assumed: standard deviations of the logarithms of gain, compliance, frequencies and damping ratios before any pass
PRIOR = {"gain": 0.1, "softness": 0.2, "frequency": 0.2, "damping": 0.7}
KEPT = 4  #: latest corrected passes that are fitted
MOST_FITTED = 8192  #: segments; of a longer path PIECES are fitted
PIECES, PIECE = 4, 1024  #: pieces, evenly spread over the path, and segments of each


@dataclass(frozen=True, eq=False)
class CellModels:
    """Functions of one cell; None: not available."""

    #: target, mean wrenches (k, 6) [N, N m] at its knots -> points that the load moves onto the target, (30)-(32)
    mirror: Callable[[Trajectory, np.ndarray], Trajectory] | None = None
    #: target -> the response of the arm along the target; None: the tool follows the reference at once
    arm: Callable[[Trajectory], ArmResponse] | None = None
    #: reference, factors on the modelled arm or None -> the pass that the model predicts
    predict: Callable[[Trajectory, ArmFactors | None], PassRecord] | None = None
    #: path of a tool that does not deviate -> wrenches of the modelled cut
    cut: Callable[[Trajectory], PassRecord] | None = None
    #: target, reference -> the model first and then drawn robots: response, true pass along the reference
    robots: Callable[[Trajectory, Trajectory], list[tuple[ArmResponse, PassRecord]]] | None = None


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


UNSCORED = 0.05  #: weight of deviations before full engagement and in the air
FREE = 0.3  #: their weight in the fit of the arm: a tool without load separates a constant offset from the compliance
ALONG = 0.1  #: weight of deviations along the feed, which change the time and not the part
SMOOTHNESS = 1e-5  #: weight of the roughness without noise: prevents neighbouring knots from cancelling each other
ROUGH = 3e-6  #: [m], assumed: size of the differences of a correction against loads; noise beyond it is smoothed
LONG = 600_000_000_000  #: [ns], assumed: the passes of a longer program take minutes each, so two must do
MISFIT = 0.05  #: error of the deviation on the path that a pass gives, as a share of the deviation of the pass


class Learner:
    """The passes along corrections of one target, the arm that explains them, and the next correction.

    criterion: "min_max" or "least_squares"; models: the predicted pass and the modelled cut are used where they exist.
    """

    def __init__(
        self,
        target: Trajectory,
        arm: ArmResponse,
        conditions: KnotConditions,
        criterion: str,
        models: CellModels,
    ):
        self.target = target
        self.model = arm
        self.arm = arm  #: as the passes show it
        self.conditions = conditions
        self.criterion = criterion
        self._predict, self._cut, self._robots = models.predict, models.cut, models.robots
        #: simulated robots: response and deviation [m], (m, parts, 3), of a pass along the same correction
        self.ensemble: list[tuple[ArmResponse, np.ndarray]] = []
        self._ran = np.zeros((1, 4, 3))  # cubics of that correction
        self._ideal: np.ndarray | None = None  # wrench of the model's cut on the path itself
        self.segments = Segments.of(target.time_ns)
        self.path = cubic_coefficients(target.time_ns, target.position, target.velocity)
        self.identified: dict | None = None
        self.passes: tuple[Evidence, ...] = ()
        self.only: PassRecord | None = None  #: the pass, of a learner that knows one
        #: deviation on the path without a correction [m], (m, parts, 3)
        self.expected = np.zeros((len(self.segments), self.segments.parts, 3))
        self._noise = 0.0  # [m], of the deviation of a part
        self._rough = 0.0  # [m], of it in ``expected``

    @classmethod
    def of_model(cls, target: Trajectory, models: CellModels, criterion: str, smooth: bool) -> Learner:
        """Return a learner without passes, which knows the model alone."""
        stops = block_ends(target) if smooth else target.standing
        conditions = KnotConditions(smooth, stops, resting_segments(target))
        arm = models.arm(target) if models.arm else ArmResponse.rigid(len(target) - 1)
        return cls(target, arm, conditions, criterion, models)

    def cubic(self, reference: Trajectory) -> np.ndarray:
        """Cubics of reference minus target, (m, 4, 3); raises ModelError where their knots differ in time."""
        if not np.array_equal(reference.time_ns, self.target.time_ns):
            of = self.target
            raise ModelError(
                f"the reference trajectory that was run ({len(reference)} knots in {reference.duration_ns * 1e-9:g} s) "
                f"must have its knots at the times of the target's ({len(of)} in {of.duration_ns * 1e-9:g} s): "
                "another target or another compensator led to it"
            )
        return cubic_coefficients(reference.time_ns, reference.position, reference.velocity) - self.path

    def with_pass(self, record: PassRecord, reference: Trajectory) -> Learner:
        """Return a learner that has also learned from a pass along ``reference``, unless that is its only pass."""
        learner = copy.copy(self)
        learner.ensemble = []
        if record is not self.only:
            learner.learn(record, reference)
        return learner

    def learn(self, record: PassRecord, reference: Trajectory) -> None:
        """Take a pass along ``reference`` into account."""
        segments, time_ns = self.segments, record.time_ns
        deviation = segments.middle(time_ns, record.position - self.target.sample(time_ns))
        last = self._evidence(record, self.cubic(reference), deviation)
        self.scored = self._scored(record)
        self._noise = record.noise / np.sqrt(max(1.0, time_ns.size / self.scored.size))
        weight = np.where(self.scored, 1.0, FREE)
        passes = (*self.passes, last)
        self.arm, self.identified = fit_arm(
            self.model, segments, self.path, self.path[0, 1], passes, weight, self._noise
        )
        if last.wrench is not None and last.on_path is None:
            last = dataclasses.replace(last, on_path=self._on_path(last.wrench, reference))
        self.only = None if self.passes else record
        self.passes = (*self.passes, last)
        self.expected = self._expected()

    def forget(self) -> None:
        """Drop the passes, of which an hour of machining fills 170 MB each; arm and expectation stay."""
        self.passes, self.only, self._ideal, self.ensemble = (), None, None, []

    def expect(self) -> Learner:
        """Without any pass: expect the modelled arm under the wrench of the modelled cut on the path itself."""
        if self._cut is None:
            raise ModelError("without a pass the wrench must come from the model's cut")
        record = self._cut(self.target)
        self._ideal, self.scored = self._wrench(record), self._scored(record)
        self.expected = self.arm.swing(self.segments, self.path, self.path[0, 1])
        if self._ideal is not None:
            self.expected = self.expected + self.arm.deflect(self.segments, self._ideal)
        return self

    def _scored(self, record: PassRecord) -> np.ndarray:
        """(m, parts) bool: parts in which a sample is scored, and those before them."""
        scored = self.segments.mean(record.time_ns, record.scored[:, None].astype(float)).ravel() > 0.0
        scored[:-1] |= scored[1:]  # up to the edge of the first part
        return scored.reshape(len(self.segments), self.segments.parts)

    def _evidence(self, record: PassRecord, cubic: np.ndarray, deviation: np.ndarray) -> Evidence:
        """Return the evidence of a pass; an unknown wrench is that of the first pass, or of the model's pass."""
        wrench = self._wrench(record)
        if wrench is None and self.passes:
            return dataclasses.replace(self.passes[0], cubic=cubic, deviation=deviation)
        if wrench is None and self._predict is not None:
            wrench = self._wrench(self._predict(self.target, None))
        return Evidence(cubic, deviation, wrench)

    def _wrench(self, record: PassRecord) -> np.ndarray | None:
        """In each part, (m, parts, 6); None where it is not known."""
        if record.wrench is None or not record.wrench.any():
            return None
        middle = np.concatenate([record.time_ns[:1], (record.time_ns[1:] + record.time_ns[:-1]) // 2])
        return self.segments.mean(middle, record.wrench)  # each is the mean of the period that ends at its stamp

    def _expected(self) -> np.ndarray:
        """Deviation [m], (m, parts, 3), of a tool that runs on its path without a correction of the reference."""
        segments, last = self.segments, self.passes[-1]
        ideal = swing = self.arm.swing(segments, self.path, self.path[0, 1])
        if last.on_path is not None:
            ideal = ideal + self.arm.deflect(segments, last.on_path)
        shares = np.zeros(len(self.passes))
        for n, evidence in enumerate(self.passes):
            size = np.sqrt(np.mean(evidence.deviation[self.scored] ** 2)) if self.scored.any() else 0.0
            shares[n] = 1.0 / (self._noise**2 + (MISFIT * size) ** 2 + 1e-24)
        shares /= shares.sum()

        def mean(values) -> np.ndarray:  # the response of the arm to the mean is the mean of its responses
            return sum((share * value for share, value in zip(shares, values, strict=True)), np.zeros(1))

        rest = mean(evidence.deviation for evidence in self.passes) - swing
        rest -= self.arm.follow(segments, mean(evidence.cubic for evidence in self.passes))
        if self.passes[0].wrench is not None:
            rest -= self.arm.deflect(segments, mean(evidence.wrench for evidence in self.passes))
        noise = self._noise**2 * np.sum(shares**2)
        if noise:  # the mean over a knot's distance, of which a correction can make use
            width = segments.parts
            rest = uniform_filter1d(rest.reshape(-1, 3), width, axis=0, mode="nearest").reshape(rest.shape)
            noise /= width
        power = np.mean(rest[self.scored] ** 2) if self.scored.any() else 0.0
        share = max(0.0, 1.0 - noise / max(power, 1e-300))
        self._rough = share * np.sqrt(noise)
        return ideal + share * rest

    def _on_path(self, wrench: np.ndarray, reference: Trajectory) -> np.ndarray:
        """w + k (w_c(path) - w_m): the wrench of a pass along ``reference``, had its tool not deviated.

        w_c(path) is the wrench of the model's cut on the path, w_m that of the model's pass with the arm as known
        so far, k the factor that explains w with w_m. A tool that drifts across the feed turns its chips, one that
        sinks cuts with its whole end: both damp what the arm does. w_m is of a pass, in which arm and cut agree, and
        not of a cut along the deviation that was measured: 1 um more depth changes the thrust of the end edges by some
        25 N, which the arm answers with 9 um, so that the error of such a thrust exceeds what it is to explain.
        """
        if self._cut is None or self._predict is None:
            return wrench
        with ThreadPoolExecutor(1) as pool:  # both run without the interpreter's lock
            cut = pool.submit(self._cut, self.target) if self._ideal is None else None
            modelled = self._wrench(self._predict(reference, self.arm.factors_on(self.model)))
            if cut:
                self._ideal = self._wrench(cut.result())
        if modelled is None or self._ideal is None:
            return wrench
        factor = max(0.0, np.sum(wrench[..., :3] * modelled[..., :3]) / np.sum(modelled[..., :3] ** 2))
        return wrench + factor * (self._ideal - modelled)

    def correction(self) -> np.ndarray:
        """Values [m] at the knots, (k, 3), for the motion of a program: a C2 spline, or straight lines."""
        lifted = Lifted(self.arm, self.segments, self.conditions)
        # the motion through the programmed points deviates from the path between them without any load
        plain = self.target.with_position(self.target.position)
        base = self._with(controller_motion(plain, self.target) if self.conditions.smooth else plain)
        smoothness = SMOOTHNESS + (self._rough / ROUGH) ** 2
        if self.criterion == "min_max" and not self._rough:
            cubic, _ = lifted.min_max(base, self._weight(), smoothness, self.scored)
        else:
            cubic, _ = lifted.least_squares(base, self._weight(), smoothness)
        return knots(self.segments, cubic)

    def robust_correction(self) -> np.ndarray:
        """Values [m] at the knots, (k, 3), for the simulated robots; that of the model where there are none."""
        offset = self.correction()
        if self._robots is None:
            return offset
        segments, weight, smooth = self.segments, self._weight(), self.conditions.smooth
        settled_gain = 1e-4  # of the cost of the path as programmed: a step of the search that gains less is the last
        settled = settled_gain * float(np.einsum("kpi,kpij,kpj->", self.expected, weight, self.expected))
        best, tried, bias, usual, count = np.inf, offset, 0.0, 0.0, 0
        # weight of the roughness of the change for many robots: a rougher change, which each robot answers otherwise,
        # gains less than 1 % of the mean square and needs twice the correction (pocket of the tutorial)
        careful = 1.0
        # most passes of the simulated robots; the cut answers the correction, so the first one is not the last
        rounds = 4 if self.target.duration_ns < LONG else 2
        # of the least mean cost: a reference that costs more is the last. Robots that swing by themselves change the
        # mean cost by 5 % with the last bit of the reference, so a smaller difference must not choose among the rounds
        alike = 1.05
        for number in range(rounds):
            reference, _ = corrected(self.target, tried, smooth)
            passes = [
                (arm, segments.middle(record.time_ns, record.position - self.target.sample(record.time_ns)))
                for arm, record in self._robots(self.target, reference)
            ]
            if number == 0:  # the pass of the model beyond what ``inverse`` expects
                bias = passes[0][1] - self._with(reference)
            drawn, cubic = [(arm, deviation - bias) for arm, deviation in passes[1:]], self.cubic(reference)
            if not drawn:
                break
            largest = np.array([self._largest(deviation, weight) for _, deviation in drawn])
            if number == 0:
                usual, count = float(np.median(largest)), len(drawn)
            beyond = np.maximum(largest / max(usual, 1e-300), 1.0)
            size = float(np.mean(np.minimum(largest, usual) + usual * np.log(beyond)))
            if len(drawn) != count or size > alike * best:
                break
            best, offset = min(best, size), tried
            self.ensemble, self._ran = drawn, cubic
            if number + 1 == rounds:
                break
            shares = 1.0 / beyond
            change = least_mean_square(self.arm, segments, self.conditions, drawn, shares, weight, careful, settled)
            tried = offset + knots(segments, change)
            if np.array_equal(tried, offset):
                break
        return offset

    def _with(self, reference: Trajectory) -> np.ndarray:
        """Deviation [m], (m, parts, 3), of a tool that runs along ``reference`` without the feedback of the cut."""
        return self.expected + self.arm.follow(self.segments, self.cubic(reference))

    def _weight(self) -> np.ndarray:
        """(m, parts, 3, 3): across the feed one, along it less, where nothing is scored little."""
        feed = self.target.sample_velocity(self.segments.middle_ns)
        speed = np.linalg.norm(feed, axis=-1, keepdims=True)
        along = np.where(speed > 0.01 * speed.max(), feed / np.maximum(speed, 1e-300), 0.0)
        metric = np.eye(3) - (1.0 - ALONG**2) * along[..., None] * along[..., None, :]
        return np.where(self.scored, 1.0, UNSCORED**2)[..., None, None] * metric

    def inertia(self, time: float) -> float:
        """[m], size of the tool's displacement by the acceleration of the programmed path at a time [s]."""
        swing = self.arm.swing(self.segments, self.path, self.path[0, 1]).reshape(-1, 3)
        return float(np.linalg.norm(swing[self.segments.part_of(np.array([round(time * 1e9)]))[0]]))

    def predicted(self, *references: Trajectory) -> list[float]:
        """Largest deviation across the feed [m] that the model expects along each reference where it is scored.

        With an ensemble of robots the root mean square of their largest deviations.
        """
        weight, robots, sizes = self._weight(), self.ensemble or [(self.arm, self.expected)], []
        for reference in references:
            change = self.cubic(reference) - (self._ran if self.ensemble else 0.0)
            deviations = (deviation + arm.follow(self.segments, change) for arm, deviation in robots)
            sizes.append(float(np.sqrt(np.mean([self._largest(left, weight) for left in deviations]))))
        return sizes

    def _largest(self, deviation: np.ndarray, weight: np.ndarray) -> float:
        """Largest square [m^2] of a deviation (m, parts, 3) where it is scored."""
        return float(np.einsum("kpi,kpij,kpj->kp", deviation, weight, deviation)[self.scored].max(initial=0.0))
