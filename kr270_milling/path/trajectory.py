"""A sampled trajectory of the tool, the motion of a controller between the knots, and its file.

Convention of ROS joint trajectory controllers: knots without velocities are joined by straight lines, knots with
velocities by cubic Hermite segments. A controller therefore runs a C2 cubic spline exactly if the knots carry its
velocities. Orientations are joined by the shortest rotation: at constant rate (slerp) between knots without velocities,
else at a rate without jumps, because a jump of the rate shakes the arm at each knot. The tool rests before the first
and after the last knot.
"""

from __future__ import annotations

import copy
import itertools
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.blocks import blocks
from kr270_milling.base.compiled import compiled
from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.files import write_files
from kr270_milling.base.frames import abc_from_rotation, rotation_from_quaternion
from kr270_milling.base.table import read_table
from kr270_milling.base.units import seconds

#: tcp in the workpiece frame when its axis points straight down and its x axis along the feed: diag(1, -1, -1)
TOOL_DOWN = (1.0, 0.0, 0.0, 0.0)
#: [m/rad], assumed, length of a tool: a turn moves its holder by the angle times this length
LEVER = 0.1
BLOCK = 50_000  #: times; more are sampled by compiled code
AT_REST = 1e-6  #: [m/s] a slower tool is at rest: 12 nm in a tick of 12 ms are below the resolution of any axis


class TrajectoryError(MillingError):
    """A trajectory that no tool can follow; index: the first wrong knot, None if the fault is not in a single knot."""

    def __init__(self, reason: str, index: int | None = None):
        self.reason, self.index = reason, index
        super().__init__(f"trajectory{'' if index is None else f', knot {index}'}: {reason}")


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Knots of the tool tip frame tcp over time; arrays become read-only."""

    time_ns: np.ndarray  #: [ns], (n,) int64, strictly increasing from 0
    position: np.ndarray  #: [m], (n, 3), of tcp in ``frame``
    quaternion: np.ndarray  #: (n, 4), x, y, z, w, of tcp in ``frame``; (4,) holds for all knots
    velocity: np.ndarray | None = None  #: [m/s], (n, 3), at the knots; None: straight lines between them
    frame: str = "workpiece"
    start_ns: int = 0  #: [ns] stamp of the message: a pass along the trajectory is counted from this time

    def __post_init__(self):
        time = np.array(self.time_ns)
        if time.ndim != 1 or time.size < 2 or not np.issubdtype(time.dtype, np.integer):
            raise TrajectoryError("the times must be a row of at least 2 whole numbers of nanoseconds")
        time = time.astype(np.int64)
        if time[0] != 0:
            raise TrajectoryError(f"the first time is {time[0]} ns, but must be 0", 0)
        _refuse(np.diff(time, prepend=-1) <= 0, "its time is not later than the one before")
        quaternion = np.asarray(self.quaternion, float)
        if quaternion.shape == (time.size, 4) and (not quaternion.strides[0] or (quaternion == quaternion[0]).all()):
            quaternion = quaternion[0]
        same = quaternion.shape == (4,)  # one row for all knots takes no memory
        quaternion = _rows("quaternion", np.atleast_2d(quaternion), 1 if same else time.size, 4)
        length = np.linalg.norm(quaternion, axis=1)
        _refuse(~(np.abs(length - 1) < 1e-3), "its quaternion is not of length 1")
        self._keep("time_ns", time)
        self._keep("position", _rows("position", self.position, time.size, 3))
        self._keep("quaternion", np.broadcast_to(quaternion / length[:, None], (time.size, 4)))
        if self.velocity is not None:
            self._keep("velocity", _rows("velocity", self.velocity, time.size, 3))

    def _keep(self, name: str, array: np.ndarray) -> None:
        array.setflags(write=False)
        object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return self.time_ns.size

    @property
    def duration_ns(self) -> int:
        return int(self.time_ns[-1])

    @property
    def time(self) -> np.ndarray:
        """Return the knot times [s], (n,)."""
        return self.time_ns * 1e-9

    @property
    def turns(self) -> bool:
        """Return whether the orientation changes; one orientation of all knots is stored once."""
        return self.quaternion.strides[0] != 0

    def sample(self, time_ns) -> np.ndarray:
        """Return the position [m], (..., 3), at times [ns] of any shape."""
        if np.size(time_ns) > BLOCK:
            return self._sampled(time_ns, False)
        k, u, step = self.locate(time_ns)
        start, move = self.position[k], self.position[k + 1] - self.position[k]
        if self.velocity is None:
            return start + u * move
        return hermite(start, move, step * self.velocity[k], step * self.velocity[k + 1], u)

    def sample_velocity(self, time_ns, side: Literal["left", "right"] = "right") -> np.ndarray:
        """Return the velocity [m/s], (..., 3), at times [ns] of any shape.

        side: at a corner, "right" is the velocity of the later segment, "left" of the earlier one.
        """
        if np.size(time_ns) > BLOCK:
            return self._sampled(time_ns, True, side == "left")
        k, u, step = self.locate(time_ns, side)
        move = self.position[k + 1] - self.position[k]
        moving = self.moving(time_ns)[..., None]
        if self.velocity is None:
            return np.where(moving, move / step, 0.0)
        return np.where(moving, _slope(move, step * self.velocity[k], step * self.velocity[k + 1], u) / step, 0.0)

    def sample_acceleration(self, time_ns, side: Literal["left", "right"] = "right") -> np.ndarray:
        """Return the acceleration [m/s^2], (..., 3), of the segments, see ``sample_velocity``; corners have none."""
        k, u, step = self.locate(time_ns, side)
        if self.velocity is None:
            return np.zeros_like(self.position[k])
        move, v0, v1 = self.position[k + 1] - self.position[k], step * self.velocity[k], step * self.velocity[k + 1]
        return (2 * (3 * move - 2 * v0 - v1) + 6 * u * (v0 + v1 - 2 * move)) / step**2

    def _sampled(self, time_ns, rate: bool, left: bool = False) -> np.ndarray:
        """``sample`` or ``sample_velocity`` at many times, in compiled code."""
        time = np.array(time_ns, np.int64).ravel()  # writable, as all others: Numba compiles twice for both kinds
        samples = np.zeros((time.size, 3))
        velocity = self.position[:0] if self.velocity is None else self.velocity
        _fill_samples(self.time_ns, self.position, velocity, time, rate, left, samples)
        return samples.reshape(*np.shape(time_ns), 3)

    @cached_property
    def travelled(self) -> np.ndarray:
        """Return the distances along the ``chords`` to each knot [m], (n,)."""
        return np.append(0.0, np.cumsum(chords(self)))

    @cached_property
    def standing(self) -> np.ndarray:
        """Return an array (n,), true at the knots where the tool rests; without velocities no inner knot is at rest.

        A tool that turns in place rests before and after the turn only.
        """
        standing = np.zeros(len(self), bool)
        if self.velocity is not None:
            standing = np.linalg.norm(self.velocity, axis=1) <= AT_REST
        if self.turns and self.velocity is not None:
            turning = (np.diff(self.position, axis=0) == 0).all(axis=1)
            turning &= (np.diff(self.quaternion, axis=0) != 0).any(axis=1)
            standing[1:-1] &= ~(turning[:-1] & turning[1:])
        return standing

    def feed(self, time_ns) -> np.ndarray:
        """Return the speed of the tool tip [m/s] at times [ns] of any shape."""
        velocity = self.sample_velocity(time_ns)
        return np.sqrt(np.einsum("...j,...j->...", velocity, velocity))

    def sample_orientation(self, time_ns) -> np.ndarray:
        """Return quaternions x, y, z, w, (..., 4), at times [ns] of any shape."""
        if not self.turns:
            return np.broadcast_to(self.quaternion[0], (*np.shape(time_ns), 4))
        if self.velocity is None:
            k, u, _ = self.locate(time_ns)
            return slerp(self.quaternion[k], self.quaternion[k + 1], u)
        k, turn, _ = self.turn(time_ns)
        return (Rotation.from_rotvec(turn.reshape(-1, 3)) * self._knots[k.ravel()]).as_quat().reshape(*k.shape, 4)

    def turn(self, time_ns, side: Literal["left", "right"] = "right") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return segment (...), rotation vector since its first knot [rad] and angular velocity [rad/s], (..., 3) both.

        Axes of ``frame``; side: see ``sample_velocity``. Between knots with velocities the rotation vector is a cubic
        whose rates at the knots are monotone, so that a tool that holds its axis before a turn holds it to the knot
        [FritschButland1984]. The rate is that of the vector: right to the second order of the turn in a segment.
        """
        k, u, step = self.locate(time_ns, side)
        turn = self._segments[k]
        if self.velocity is None:
            return k, u * turn, turn / step
        rates = step * self._rates[k], step * self._rates[k + 1]
        return k, hermite(0.0, turn, *rates, u), _slope(turn, *rates, u) / step

    @cached_property
    def _knots(self) -> Rotation:
        return Rotation.from_quat(self.quaternion)

    @cached_property
    def _segments(self) -> np.ndarray:
        """Rotation vectors from knot to knot [rad], (n - 1, 3)."""
        return (self._knots[1:] * self._knots[:-1].inv()).as_rotvec()

    @cached_property
    def _rates(self) -> np.ndarray:
        """Angular velocities at the knots [rad/s], (n, 3): weighted harmonic means of the rates of both segments.

        Where these differ in sign, it is 0; the first and the last knot have the rate of their segment.
        """
        step = np.diff(self.time)[:, None]
        rate = self._segments / step
        before, after, h, g = rate[:-1], rate[1:], step[:-1], step[1:]
        same = before * after > 0.0
        inverse = (h + 2 * g) / np.where(same, before, 1.0) + (2 * h + g) / np.where(same, after, 1.0)
        return np.concatenate([rate[:1], np.where(same, 3 * (h + g) / inverse, 0.0), rate[-1:]])

    def moving(self, time_ns) -> np.ndarray:
        """Return whether times [ns] of any shape are between the first and the last knot, both included."""
        time = np.asarray(time_ns)
        return (time >= 0) & (time <= self.duration_ns)

    def locate(self, time_ns, side: Literal["left", "right"] = "right") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return segment (...), position in it from 0 to 1 (..., 1) and its duration [s] (..., 1) at times [ns].

        side: "right" for the later segment at a knot, "left" for the earlier one.
        """
        time = np.clip(np.asarray(time_ns, np.int64), 0, self.duration_ns)
        k = np.clip(np.searchsorted(self.time_ns, time, side=side) - 1, 0, len(self) - 2)
        step_ns = (self.time_ns[k + 1] - self.time_ns[k])[..., None]
        return k, (time - self.time_ns[k])[..., None] / step_ns, step_ns * 1e-9

    def starting_at(self, start_ns: int) -> Trajectory:
        """Return the trajectory, with the same bits, for a pass that starts at a stamp [ns]."""
        started = copy.copy(self)
        object.__setattr__(started, "start_ns", int(start_ns))
        return started

    def between(self, first: int, last: int) -> Trajectory:
        """The stretch from one knot to another; its time begins at zero."""
        part = slice(first, last + 1)
        velocity = None if self.velocity is None else self.velocity[part]
        time_ns = self.time_ns[part] - self.time_ns[first]
        return Trajectory(time_ns, self.position[part], self.quaternion[part], velocity, self.frame)

    def with_position(self, position, velocity=None) -> Trajectory:
        """Return a copy with other positions [m], (n, 3), and knot velocities [m/s]."""
        return Trajectory(self.time_ns, position, self.quaternion, velocity, self.frame)

    @classmethod
    def straight_line(cls, start, direction, length: float, feed_rate: float, knot_period_s: float) -> Trajectory:
        """Return a line of a length [m] at constant feed rate [m/s]; the last knot is at the exact end."""
        direction = np.asarray(direction, float)
        if not (length > 0 and feed_rate > 0 and knot_period_s > 0 and np.linalg.norm(direction) > 0):
            raise TrajectoryError("length, feed rate, knot period and direction must be above 0")
        duration = length / feed_rate
        knots = math.ceil(duration / knot_period_s - 1e-6)  # a last step of less than 1e-6 periods is rounding
        time_ns = np.round(np.append(np.arange(knots) * knot_period_s, duration) * 1e9).astype(np.int64)
        path = np.append(time_ns[:-1] * 1e-9 * feed_rate, length)
        unit = direction / np.linalg.norm(direction)
        return cls(time_ns, np.asarray(start, float) + path[:, None] * unit, np.array(TOOL_DOWN))


@compiled
def _fill_samples(knots, position, velocity, times, rate, left, samples):
    """Fill positions, or rates, at times [ns], best sorted; velocity: (0, 3) for straight lines."""
    last, k = knots.size - 2, 0
    for n in range(times.size):
        time = min(max(times[n], 0), knots[-1])
        if rate and time != times[n]:
            continue  # at rest
        while k < last and (knots[k + 1] < time if left else knots[k + 1] <= time):
            k += 1
        if knots[k] > time or (left and k > 0 and knots[k] == time):  # an earlier time
            high, k = k, 0
            while k < high:  # Numba compiles ``np.searchsorted`` for a second
                middle = (k + high + 1) // 2
                if knots[middle] < time if left else knots[middle] <= time:
                    k = middle
                else:
                    high = middle - 1
        step_ns = knots[k + 1] - knots[k]
        u, step = (time - knots[k]) / step_ns, step_ns * 1e-9
        for i in range(3):
            start = position[k, i]
            move = position[k + 1, i] - start
            if velocity.shape[0] == 0:
                samples[n, i] = move / step if rate else start + u * move
                continue
            a, b = step * velocity[k, i], step * velocity[k + 1, i]
            bend, twist = 3 * move - 2 * a - b, a + b - 2 * move
            if rate:
                samples[n, i] = (a + 2 * u * bend + 3 * (u * u) * twist) / step
            else:
                samples[n, i] = start + u * a + u * u * bend + u * u * u * twist


def hermite(start, move, first, last, u) -> np.ndarray:
    """Cubic from ``start`` by ``move`` with the slopes ``first`` and ``last`` over u from 0 to 1."""
    return start + u * first + u**2 * (3 * move - 2 * first - last) + u**3 * (first + last - 2 * move)


def _slope(move, first, last, u) -> np.ndarray:
    """Slope of ``hermite``."""
    return first + 2 * u * (3 * move - 2 * first - last) + 3 * u**2 * (first + last - 2 * move)


def slerp(first: np.ndarray, second: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return quaternions (..., 4) at the fractions u (..., 1) of the shortest rotation from ``first`` to ``second``."""
    cosine = np.sum(first * second, axis=-1, keepdims=True)
    second = np.where(cosine < 0, -second, second)  # q and -q are the same rotation: take the shorter one
    sine = np.linalg.norm(second - np.abs(cosine) * first, axis=-1, keepdims=True)
    angle = np.arctan2(sine, np.abs(cosine))
    turning = sine > 1e-9
    safe = np.where(turning, sine, 1.0)
    mixed = np.where(turning, np.sin((1 - u) * angle) / safe, 1 - u) * first
    mixed = mixed + np.where(turning, np.sin(u * angle) / safe, u) * second
    return mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)


def tool_along(axis) -> tuple[float, float, float, float]:
    """Return the quaternion of tcp whose -z is ``axis``, (3,), from tip to holder; raise ValueError for another length.

    The tool turns about its axis by no more than it must: by the shortest rotation from TOOL_DOWN. The turn is thus a
    smooth function of the axis alone, also at the pole: along a closed row of axes no turn of the last joint remains,
    which a transport from point to point would leave (Berry's angle, 105 deg for each circle at a tilt of 45 deg).
    """
    length = math.hypot(*axis)
    if not abs(length - 1) < 1e-3:
        raise ValueError(f"the tool axis has the length {length:g} instead of 1")
    i, j, k = (float(v) / length for v in axis)
    if k < -0.999:
        raise ValueError("the tool comes from below, where its turn about its axis is not defined; turn the workpiece")
    w = math.sqrt((1 + k) / 2)  # the turn is (z x axis, 1 + k) / (2 w), and this is its product with TOOL_DOWN
    return w, 0.0, 0.0 - i / (2 * w), j / (2 * w)


def turned(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles [rad], (...), of the shortest rotations between quaternions (..., 4)."""
    sign = np.where(np.sum(first * second, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return 4.0 * np.arcsin(np.minimum(np.linalg.norm(first - sign * second, axis=-1) / 2.0, 1.0))


def chords(run: Trajectory) -> np.ndarray:
    """Return the distances [m], (n - 1,), between the knots; LEVER times the angle where the tool turns in place."""
    move = np.diff(run.position, axis=0)
    length = np.sqrt(np.einsum("ij,ij->i", move, move))  # ``norm`` takes four times as long
    k = np.flatnonzero(length == 0)
    if run.turns and k.size:
        length[k] = LEVER * turned(run.quaternion[k], run.quaternion[k + 1])
    return length


def _rows(name: str, array, count: int, width: int) -> np.ndarray:
    array = np.array(array, float)
    if array.shape != (count, width):
        raise TrajectoryError(f"{name} has the shape {array.shape}, but must have {(count, width)}")
    if not np.isfinite(array).all():
        _refuse(~np.isfinite(array).all(axis=1), f"its {name} is not finite")
    return array


def _refuse(bad: np.ndarray, reason: str) -> None:
    if bad.any():
        raise TrajectoryError(reason, int(np.argmax(bad)))


def fingerprint(trajectory: Trajectory) -> str:
    """Return the CRC-32 of times, positions and velocities as 8 hexadecimal digits; a message keeps these bits."""
    velocity = b"" if trajectory.velocity is None else trajectory.velocity.tobytes()
    return f"{zlib.crc32(trajectory.time_ns.tobytes() + trajectory.position.tobytes() + velocity):08x}"


def offsets(original: Trajectory, revised: Trajectory, tick_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Revised minus original at every tick: times [ns], (m,), shifts [m], (m, 3), turns as A, B, C [rad], (m, 3).

    Shifts and turns are in the axes of the trajectories' frame ($BASE); a turn carries the original orientation into
    the revised one.
    """
    if original.duration_ns != revised.duration_ns or original.frame != revised.frame:
        raise TrajectoryError("the original and the revised trajectory must share duration and frame")
    time_ns = np.arange(0, original.duration_ns + tick_ns, tick_ns)
    before, after = (rotation_from_quaternion(t.sample_orientation(time_ns)) for t in (original, revised))
    turn = abc_from_rotation(after @ np.swapaxes(before, 1, 2))
    return time_ns, revised.sample(time_ns) - original.sample(time_ns), turn


KNOT = ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
VELOCITY = ("vx_mm_per_s", "vy_mm_per_s", "vz_mm_per_s")
JOINTS = ("a1_deg", "a2_deg", "a3_deg", "a4_deg", "a5_deg", "a6_deg")


def write_csv(path, trajectory: Trajectory, joints=None) -> None:
    """Write the knots, their velocities if there are any, and joint angles [rad], (n, 6), if given.

    Every number but the angles is read back to the last bit.
    """
    header, columns = list(KNOT), [_in_mm(trajectory.position), _texts(trajectory.quaternion)]
    if not trajectory.turns:
        columns[1] = itertools.repeat(next(_texts(trajectory.quaternion[:1])), len(trajectory))
    if trajectory.velocity is not None:
        header += VELOCITY
        columns.append(_in_mm(trajectory.velocity))
    if joints is not None:
        header += JOINTS
        columns.append(_texts(np.degrees(np.asarray(joints, float)).reshape(len(trajectory), 6)))
    lines = map(",".join, zip(map(seconds, trajectory.time_ns.tolist()), *columns, strict=True))
    write_files({path: (f"{line}\n" for part in ([",".join(header)], lines) for line in part)})


def _texts(values: np.ndarray) -> Iterator[str]:
    for part in blocks(len(values)):
        yield from (",".join(map(repr, row)) for row in values[part].tolist())


def _in_mm(values: np.ndarray) -> Iterator[str]:
    """Metres as texts in mm: the decimal point is moved, so that no bit is lost."""
    for part in blocks(len(values)):
        yield from (",".join([str(Decimal(repr(v)).scaleb(3)) for v in row]) for row in values[part].tolist())


def read_csv(path) -> tuple[Trajectory, np.ndarray | None]:
    """Read what ``write_csv`` wrote: the trajectory and the joint angles [rad], (n, 6), or None."""
    table = read_table(path, KNOT + VELOCITY + JOINTS, KNOT, whole=True)
    column = dict(zip(table.names, table.numbers(table.names).T, strict=True))
    for name in (name for name in table.names if "_mm" in name):  # in m or m/s, without losing a bit
        column[name] = np.array([float(Decimal(text).scaleb(-3)) for text in table.texts(name)])
    several = {part[0]: [name in column for name in part] for part in (VELOCITY, JOINTS)}
    if any(any(there) != all(there) for there in several.values()):
        raise InputError(path, f"the header must be {','.join(KNOT)}, then velocities and joint angles if any", 1)
    latest = 9e9  # [s], what nanoseconds in 64 bits hold
    table.refuse(np.abs(column["time_s"]) > latest, "a time is too large")

    def columns(names) -> np.ndarray:
        return np.stack([column[name] for name in names], -1)

    time_ns = np.rint(column["time_s"] * 1e9).astype(np.int64)
    joints = columns(JOINTS) if JOINTS[0] in column else None
    velocity = columns(VELOCITY) if VELOCITY[0] in column else None
    try:
        run = Trajectory(time_ns, columns(KNOT[1:4]), columns(KNOT[4:]), velocity)
    except TrajectoryError as error:
        raise InputError(path, error.reason, None if error.index is None else table.lines[error.index]) from None
    return run, None if joints is None else np.radians(joints)
