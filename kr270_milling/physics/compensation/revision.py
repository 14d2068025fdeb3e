"""Off-line revision of the reference trajectory at the controller step, Fig. 9(a), Fig. 14, in three components.

Every method needs the times and positions of the tool in a pass. A shift of the reference moves the tool by the same
shift, and the displacement under load stays nearly the same, so ``reference' = target - displacement``.

Its limits: the size of the correction, and its change from one tick of the controller to the next. The static mirror
(30)-(32), Fig. 8, is the target point that the load moves onto the programmed point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.column import column
from kr270_milling.base.errors import ModelError
from kr270_milling.base.frames import Pose
from kr270_milling.path.controller_motion import block_ends, controller_motion, spline_slopes
from kr270_milling.path.trajectory import Trajectory, slerp
from kr270_milling.physics.robot import Arm, Mount, equilibrium, inverse_near


@dataclass(frozen=True)
class Bounds:
    """Limits of a correction."""

    max_correction: float = np.inf  #: [m]
    max_change: float = np.inf  #: [m], within each tick
    tick: float = 12e-3  #: [s], of the controller


UNBOUNDED = Bounds()


@dataclass(frozen=True)
class Limited:
    """Neighbouring knots whose correction was limited; points are counted from 1, as in the robot program."""

    kind: str = column("kind")  #: "size" or "change"
    first: int = column("first")  #: point
    last: int = column("last")  #: point
    worst: int = column("worst")  #: point that lost most
    time: float = column("time_s")  #: [s], of the worst one
    wanted: float = column("wanted_um", 1e6)  #: [m], size of the correction there
    missing: float = column("missing_um", 1e6)  #: [m], the part of it that is left out; more where the sign turns

    @property
    def feed_share(self) -> float:
        """Share of the programmed feed at which the limit would about hold, where the inertia of the arm asks for it.

        Of a correction of which a part is left.
        A path that is run at the share f accelerates with f^2 and so does the correction c = r'' / omega^2; its change
        in a tick goes with f^3.
        """
        remaining = 1.0 - self.missing / self.wanted
        return remaining ** (1.0 / 2.0 if self.kind == "size" else 1.0 / 3.0)

    @property
    def sentence(self) -> str:
        where = f"point {self.first}" if self.first == self.last else f"points {self.first} to {self.last}"
        why = "is too large" if self.kind == "size" else "changes too fast"
        left = f"{1e6 * self.missing:.1f} of {1e6 * self.wanted:.1f} um are left out"
        if self.missing >= self.wanted:
            wanted = f"{1e6 * self.wanted:.1f} um are wanted"
            left = f"{wanted}, and the correction is {1e6 * self.missing:.1f} um away from them,"
        return f"the correction {why} at {where}: {left} at point {self.worst} ({self.time:.3f} s)"


def limit_change(knots: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Corrections (n, 3) [m] that change by no more than ``most`` (n - 1,) [m] from knot to knot.

    The mean of what follows as fast as it may and of what starts as early as it must: without lag on the whole, and
    unchanged where nothing is to be limited.
    """
    if np.all(np.linalg.norm(np.diff(knots, axis=0), axis=1) <= most):
        return knots
    return 0.5 * (_follow(knots, most) + _follow(knots[::-1], most[::-1])[::-1])


def _follow(knots: np.ndarray, most: np.ndarray) -> np.ndarray:
    followed = knots.copy()
    gaps = np.linalg.norm(np.diff(knots, axis=0), axis=1)
    behind = False
    for k in range(1, len(knots)):
        if not behind and gaps[k - 1] <= most[k - 1]:
            continue
        gap = knots[k] - followed[k - 1]
        length = float(np.sqrt(gap @ gap))
        behind = length > most[k - 1]
        if behind:
            followed[k] = followed[k - 1] + gap * (most[k - 1] / length)
    return followed


def describe(kind: str, time: np.ndarray, wanted: np.ndarray, allowed: np.ndarray) -> tuple[Limited, ...]:
    """Return a Limited for each run of knots whose correction (n, 3) [m] was changed; time [s], (n,)."""
    missing, size = np.linalg.norm(wanted - allowed, axis=1), np.linalg.norm(wanted, axis=1)
    # 1 nm less of a correction is no limitation
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing > 1e-9, [0]]))).reshape(-1, 2)
    worst = [start + int(np.argmax(missing[start:stop])) for start, stop in edges.tolist()]
    return tuple(
        Limited(kind, start + 1, stop, k + 1, float(time[k]), float(size[k]), float(missing[k]))
        for (start, stop), k in zip(edges.tolist(), worst, strict=True)
    )


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
    return knots * (max_change / np.max(change))  # the slope of a spline scales with its height


def chord_error(target: Trajectory) -> float:
    """Largest distance [m] of the chords between the knots from the target, which straight lines add on arcs."""
    middle = (target.time_ns[1:] + target.time_ns[:-1]) // 2
    off = target.sample(middle) - 0.5 * (target.position[1:] + target.position[:-1])
    move = np.diff(target.position, axis=0)
    along = np.sum(off * move, axis=1, keepdims=True) / np.maximum(np.sum(move**2, axis=1, keepdims=True), 1e-300)
    return float(np.max(np.linalg.norm(off - along * move, axis=1)))


LEVER = 0.1  # [m]; weighs a rotation against a displacement in the convergence measure: about a tool's length


def loaded_pose(arm: Arm, mount: Mount, joints, wrench, sag_compensated: bool, tool_compliance: float = 0.0) -> Pose:
    """t_F = f^-1(F | t_0), (30): loaded tool pose for commanded joints (n, 6), under wrenches (n, 6), base axes.

    With ``sag_compensated`` the controller sees to it that the link weights alone do not move the tool; they still
    load the arm. tool_compliance [m/N]: of the tool tip against the spindle, lateral, in series with the arm.
    """
    loaded = equilibrium(arm, mount, joints, wrench, gravity=True).pose
    if tool_compliance:
        axis, force = loaded.rotation[..., 2], np.asarray(wrench, float)[..., :3]
        lateral = force - np.sum(force * axis, axis=-1, keepdims=True) * axis
        loaded = Pose(loaded.position + tool_compliance * lateral, loaded.rotation)
    if not sag_compensated:
        return loaded
    sagged = equilibrium(arm, mount, joints, np.zeros_like(wrench), gravity=True).pose
    commanded = equilibrium(arm, mount, joints, np.zeros_like(wrench), gravity=False).pose
    turned = loaded.rotation @ np.swapaxes(sagged.rotation, -1, -2)
    return Pose(commanded.position + loaded.position - sagged.position, turned @ commanded.rotation)


def mirror(
    arm: Arm,
    mount: Mount,
    target: Pose,
    wrench: np.ndarray,
    seed: np.ndarray,
    *,
    tool_compliance: float = 0.0,
    relaxation: float = 0.9,
    sag_compensated: bool = True,
    tolerance: float = 1e-9,
    max_iterations: int = 60,
) -> tuple[Pose, np.ndarray, list[float]]:
    """Solve (31) by the iteration (32) for target poses (n,) in base_link under wrenches (n, 6) [N, N m], base axes.

    Returns the modified target points t_0^(F), the joint positions (n, 6) [rad] that command them, the inverse
    kinetostatic model, and the largest remaining error [m] before each iteration.

    seed: a posture [rad], (6,), of the branch that the first target is on. tolerance [m]; a rotation error counts
    with a lever of 0.1 m. Raises ModelError, and the errors of the inverse kinematics and of the equilibrium.
    """
    wrench = np.broadcast_to(wrench, target.position.shape[:-1] + (6,))
    modified, history = target, []
    for _ in range(max_iterations):
        joints = inverse_near(arm, mount, modified, seed)
        loaded = loaded_pose(arm, mount, joints, wrench, sag_compensated, tool_compliance)
        shift = target.position - loaded.position
        turn = Rotation.from_matrix(target.rotation @ np.swapaxes(loaded.rotation, -1, -2))
        vector = turn.as_rotvec()
        history.append(float(np.max(np.linalg.norm(shift, axis=-1) + LEVER * np.linalg.norm(vector, axis=-1))))
        if history[-1] <= tolerance:
            return modified, joints, history
        step = Rotation.from_rotvec(relaxation * vector).as_matrix()
        modified = Pose(modified.position + relaxation * shift, step @ modified.rotation)  # (32)
    raise ModelError(
        f"the compensated target point did not converge: {history[-1]:.3g} m left after {len(history)} iterations "
        f"of (32), wanted {tolerance:.3g} m; lower compensation.relaxation or check the load"
    )
