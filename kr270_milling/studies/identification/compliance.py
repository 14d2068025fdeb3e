"""Joint compliances from load tests: weighted non-linear least squares on the loaded model, with their intervals.

minimise sum w_i r_i(x)^2,  r = (model(x) - measurement) / sigma,  cov(x) = s^2 (A^T W A)^-1,  A = dr/dx.

s^2 and the interval are those of ``intervals``; where no standard deviations are stated, they are estimated from the
residuals, of translations and rotations each for itself.

How far a load moves a reflector follows from the loaded model (6), (7). With C = diag(c) of the joint compliances, the
springs bend by theta = C tau(q + theta), tau the torque of wrench, link weights and compensator. Derivation by one
compliance gives (1 - C H) dtheta/dc_j = tau_j e_j, H = dtau/dtheta. The displacement by the load is that of the loaded
posture less that of the posture under the weights alone.

A base that tilts adds two springs to C, about x and y of base_link. About z it turns the arm as joint 1 does, so that
no load test separates the two. The singular values of the weighted derivatives state which numbers the data identify.

In a load test a tracker measures how far a load moves a reflector.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import InputError, ModelError, ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.record import specs
from kr270_milling.base.table import Table, read_table, write_table
from kr270_milling.physics.robot.arm import Arm, GravityCompensator, Mount
from kr270_milling.physics.robot.kinematics import LinkFrames, forward, jacobian_at
from kr270_milling.physics.robot.loads import GRAVITY, link_loads, load_hessian, load_torque
from kr270_milling.studies.identification.intervals import half_interval, robust_variance, robust_weights, scatter

JOINTS = tuple(f"a{j}_deg" for j in range(1, 7))
WRENCH = ("fx_n", "fy_n", "fz_n", "mx_n_m", "my_n_m", "mz_n_m")
MASS = ("mass_kg", "mass_centre_x_mm", "mass_centre_y_mm", "mass_centre_z_mm")
SHIFT = ("dx_mm", "dy_mm", "dz_mm")
TILT = ("rx_mrad", "ry_mrad", "rz_mrad")
SIGMA = ("sigma_um", "sigma_mrad")
LOAD = ("load_x_mm", "load_y_mm", "load_z_mm")
REFLECTOR = ("reflector_x_mm", "reflector_y_mm", "reflector_z_mm")
COLUMNS = (*JOINTS, *WRENCH, *MASS, *LOAD, *REFLECTOR, *SHIFT, *TILT, *SIGMA, "note")


@dataclass(frozen=True, eq=False)
class Measurements:
    """n load tests. Base axes unless the name says otherwise; NaN: not measured."""

    q: np.ndarray  #: joint angles that the controller holds [rad], (n, 6)
    wrench: np.ndarray  #: test load, at ``application`` [N, N m], (n, 6)
    application: np.ndarray  #: where the load acts, flange frame [m], (n, 3)
    reflector: np.ndarray  #: flange frame [m], (n, 3)
    displacement: np.ndarray  #: translation and rotation vector of the reflector by the load [m, rad], (n, 6)
    sigma: np.ndarray  #: standard deviation of each of them [m, rad], (n, 6); relative ones if not ``sigma_known``
    sigma_known: bool

    def __len__(self) -> int:
        return len(self.q)

    def take(self, rows) -> Measurements:
        """Some of the rows."""
        arrays = ("q", "wrench", "application", "reflector", "displacement", "sigma")
        return dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in arrays})


def unmeasured(q: np.ndarray, force: np.ndarray, point: np.ndarray, sigma: float) -> Measurements:
    """Tests without a result: forces [N], (n, 3), at a point (3,) of the flange [m], where the reflector is, too."""
    n = len(q)
    wrench, place = np.hstack([force, np.zeros((n, 3))]), np.tile(point, (n, 1))
    return Measurements(q, wrench, place, place, np.full((n, 6), np.nan), np.full((n, 6), sigma), True)


def read_measurements(path, arm: Arm, mount: Mount) -> Measurements:
    """A CSV file of load tests, one a row; the columns are COLUMNS. Raises InputError."""
    table = read_table(path, COLUMNS, (*JOINTS, *SHIFT))
    angles = table.numbers(JOINTS)
    if len(angles) > 1 and np.abs(angles).max() <= 2 * np.pi:
        raise InputError(table.path, "all joint angles are within +-6.28: radians in the columns of degrees?")
    q = np.radians(angles)
    inside = (q >= arm.joint_lower - 1e-9) & (q <= arm.joint_upper + 1e-9)
    table.refuse(~inside.all(1), "the posture is outside of the joint limits of the arm")
    wrench, application = _loads(table, mount)
    reflector = _point(table, REFLECTOR, mount.xyz)
    shift = 1e-3 * table.numbers(SHIFT)
    farthest = 0.2  # [m] that a load test moves a reflector at most; more is a wrong unit
    table.refuse(np.abs(shift).max(1) > farthest, f"a load moved the arm by more than {1e3 * farthest:g} mm")
    tilt = 1e-3 * table.numbers(TILT, np.nan)
    sigma, known = _sigma(table)
    return Measurements(q, wrench, application, reflector, np.hstack([shift, tilt]), sigma, known)


def _given(table: Table, names) -> np.ndarray:
    """(n,): rows that have any of the columns."""
    return np.isfinite(table.numbers(names, np.nan)).any(1)


def _point(table: Table, names, default: np.ndarray) -> np.ndarray:
    """[m], (n, 3), ``default`` in rows that have none of the columns."""
    return np.where(_given(table, names)[:, None], 1e-3 * table.numbers(names, 0.0), default)


def _loads(table: Table, mount: Mount) -> tuple[np.ndarray, np.ndarray]:
    """Wrench (n, 6), base axes, and the point where it acts (n, 3), flange frame; a mass hangs in its centre."""
    forced, weighed = _given(table, WRENCH), _given(table, MASS[:1])
    table.refuse(forced & weighed, "has both a wrench and a mass")
    table.refuse(~forced & ~weighed, "has neither a wrench nor a mass_kg")
    mass = table.number("mass_kg", 0.0)
    table.refuse(weighed & ~(mass > 0.0), "mass_kg must be above 0")
    wrench = np.where(forced[:, None], table.numbers(WRENCH, 0.0), 0.0)
    wrench[weighed, 2] = -GRAVITY * mass[weighed]
    table.refuse(~wrench.any(1), "the load is zero")
    point = _point(table, LOAD, mount.xyz)
    return wrench, np.where(weighed[:, None], _point(table, MASS[1:], point), point)


def _sigma(table: Table) -> tuple[np.ndarray, bool]:
    """(n, 6) [m, rad] and whether the file states them in all rows."""
    known = "sigma_um" in table
    shift = 1e-6 * table.number("sigma_um", None if known else 1.0)
    tilt = 1e-3 * table.number("sigma_mrad", np.nan)
    # three reflectors 0.2 m apart: sigma of a rotation = sqrt(2) sigma of a position / 0.2 m [1/m]
    rotation_per_shift = np.sqrt(2.0) / 0.2
    tilt = np.where(np.isfinite(tilt), tilt, rotation_per_shift * shift)
    table.refuse(~((shift > 0.0) & (tilt > 0.0)), "a standard deviation must be above 0")
    return np.stack([shift] * 3 + [tilt] * 3, -1), known


def write_measurements(path, measured: Measurements, notes=(), remarks=None) -> None:
    """Write the same file; loads are wrenches, an empty value is not measured."""
    shift, tilt = np.hsplit(measured.displacement, 2)
    columns = {
        JOINTS: np.degrees(measured.q),
        WRENCH: measured.wrench,
        LOAD: 1e3 * measured.application,
        REFLECTOR: 1e3 * measured.reflector,
        SHIFT: 1e3 * shift,
        SIGMA[:1]: 1e6 * measured.sigma[:, :1],
    }
    if np.isfinite(tilt).any():
        columns |= {TILT: 1e3 * tilt, SIGMA[1:]: 1e3 * measured.sigma[:, 3:4]}
    numbers = np.hstack(list(columns.values())).tolist()
    texts = [[f"{v:.9g}" if np.isfinite(v) else "" for v in row] for row in numbers]
    rows = [[*row, remark] for row, remark in zip(texts, remarks or [""] * len(texts), strict=True)]
    write_table(path, [*itertools.chain(*columns), "note"], rows, notes)


COMPENSATOR = tuple(spec.name for spec in specs(GravityCompensator))
#: where the base may tilt, and the size of the unknown: [rad/(N m)], assumed, a third of the stiffest joint's
TILTS, TILT_SIZE = ("base x", "base y"), 5e-8
STEP = 1e-4  #: share of its scale by which a number of the compensator is changed for its derivative


@dataclass(frozen=True, eq=False)
class Problem:
    """Sought: factors x on the arm's six compliances, then on the compensator's numbers that are named, then on the
    compliances of the base about x and y.

    All are 1 for the arm as its file has it; a base that is rigid there has the factor 0, on TILT_SIZE. A residual is
    (model - measurement) / sigma, one for each finite number that was measured.
    """

    arm: Arm
    mount: Mount
    measured: Measurements
    gravity: bool = True
    compensator: tuple[str, ...] = ()
    base: bool = False  #: True if the compliance of the base is sought

    def __post_init__(self):
        for name in self.compensator:
            if name not in COMPENSATOR:
                raise ParameterError("compensator", name, "one of " + ", ".join(COMPENSATOR))
        if self.compensator and not (self.arm.compensator.present and self.gravity):
            allowed = "above 0 in the arm file, and gravity on, where a compensator is to be identified"
            raise ParameterError("arm.compensator.stiffness_n_per_mm", self.arm.compensator.stiffness / 1e3, allowed)

    @property
    def names(self) -> list[str]:
        joints, tilts = [f"joint {j}" for j in range(1, 7)], TILTS if self.base else ()
        return [*joints, *(f"compensator {name}" for name in self.compensator), *tilts]

    @property
    def is_compliance(self) -> np.ndarray:
        """(p,) bool: a compliance, and no number of the compensator."""
        return np.array([not name.startswith("compensator") for name in self.names])

    @property
    def is_base(self) -> np.ndarray:
        """(p,) bool: a compliance of the base."""
        return np.array([name in TILTS for name in self.names])

    @property
    def _spring(self) -> np.ndarray:
        """The named numbers of the compensator, of the arm file."""
        return np.array([getattr(self.arm.compensator, name) for name in self.compensator], float)

    @property
    def scale(self) -> np.ndarray:
        """Numbers at a factor of 1 [SI], (p,)."""
        tilts = np.where(self._tilts, self._tilts, TILT_SIZE)
        return np.concatenate([self.arm.joint_compliance, np.where(self._spring, self._spring, 1.0), tilts])

    @property
    def start(self) -> np.ndarray:
        """The factors of the arm file, (p,)."""
        return np.concatenate([np.ones(6), self._spring != 0.0, self._tilts != 0.0])

    @property
    def _tilts(self) -> np.ndarray:
        """Compliances of the base about x and y, of the arm file, if they are sought, (2,) or (0,)."""
        return self.arm.base_compliance[: len(TILTS) if self.base else 0]

    @functools.cached_property
    def _sprung(self) -> Arm:
        """The arm with springs wherever the base may turn."""
        base = self.arm.base_compliance.copy()
        base[: self._tilts.size] = self.scale[self.is_base]
        return self.arm.replace(base_compliance=base)

    def arm_at(self, x) -> Arm:
        """The arm with these factors."""
        values = np.asarray(x) * self.scale
        base = np.concatenate([values[self.is_base], self.arm.base_compliance[self._tilts.size :]])
        return self._balanced(values).replace(joint_compliance=values[:6], base_compliance=base)

    def _balanced(self, values: np.ndarray) -> Arm:
        """The arm with the compensator of these numbers [SI], (p,)."""
        changes = dict(zip(self.compensator, values[~self.is_compliance].tolist(), strict=True))
        return self.arm.replace(compensator=self.arm.compensator.replace(**changes)) if changes else self.arm

    @property
    def finite(self) -> np.ndarray:
        """(n, 6): what was measured."""
        return np.isfinite(self.measured.displacement)

    def residuals(self, x) -> np.ndarray:
        """(m,), in standard deviations."""
        return self.weighted(self.predict(x))[self.finite]

    def weighted(self, moved: np.ndarray) -> np.ndarray:
        """Residuals in standard deviations, (n, 6), NaN where nothing was measured."""
        return (moved - self.measured.displacement) / self.measured.sigma

    def linearised(self, x) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (m,) and their derivatives by the factors, (m, p); of the compensator's by differences."""
        x = np.asarray(x, float)
        moved, by_compliance = self._linear(x)
        columns = np.zeros((int(self.finite.sum()), len(x)))
        of_compliance = by_compliance * self.scale[self.is_compliance] / self.measured.sigma[..., None]
        columns[:, self.is_compliance] = of_compliance[self.finite]
        for k in np.flatnonzero(~self.is_compliance).tolist():
            more, less = x.copy(), x.copy()
            more[k] += STEP
            less[k] -= STEP
            columns[:, k] = (self.residuals(more) - self.residuals(less)) / (2 * STEP)
        return self.weighted(moved)[self.finite], columns

    def derivatives(self, x) -> np.ndarray:
        """The second of ``linearised``."""
        return self.linearised(x)[1]

    def slopes(self, x, tests: Measurements) -> np.ndarray:
        """A of other tests: translation of the reflector by the factors, in standard deviations, (k, 3, p)."""
        tests = dataclasses.replace(tests, displacement=np.zeros((len(tests), 6)))
        return dataclasses.replace(self, measured=tests).derivatives(x).reshape(len(tests), 6, -1)[:, :3]

    # --- the fit ---

    def by_number(self, weights: np.ndarray) -> np.ndarray:
        """Weights of the tests, (n,), for each number that was measured, (m,)."""
        return np.repeat(weights, 6)[self.finite.ravel()]

    def solve(self, start: np.ndarray, free: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """The factors of least weighted squares, (p,); those that are not free, (p,) bool, stay at the start."""
        if not free.any():
            return start
        root = np.sqrt(self.by_number(weights))

        def whole(part: np.ndarray) -> np.ndarray:
            x = start.copy()
            x[free] = part
            return x

        @functools.lru_cache(maxsize=1)  # residuals and derivatives of one place come from one evaluation
        def linearised(part: bytes):
            return self.linearised(whole(np.frombuffer(part)))

        def residuals(part):
            return root * linearised(part.tobytes())[0]

        def derivatives(part):
            return root[:, None] * linearised(part.tobytes())[1][:, free]

        return whole(least_squares(residuals, start[free], derivatives, method="lm", xtol=1e-8, ftol=1e-12).x)

    def with_estimated_sigma(self, left: np.ndarray, weights: np.ndarray, sought: int) -> Problem:
        """Standard deviations so that residuals ``left``, (n, 6), of translations and of rotations scatter by 1 each.

        p / m of each is taken by the fit of p = sought factors.
        """
        sigma = self.measured.sigma.copy()
        share = 1.0 - sought / self.finite.sum()
        for part in (slice(0, 3), slice(3, 6)):
            used = np.isfinite(left[:, part]) & (weights[:, None] > 0.0)
            if used.any():
                heavy = np.broadcast_to(weights[:, None], used.shape)[used]
                square = np.sum(heavy * left[:, part][used] ** 2) / np.sum(heavy) / share
                sigma[:, part] *= np.sqrt(max(square, 1e-24))
        return dataclasses.replace(self, measured=dataclasses.replace(self.measured, sigma=sigma))

    # --- the loaded model ---

    def predict(self, x) -> np.ndarray:
        """Displacements [m, rad], (n, 6), with these factors. Raises ModelError."""
        return self._linear(x)[0]

    def _linear(self, x) -> tuple[np.ndarray, np.ndarray]:
        """Displacements [m, rad], (n, 6), and their derivatives by the compliances that are sought, (n, 6, 6 or 8)."""
        values = np.asarray(x, float) * self.scale  # on the way to the fit these need not be those of an arm
        tilts, base = self._tilts.size, self._sprung.base_axes.size
        fixed = self._sprung.spring_compliance[tilts:base]
        compliance = np.concatenate([values[self.is_base], fixed, values[:6]])
        frames, by_axis = self._bent(self._balanced(values), compliance)
        place = frames.flange.apply(np.tile(self.measured.reflector, (2, 1)))
        full, rest = slice(0, len(self.measured)), slice(len(self.measured), None)
        turn = frames.flange.rotation
        tilt = Rotation.from_matrix(turn[full] @ np.swapaxes(turn[rest], -1, -2)).as_rotvec()
        slopes = jacobian_at(frames, place) @ by_axis
        slopes = np.concatenate([slopes[..., base:], slopes[..., :tilts]], -1)  # in the order of x
        return np.hstack([place[full] - place[rest], tilt]), slopes[full] - slopes[rest]

    def _bent(self, arm: Arm, c: np.ndarray) -> tuple[LinkFrames, np.ndarray]:
        """Newton's method on theta = C tau(q + theta), for the loaded postures and then those without test load.

        c: of the base, then of the joints, (k + 6,). Returns the frames of (2 n,) postures and dtheta/dc,
        (2 n, k + 6, k + 6).
        """
        loads = link_loads(arm, self.mount, GRAVITY if self.gravity else 0.0)
        q = self._sprung.on_base(np.tile(self.measured.q, (2, 1)))
        wrench = np.concatenate([self.measured.wrench, np.zeros_like(self.measured.wrench)])
        theta = np.zeros_like(q)
        iterations = 20
        precision = 1e-8  # [rad] of the last Newton step, which leaves its square
        most_bend = 0.1  # [rad] of a joint spring; beyond it no drive is linear
        for _ in range(iterations):
            frames = self._frames(q + theta)
            torque = load_torque(frames, wrench, loads)
            left = np.eye(len(c)) - c[:, None] * load_hessian(frames, wrench, loads)
            step = np.linalg.solve(left, (c * torque - theta)[..., None])[..., 0]
            theta = theta + step
            far = ~(np.abs(theta).max(1) < most_bend)
            if far.any():
                raise self._no_equilibrium(int(np.argmax(far)), c)
            if np.abs(step).max() < precision:
                by_axis = np.linalg.solve(left, torque[:, :, None] * np.eye(len(c)))
                return self._frames(q + theta), by_axis
        raise self._no_equilibrium(int(np.argmax(np.abs(step).max(1))), c)

    def _no_equilibrium(self, row: int, c: np.ndarray) -> ModelError:
        shown = ", ".join(f"{1e6 * compliance:.3g}" for compliance in c[-6:])
        return ModelError(
            f"with the compliances {shown} urad/(N m) the arm has no equilibrium under the load of row "
            f"{row % len(self.measured) + 1}"
        )

    def _frames(self, q: np.ndarray) -> LinkFrames:
        """All frames of (n,) or twice (n,) postures, with the tool point where each row's load acts."""
        frames = forward(self._sprung, self.mount, q)
        at = np.tile(self.measured.application, (len(q) // len(self.measured), 1))
        return dataclasses.replace(frames, tool=Pose(frames.flange.apply(at), frames.tool.rotation))

    # --- which numbers the data identify ---

    def excluded(self) -> dict[int, str]:
        """Return the numbers that must be excluded so that the data identify the others, each with the reason."""
        columns = self.derivatives(self.start)
        lengths = np.linalg.norm(columns, axis=0)
        unit = columns / np.where(lengths > 0.0, lengths, 1.0)
        # a column whose length is a smaller share of the longest, or a direction with a smaller share of the largest
        # singular value of the columns of length 1, is rounding of the model (1e-13 rad of 1e-4 rad) and no information
        nothing = 1e-6
        effectless = np.flatnonzero(~(lengths > nothing * lengths.max())).tolist()
        exclusions = {k: self.hidden(k) or "no measured displacement depends on it" for k in effectless}
        while free := [k for k in range(len(lengths)) if k not in exclusions]:
            _, values, directions = np.linalg.svd(unit[:, free], full_matrices=len(unit) < len(free))
            if len(values) == len(free) and values[-1] > nothing * values[0]:
                break
            worst, partner = [free[i] for i in np.argsort(-np.abs(directions[-1]))[[0, min(1, len(free) - 1)]]]
            exclusions[worst] = (
                f"in every test it moved the reflector as {self.names[partner]} does, so the data cannot separate them"
            )
        return exclusions

    def hidden(self, number: int) -> str:
        """Return why a joint, number 0 to 5, has no effect; empty where the reason is not one of geometry."""
        if number >= 6:
            return ""
        measured = self.measured
        torques = np.abs(load_torque(self._frames(measured.q), measured.wrench, link_loads(self.arm, self.mount, 0.0)))
        # a torque below this share of the largest, or a lever [m] of the reflector below it, counts as zero
        unseen = 1e-3
        if torques[:, number].max() <= unseen * torques.max():
            return "no load turned it"
        frames = forward(self.arm, self.mount, measured.q)
        lever = np.linalg.norm(jacobian_at(frames, frames.flange.apply(measured.reflector))[:, :3, number], axis=-1)
        if lever.max() <= unseen and not self.finite[:, 3:].any():
            return "the reflector lay on its axis, so its rotation was not measured"
        return ""


#: relative standard deviation of a number that the data cannot identify, as in the cell's ``uncertainty``: assumed
PRIOR = 0.15


@dataclass(frozen=True, eq=False)
class Fit:
    """Numbers of the arm, identified from load tests."""

    problem: Problem  #: with the standard deviations that were used
    factors: np.ndarray  #: on the arm file's numbers, (p,)
    exclusions: dict[int, str]  #: why a number was not fitted; its value is that of the arm file
    covariance: np.ndarray  #: covariance of the factors, (p, p), with PRIOR for those that were not fitted
    quantile: float  #: half width of a 95 % interval in standard deviations
    weights: np.ndarray  #: weight of each load test, (n,); 1 unless robust
    chi2_reduced: float  #: weighted sum of the squares of the residuals over the degrees of freedom

    @property
    def free(self) -> np.ndarray:
        """(p,) bool: fitted."""
        return np.array([k not in self.exclusions for k in range(len(self.factors))])

    @property
    def values(self) -> np.ndarray:
        """Compliances [rad/(N m)], then the compensator's numbers [SI], (p,)."""
        return self.factors * self.problem.scale

    @property
    def half_widths(self) -> np.ndarray:
        """Half widths of the 95 % intervals, (p,), infinite for a number that was not fitted."""
        sigma = np.sqrt(np.diag(self.covariance)) * np.abs(self.problem.scale)
        return np.where(self.free, self.quantile * sigma, np.inf)

    @property
    def correlation(self) -> np.ndarray:
        """(p, p); 0 in rows and columns of numbers that were not fitted."""
        sigma = np.sqrt(np.diag(self.covariance))
        both = self.free[:, None] & self.free[None, :]
        return np.where(both, self.covariance / np.outer(sigma, sigma), np.eye(len(sigma)))

    @property
    def singular_values(self) -> np.ndarray:
        """Singular values of the derivatives, (p,), columns scaled to length 1; all 1: orthogonal columns."""
        columns = self.problem.derivatives(self.factors)
        lengths = np.linalg.norm(columns, axis=0)
        return np.linalg.svd(columns / np.where(lengths > 0.0, lengths, 1.0), compute_uv=False)

    @functools.cached_property
    def residuals(self) -> np.ndarray:
        """Measured less modelled [m, rad], (n, 6)."""
        return self.problem.measured.displacement - self.problem.predict(self.factors)

    @property
    def residual_rms(self) -> float:
        """Root mean square of the translations [m] of the load tests with weight."""
        rows = self.residuals[self.weights > 0.0, :3]
        return float(np.sqrt(np.nanmean(rows**2)))

    @property
    def scaled(self) -> np.ndarray:
        """Residuals in standard deviations, (m,)."""
        return (self.residuals / self.problem.measured.sigma)[self.problem.finite]

    @property
    def normality(self) -> float:
        """p-value of the test of Shapiro and Wilk: below 0.05 the residuals are hardly normal; NaN for fewer than 3."""
        if self.scaled.size < 3 or not np.ptp(self.scaled) > 0.0:
            return float("nan")
        return float(stats.shapiro(self.scaled[:5000]).pvalue)

    def at(self, pose: Measurements) -> tuple[np.ndarray, np.ndarray]:
        """Translation of the tool under each force of a test pose [m], (k, 3), and its standard deviation [m], (k,)."""
        slopes = self.problem.slopes(self.factors, pose)
        square = np.einsum("kip,pq,kiq->k", slopes, self.covariance, slopes)
        moved = dataclasses.replace(self.problem, measured=pose).predict(self.factors)[:, :3]
        return moved, np.sqrt(np.maximum(square, 0.0))


def fit_compliance(problem: Problem, robust: bool = False) -> Fit:
    """Identify the arm; robust: tests that contradict the others lose their weight. Raises ModelError.

    A number keeps the value of the arm file if it has no effect, if another number has the same effect, or if its
    interval would include zero. The intervals of the other numbers then include its uncertainty, PRIOR.
    """
    exclusions = problem.excluded()
    hidden_by_noise = "its effect is below the noise, its 95 % interval would include zero"
    while True:
        fitted = _fitted(problem, dict(exclusions), robust)
        relative = fitted.half_widths / np.maximum(np.abs(fitted.values), 1e-300)
        relative[problem.is_compliance & (fitted.factors <= 0.0)] = np.inf
        relative[~fitted.free] = 0.0
        worst = int(np.argmax(relative))
        if not relative[worst] >= 1.0:
            return fitted
        exclusions[worst] = problem.hidden(worst) or hidden_by_noise


def _fitted(problem: Problem, exclusions: dict[int, str], robust: bool) -> Fit:
    """Fit every number that is not excluded, with weights and standard deviations from the residuals of the fit."""
    weights, x = np.ones(len(problem.measured)), problem.start
    free = np.array([k not in exclusions for k in range(len(x))])
    sought, measured = int(free.sum()), int(problem.finite.sum())
    if measured <= sought:
        raise ModelError(f"{measured} measured numbers for {sought} unknown ones; measure more loads or postures")
    rounds = 30
    for _ in range(rounds):
        x = problem.solve(x, free, weights)
        left = problem.weighted(problem.predict(x))
        new = robust_weights(left) if robust else weights
        scaled = problem if problem.measured.sigma_known else problem.with_estimated_sigma(left, weights, sought)
        converged = np.abs(new - weights).max() < 1e-3 and np.allclose(
            scaled.measured.sigma, problem.measured.sigma, 1e-4
        )
        problem, weights = scaled, new
        if converged:
            break
    each = problem.by_number(weights)
    residuals, a = problem.linearised(x)
    freedom = max(1, int((each > 0.0).sum() - sought))
    chi2 = float(np.sum(each * residuals**2))
    if robust:
        variance = robust_variance(problem.weighted(problem.predict(x)), sought)
    else:
        variance = scatter(chi2, freedom, True)
    # that of the base, in units of TILT_SIZE where the arm file has a rigid base: assumed, as stiff as published
    # foundations or rigid
    base_prior = 1.0
    prior = np.where(problem.is_base, base_prior, PRIOR)[~free]
    weighted = a * np.sqrt(each)[:, None]
    covariance = _with_prior(np.linalg.inv(a[:, free].T @ a[:, free]) * variance, weighted, free, prior)
    quantile = half_interval(freedom, problem.measured.sigma_known and not robust)
    return Fit(problem, x, exclusions, covariance, quantile, weights, chi2 / freedom)


def _with_prior(inverse: np.ndarray, a: np.ndarray, free: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Covariance of all factors, (p, p): of the fitted ones, with the share that the prior of the others adds.

    prior: standard deviations of the factors that are not fitted.
    """
    carried = -np.linalg.lstsq(a[:, free], a[:, ~free], rcond=None)[0]
    covariance = np.zeros((free.size, free.size))
    covariance[np.ix_(free, free)] = inverse + carried * prior**2 @ carried.T
    covariance[np.ix_(free, ~free)] = carried * prior**2
    covariance[np.ix_(~free, free)] = (carried * prior**2).T
    covariance[np.ix_(~free, ~free)] = np.diag(prior**2)
    return covariance
