"""Time a tool path: speed along the path with limited acceleration and jerk, knots at controller steps.

The tool runs through a corner if the blocks are tangent, or if the corner rounds off by less than the tolerance at
a fifth of the feed or more. At all other corners the tool stops, exactly on a controller step, so that a knot is in
the corner. Between stops the speed is as high as the feeds, the curvature (centripetal acceleration) and S-shaped
ramps allow. The ramps bound acceleration and jerk *along* the path; across the path only the acceleration is bounded.
The cost is linear in the number of blocks. Where a joint would exceed its speed or acceleration, knots are delayed.

A ramp from v0 to v1 raises the acceleration at the jerk j to at most a, and lowers it again. Its duration is
2 sqrt(|v1 - v0| / j) while the acceleration stays below a, and |v1 - v0| / a + a / j otherwise. Its length is the mean
speed times the duration. Every ramp starts and ends without acceleration, so ramps can follow each other in any order.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import maximum_filter1d

from kr270_milling.base.blocks import BLOCK, blocks
from kr270_milling.base.record import Record, parameter
from kr270_milling.path.toolpath import Toolpath, ToolpathError
from kr270_milling.path.trajectory import Trajectory, TrajectoryError


@dataclass(frozen=True, eq=False)
class Timing(Record):
    """Limits of the controller along a path."""

    controller_step: float = parameter(0.05, unit="ms", low=1.0, high=1000.0, text="time between knots")
    acceleration: float = parameter(2.0, unit="m_per_s2", above=0.0, high=50.0, text="along and across the path")
    jerk: float = parameter(20.0, unit="m_per_s3", above=0.0, high=5000.0, text="along the path")
    rapid_feed: float = parameter(0.2, unit="m_per_min", above=0.0, high=180.0, text="speed of G0 and RAPID moves")
    corner_tolerance: float = parameter(1e-5, unit="um", low=0.0, high=1e4, text="how far a corner may be rounded off")

    @property
    def step_ns(self) -> int:
        return round(self.controller_step * 1e9)


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A trajectory, and the place of each knot on its tool path."""

    toolpath: Toolpath
    trajectory: Trajectory
    block: np.ndarray  #: (m,), block of the tool path that each knot lies on
    distance: np.ndarray  #: [m], (m,), along the path
    timed_by_source: bool = False  #: the times come from the source and stay unchanged

    def distance_at(self, time_ns) -> np.ndarray:
        """Return the distance along the path [m] at times [ns]."""
        time_ns = np.asarray(time_ns)
        if time_ns.ndim == 1 and time_ns.size > BLOCK:
            return np.concatenate([self.distance_at(time_ns[part]) for part in blocks(time_ns.size)])
        k, u, step = self.trajectory.locate(time_ns)
        u, step, velocity = u[..., 0], step[..., 0], self.trajectory.velocity
        if velocity is None:
            return self.distance[k] + u * (self.distance[k + 1] - self.distance[k])
        v0, v1 = (np.linalg.norm(velocity[n], axis=-1) * step for n in (k, k + 1))
        move = self.distance[k + 1] - self.distance[k]
        return self.distance[k] + u * v0 + u**2 * (3 * move - 2 * v0 - v1) + u**3 * (v0 + v1 - 2 * move)

    def block_at(self, time_ns) -> np.ndarray:
        """Return the block of the tool path at times [ns]."""
        return self.toolpath.block_at(self.distance_at(time_ns))


def time_path(toolpath: Toolpath, timing: Timing) -> TimedPath:
    """Time a tool path within the limits; the trajectory starts and ends at rest and has velocities at its knots."""
    ramps, stops, ends = _ramps(toolpath, timing)
    time_ns = np.arange(stops[-1] + 1, dtype=np.int64) * timing.step_ns
    distance, speed = np.empty((2, time_ns.size))
    for part in blocks(time_ns.size):
        distance[part], speed[part], _ = ramps.sample(np.arange(part.start, part.stop) * timing.controller_step)
    distance[stops], speed[stops], speed[0] = ends, 0.0, 0.0  # exact values: a rounded speed would hide a stop
    position, velocity = np.empty((2, time_ns.size, 3))
    quaternion = toolpath.quaternion[0]
    turns = bool(np.any(toolpath.quaternion != quaternion))
    if turns:
        quaternion = np.empty((time_ns.size, 4))
    for part in blocks(time_ns.size):
        position[part], tangent, turned = toolpath.on_path(distance[part])
        velocity[part] = speed[part, None] * tangent
        if turns:
            quaternion[part] = turned
    position[-1] = toolpath.position[-1]
    run = Trajectory(time_ns, position, quaternion, velocity)
    return TimedPath(toolpath, run, toolpath.block_at(distance), distance)


def _segments(toolpath: Toolpath, timing: Timing) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Join blocks of equal limits to segments.

    Returns the lengths [m], (m,), the speed limits [m/s], (m,), and the limits at the joints, (m + 1,).
    """
    bend = np.maximum(np.abs(toolpath.curvature[1:]), 1e-12)
    feed = np.where(toolpath.rapid[1:], timing.rapid_feed, toolpath.feed[1:])
    limit = np.minimum(feed, np.sqrt(timing.acceleration / bend))  # centripetal
    corner = _corner_speeds(toolpath, timing, np.minimum(limit[:-1], limit[1:]))
    joined = (limit[:-1] == limit[1:]) & (corner >= limit[1:])
    starts = np.flatnonzero(np.concatenate([[True], ~joined]))
    cap = np.concatenate([[0.0], corner[starts[1:] - 1], [0.0]])
    return np.add.reduceat(toolpath.block_length[1:], starts), limit[starts], cap


def _ramps(toolpath: Toolpath, timing: Timing) -> tuple[Ramps, np.ndarray, np.ndarray]:
    """Return the phases of motion along the whole path, the knots at which the tool stops, and their distances [m]."""
    step, bounds = timing.controller_step, (timing.acceleration, timing.jerk)
    length, limit, cap = _segments(toolpath, timing)
    vertex = vertex_speeds(cap, length, *bounds)
    first, last = vertex[:-1], vertex[1:]
    peak = peak_speeds(first, last, limit, length, *bounds)
    up, down = ramp_time(peak - first, *bounds), ramp_time(peak - last, *bounds)
    cruise = np.maximum(length - (first + peak) / 2 * up - (peak + last) / 2 * down, 0.0) / peak

    run = np.concatenate([[0], np.cumsum(vertex[1:-1] == 0)])  # stop to stop
    final = np.flatnonzero(last == 0)  # the segment that ends each run
    duration = np.bincount(run, up + cruise + down)
    steps = np.maximum(np.ceil(duration / step - 1e-9), 1)
    if not steps.sum() <= 5_000_000:  # a trajectory takes some 200 bytes a knot while it is made
        raise ToolpathError(f"it would last {steps.sum() * step:.3g} s; is the feed right?")
    missing = steps * step - duration
    softer = cruise[final] >= missing  # brake more gently, so that the stop is on a step; else reduce the speed
    down[final] += np.where(softer, 2 * missing, 0.0)
    cruise[final] -= np.where(softer, missing, 0.0)
    slower = np.where(softer, 1.0, steps * step / duration)[run, None]

    durations = np.stack([up, cruise, down], axis=1) * slower
    speeds = np.stack([first, peak, peak, last], axis=1) / slower
    ramps = Ramps.make(durations.ravel(), speeds[:, :3].ravel(), speeds[:, 1:].ravel(), *bounds)
    return ramps, np.cumsum(steps.astype(np.int64)), np.cumsum(length)[final]


def _corner_speeds(toolpath: Toolpath, timing: Timing, limit: np.ndarray) -> np.ndarray:
    """Return the highest speed [m/s], (n-2,), in each corner between two blocks; 0: stop.

    Between two knots a step h apart the trajectory rounds off a corner of the angle t by at most v h sin(t/2) / 4. The
    velocity changes by 2 v sin(t/2) within the step, or within one block if the block is shorter. A fifth of the
    tolerance is left for the change of speed within that step.
    """
    k = np.arange(1, len(toolpath))
    start, end = toolpath.tangent(k, np.zeros(k.size)), toolpath.tangent(k, toolpath.plane_length[k])
    half = np.linalg.norm(start[1:] - end[:-1], axis=1) / 2  # sin(t / 2)
    safe = np.maximum(half, 1e-12)
    step, length = timing.controller_step, toolpath.block_length[1:]
    rounding = 0.8 * 4 * timing.corner_tolerance / (step * safe)
    turning = timing.acceleration * step / (2 * safe)
    dense = np.sqrt(timing.acceleration * (length[:-1] + length[1:]) / (4 * safe))
    speed = np.minimum(np.minimum(rounding, turning), np.minimum(dense, limit))
    # turns below 1 mrad come from rounded coordinates; at 4 m/min and 50 ms they cut 0.4 um
    speed = np.where(half < 0.5e-3, limit, speed)
    in_place = np.all(start == 0, axis=1)
    speed = np.where(in_place[1:] != in_place[:-1], 0.0, speed)
    fair = 0.2  # share of the feed below which a corner is not worth rounding
    return np.where(speed >= fair * limit, speed, 0.0)


def ramp_time(change, acceleration: float, jerk: float) -> np.ndarray:
    """Return the shortest duration [s] of a ramp by ``change`` [m/s]."""
    change = np.abs(change)
    gentle = 2 * np.sqrt(change / jerk)
    return np.where(change <= acceleration**2 / jerk, gentle, change / acceleration + acceleration / jerk)


def reachable(speed: float, length: float, acceleration: float, jerk: float) -> float:
    """Return the highest speed [m/s] that a ramp from ``speed`` reaches within ``length`` [m], in closed form."""
    edge = acceleration**2 / jerk  # change of speed at which the acceleration just reaches its limit
    if length <= (2 * speed + edge) * acceleration / jerk:
        # (2 v + x^2) x = length sqrt(j) with x^2 the change of speed: the one real root of a cubic
        p, q = 2 * speed, length * math.sqrt(jerk)
        if p <= 1e-12 * q ** (2 / 3):
            x = q ** (1 / 3)
        else:
            x = 2 * math.sqrt(p / 3) * math.sinh(math.asinh(1.5 * q / p * math.sqrt(3 / p)) / 3)
        return speed + x * x
    half = speed + edge / 2
    return speed - half + math.sqrt(half**2 + 2 * acceleration * length - 2 * speed * edge)


def vertex_speeds(cap: np.ndarray, length: np.ndarray, acceleration: float, jerk: float) -> np.ndarray:
    """Return the highest speeds [m/s], (m+1,), at the ends of m segments.

    The speeds are below ``cap`` (m+1,), and a ramp between two neighbours fits into their segment.
    """
    speeds, lengths = cap.tolist(), length.tolist()
    for i, distance in enumerate(lengths):
        if speeds[i + 1] > speeds[i]:
            speeds[i + 1] = min(speeds[i + 1], reachable(speeds[i], distance, acceleration, jerk))
    for i in range(len(lengths) - 1, -1, -1):
        if speeds[i] > speeds[i + 1]:
            speeds[i] = min(speeds[i], reachable(speeds[i + 1], lengths[i], acceleration, jerk))
    return np.array(speeds)


def peak_speeds(first, last, cap, length, acceleration: float, jerk: float) -> np.ndarray:
    """Return the highest speed [m/s], (m,), within each segment, with room for the ramps at both ends."""

    def room(peak):
        up, down = ramp_time(peak - first, acceleration, jerk), ramp_time(peak - last, acceleration, jerk)
        return length - (first + peak) / 2 * up - (peak + last) / 2 * down

    low, high = np.maximum(first, last), np.array(cap, float)
    fits = room(high) >= 0
    for _ in range(60):
        middle = (low + high) / 2
        good = room(middle) >= 0
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return np.where(fits, cap, low)


@dataclass(frozen=True, eq=False)
class Ramps:
    """Consecutive phases of motion along a path from time 0; constant speed is a ramp between equal speeds."""

    duration: np.ndarray  #: [s], (p,)
    first: np.ndarray  #: [m/s], (p,), speed at the start of the phase
    last: np.ndarray  #: [m/s], (p,), speed at the end of the phase
    edge: np.ndarray  #: (p,), share of the phase in which the acceleration rises, equal to the share in which it falls

    @classmethod
    def make(cls, duration, first, last, acceleration: float, jerk: float) -> Ramps:
        change = np.abs(np.asarray(last) - first)
        steep = change > acceleration**2 / jerk
        edge = np.where(steep, acceleration / jerk / np.where(steep, ramp_time(change, acceleration, jerk), 1.0), 0.5)
        return cls(np.asarray(duration, float), np.asarray(first, float), np.asarray(last, float), edge)

    @property
    def start(self) -> np.ndarray:
        """Return the start of each phase and the end of the last one [s], (p + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.duration)])

    def sample(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distance [m], speed [m/s] and acceleration [m/s^2] at times [s], (m,)."""
        start = self.start
        travelled = np.concatenate([[0.0], np.cumsum((self.first + self.last) / 2 * self.duration)])
        k = np.clip(np.searchsorted(start, time, side="right") - 1, 0, len(self.duration) - 1)
        duration = np.where(self.duration[k] > 0, self.duration[k], 1.0)
        u = np.clip((time - start[k]) / duration, 0, 1)
        edge, change = self.edge[k], self.last[k] - self.first[k]
        scale = 1 / (1 - edge)
        v, rest = u, 1 - u
        slope = scale * np.minimum(1, np.minimum(u, rest) / edge)
        speed = np.where(u < edge, v**2 / (2 * edge), v - edge / 2) * scale
        speed = np.where(rest < edge, 1 - scale * rest**2 / (2 * edge), speed)
        moved = np.where(u < edge, v**3 / (6 * edge), edge**2 / 6 + (v - edge) * v / 2) * scale
        moved = np.where(rest < edge, u - 0.5 + scale * rest**3 / (6 * edge), moved)
        distance = travelled[k] + duration * (self.first[k] * u + change * moved)
        return distance, self.first[k] + change * speed, change * slope / duration


def joint_rates(time, joints, at_rest: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return joint speeds between the knots [rad/s], (n-1, 6), and accelerations at the knots [rad/s^2], (n, 6).

    time [s], (n,); joints [rad], (n, 6); at_rest: the motion starts and ends at rest, otherwise at its first and last
    speed.
    """
    step = np.diff(time)[:, None]
    speed = np.diff(joints, axis=0) / step
    inner = 2 * np.diff(speed, axis=0) / (step[1:] + step[:-1])
    if at_rest:  # from rest, the mean speed of the first step is half of its last speed
        first, last = 2 * speed[:1] / step[:1], -2 * speed[-1:] / step[-1:]
    else:
        first = last = np.zeros((1, speed.shape[1]))
    return speed, np.concatenate([first, inner, last])


def limit_by_joints(trajectory: Trajectory, joints, speed_limit, acceleration_limit) -> Trajectory:
    """Delay the knots so that no joint exceeds its speed and acceleration; time steps never become shorter.

    joints [rad], (n, 6), at the knots; speed_limit [rad/s] and acceleration_limit [rad/s^2], (6,). A trajectory with a
    turning tool is first slowed down by ``_pace``. Each round stretches the steps that exceed a limit. After 200 rounds
    one uniform stretch removes the rest. Speeds and accelerations are those of ``joint_rates``.
    """
    joints = np.asarray(joints, float)
    speed_limit, acceleration_limit = np.asarray(speed_limit, float), np.asarray(acceleration_limit, float)
    if joints.shape[:1] != (len(trajectory),) or not np.isfinite(joints).all():
        raise TrajectoryError("it needs finite joint positions for each of its knots")
    if not (np.all(speed_limit > 0) and np.all(acceleration_limit > 0)):
        raise TrajectoryError("the joint limits must be above 0")
    velocity = trajectory.velocity
    at_rest = velocity is not None and not velocity[0].any() and not velocity[-1].any()
    old = np.diff(trajectory.time)
    axes = list(range(joints.shape[1]))

    def largest(time: np.ndarray, which: int, limits: np.ndarray) -> np.ndarray:
        """The largest share of the limits over the axes, of the speeds (0) or the accelerations (1)."""
        shares = (np.abs(joint_rates(time, joints[:, k : k + 1], at_rest)[which][:, 0]) / limits[k] for k in axes)
        return functools.reduce(np.maximum, shares)

    step = old * np.maximum(1, largest(trajectory.time, 0, speed_limit))

    def excess() -> np.ndarray:
        """Return the ratio of acceleration to limit at each knot, (n,), of the worst joint."""
        return largest(np.concatenate([[0], np.cumsum(step)]), 1, acceleration_limit)

    if trajectory.turns:
        planned, share = step, np.ones(len(trajectory))  # of the acceleration limit that the pace may use
        for _ in range(20):
            pace = _pace(trajectory.time, joints, speed_limit, share[:, None] * acceleration_limit)
            step = np.maximum(planned, old * 2 / (pace[1:] + pace[:-1]))
            over = maximum_filter1d(excess(), 5)
            if over.max() <= 1:
                break
            share /= np.where(over > 1, 1.02 * over, 1.0)

    over = excess()
    for _ in range(200):
        if over.max() <= 1:
            break
        grow = np.sqrt(np.maximum(over, 1)) * np.where(over > 1, 1 + 1e-6, 1)
        step = step * np.maximum(grow[:-1], grow[1:])
        over = excess()
    step = step * max(1.0, np.sqrt(over.max()) * (1 + 1e-9))
    ratio = step / old
    if not (ratio > 1).any():
        return trajectory
    step_ns = np.maximum(np.ceil(step * 1e9 - 1e-3).astype(np.int64), np.diff(trajectory.time_ns))
    time_ns = np.concatenate([[0], np.cumsum(step_ns)])
    if velocity is not None:
        at_knot = (np.concatenate([ratio[:1], ratio]) + np.concatenate([ratio, ratio[-1:]])) / 2
        velocity = velocity / at_knot[:, None]
    return Trajectory(time_ns, trajectory.position, trajectory.quaternion, velocity, trajectory.frame)


def _pace(time: np.ndarray, joints: np.ndarray, speed_limit: np.ndarray, acceleration_limit: np.ndarray) -> np.ndarray:
    """Return the largest pace, (n,), at most 1, of a motion along knots [s], (n,), within the limits of the joints.

    acceleration_limit [rad/s^2], (n, 6); its quotients of differences are those of the pace only about.

    With x the pace squared and u = x' / 2 along the old time, the joints have the acceleration q' u + q'' x. Two passes
    of TOPP-RA [Pham2018]: backwards the largest x from which the rest can be run, forwards the largest u.
    """
    first = np.gradient(joints, time, axis=0)
    speed = np.diff(joints, axis=0) / np.diff(time)[:, None]
    second = np.zeros_like(joints)
    second[1:-1] = 2 * np.diff(speed, axis=0) / (time[2:] - time[:-2])[:, None]
    beside = np.abs(np.vstack([speed[:1], speed, speed[-1:]]))
    fastest = np.maximum(beside[:-1], beside[1:])
    most = np.minimum(1.0, 1.0 / np.maximum(fastest / speed_limit, 1e-12).max(axis=1)) ** 2
    return np.sqrt(_squared_pace(np.diff(time), first, second, most, acceleration_limit))


@njit(cache=True, nogil=True)
def _growth(first, second, x, limit):
    """Return the bounds of u for |first u + second x| <= limit, each (joints,)."""
    low, high = -1e300, 1e300
    for j in range(len(limit)):
        if abs(first[j]) > 1e-12:
            a = (-limit[j] - second[j] * x) / first[j]
            b = (limit[j] - second[j] * x) / first[j]
            low, high = max(low, min(a, b)), min(high, max(a, b))
        elif abs(second[j]) * x > limit[j]:
            return 1.0, -1.0
    return low, high


@njit(cache=True, nogil=True)
def _squared_pace(step, first, second, most, limit):
    """Return the pace squared at the knots, (n,); most: its bounds, (n,)."""
    reach = most.copy()
    for i in range(len(step) - 1, -1, -1):
        low, high, x = 0.0, most[i], most[i]
        for _ in range(25):
            least, largest = _growth(first[i], second[i], x, limit[i])
            if max(least, -x / (2 * step[i])) <= min(largest, (reach[i + 1] - x) / (2 * step[i])):
                low = x
            else:
                high = x
            if low == high:
                break
            x = 0.5 * (low + high)
        reach[i] = max(low, 1e-8)
    x = reach.copy()
    for i in range(len(step)):
        largest = _growth(first[i], second[i], x[i], limit[i])[1]
        x[i + 1] = max(min(x[i] + 2 * step[i] * largest, reach[i + 1]), 1e-8)
    return x
