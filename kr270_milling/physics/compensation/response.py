"""Response of the tool to the reference and to the wrench: the modes of the arm, in closed form.

With the reference r (motor side) and the tool z = r + delta, M delta'' + C delta' + K delta = F - M r''. A change of
the reference moves the tool, mode by mode, by

    z / r = (2 zeta omega s + omega^2) / (s^2 + 2 zeta omega s + omega^2)

The correction is a cubic c + v t + a t^2 / 2 + j t^3 / 6 between two knots. The relative modal coordinate u = p - q
(p of the tool, q of the reference) obeys u'' + 2 zeta omega u' + omega^2 u = -q'' = -(a + j t), which is solved by
u = h11 u0 + h12 u0' + (h11 - 1) a / omega^2 + (2 zeta / omega (1 - h11) + h12 - t) j / omega^2, where h11 and h12 are
the free vibrations from u0 = 1 and from u0' = 1. At a corner of the reference p' is steady, so u' jumps by -dv.

The motors of a plant may follow the correction late: y'' + 2 zeta w y' + w^2 y = w^2 (c + v t + a t^2 / 2 + j t^3 / 6).
A polynomial p0 + p1 t + p2 t^2 / 2 + p3 t^3 / 6 solves this for p3 = j, p2 = a - 2 zeta / w p3,
p1 = v - 2 zeta / w p2 - p3 / w^2, p0 = c - 2 zeta / w p1 - p2 / w^2; the rest y - p is a free vibration.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline

from kr270_milling.base.blocks import blocks
from kr270_milling.physics.motion.dynamics import ArmFactors

FEWEST, MOST = 4, 16  #: parts in a segment
BLOCK = 4096  #: segments that are computed at once, some 12 kB each


@dataclass(frozen=True, eq=False)
class Segments:
    """The m segments between m + 1 knots. Values of a part are those at its middle."""

    time_ns: np.ndarray  #: knots [ns], (m + 1,)
    parts: int  #: number of parts of a segment

    @classmethod
    def of(cls, time_ns: np.ndarray) -> Segments:
        typical = float(np.median(np.diff(time_ns))) * 1e-9
        longest = 3e-3  # [s], of a part: a tenth of the period of a mode at 33 Hz
        return cls(time_ns, int(np.clip(np.ceil(typical / longest - 1e-9), FEWEST, MOST)))

    def __len__(self) -> int:
        return self.time_ns.size - 1

    def blocks(self) -> Iterator[slice]:
        """All segments, so many at a time that what is computed of each stays small."""
        return blocks(len(self), BLOCK)

    def cut(self, part: slice) -> Segments:
        """The segments of ``part``."""
        return Segments(self.time_ns[part.start : part.stop + 1], self.parts)

    @property
    def duration(self) -> np.ndarray:
        """[s], (m,)"""
        return np.diff(self.time_ns) * 1e-9

    @property
    def place(self) -> np.ndarray:
        """Middle of each part from the start of its segment [s], (m, parts)."""
        return self.duration[:, None] * ((np.arange(self.parts) + 0.5) / self.parts)

    @property
    def powers(self) -> np.ndarray:
        """1, t, t^2 / 2, t^3 / 6 at these places, (m, parts, 4)."""
        place = self.place
        return np.stack([np.ones_like(place), place, place**2 / 2.0, place**3 / 6.0], axis=-1)

    @property
    def middle_ns(self) -> np.ndarray:
        """Middle of each part [ns], (m, parts)."""
        return self.time_ns[:-1, None] + np.rint(self.place * 1e9).astype(np.int64)

    def part_of(self, time_ns: np.ndarray) -> np.ndarray:
        """Number of the part, counted over all segments, in which each time [ns] lies; (n,)."""
        segment = np.clip(np.searchsorted(self.time_ns, time_ns, side="right") - 1, 0, len(self) - 1)
        share = (time_ns - self.time_ns[segment]) / np.diff(self.time_ns)[segment]
        return segment * self.parts + np.clip((share * self.parts).astype(int), 0, self.parts - 1)

    def mean(self, time_ns: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Mean of samples (n, d) in each part, (m, parts, d); interpolated where no sample lies in a part."""
        size, part = len(self) * self.parts, self.part_of(time_ns)
        count = np.maximum(np.bincount(part, minlength=size), 1)[:, None]
        mean = np.stack([np.bincount(part, v, size) for v in values.T], axis=1) / count
        empty = np.bincount(part, minlength=size) == 0
        if empty.any():
            at = self.middle_ns.ravel()[empty]
            mean[empty] = np.stack([np.interp(at, time_ns, v) for v in values.T], axis=1)
        return mean.reshape(len(self), self.parts, values.shape[1])

    def middle(self, time_ns: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Samples (n, d) in the middle of each part, (m, parts, d), with as little noise as their mean has.

        Taylor: mean = v + v' <t> + v'' <t^2> / 2 over the times t of the samples from the middle; v' and v'' come from
        the means of the neighbouring parts. Of fewer than two samples a part there is no mean to correct: a spline
        through the samples.
        """
        if time_ns.size < 2 * self.middle_ns.size:
            time, middles = time_ns * 1e-9, self.middle_ns * 1e-9
            return np.stack([CubicSpline(time, v)(middles) for v in values.T], axis=-1)  # one at a time: memory
        mean = self.mean(time_ns, values).reshape(-1, values.shape[1])
        off = (time_ns - self.middle_ns.ravel()[self.part_of(time_ns)])[:, None] * 1e-9
        first, second = self.mean(time_ns, np.hstack([off, off**2 / 2.0])).reshape(-1, 2).T
        time = self.middle_ns.ravel() * 1e-9
        slope = np.gradient(mean, time, axis=0)
        bend = np.gradient(slope, time, axis=0)
        return (mean - slope * first[:, None] - bend * second[:, None]).reshape(len(self), self.parts, -1)


def cubic_coefficients(time_ns: np.ndarray, value: np.ndarray, rate: np.ndarray | None) -> np.ndarray:
    """c, v, a, j of c + v t + a t^2 / 2 + j t^3 / 6 on each segment, (m, 4, d).

    The Hermite cubics through values (m + 1, d) with rates (m + 1, d); straight lines where there are no rates.
    """
    step = (np.diff(time_ns) * 1e-9)[:, None]
    move = np.diff(value, axis=0) / step
    if rate is None:
        return np.stack([value[:-1], move, np.zeros_like(move), np.zeros_like(move)], axis=1)
    first, last = rate[:-1], rate[1:]
    bend = (6.0 * move - 4.0 * first - 2.0 * last) / step
    jerk = 6.0 * (first + last - 2.0 * move) / step**2
    return np.stack([value[:-1], first, bend, jerk], axis=1)


@dataclass(frozen=True)
class Lag:
    """Second order with which the motors follow a correction, at rest before the pass."""

    frequency: float  #: w [rad/s]
    damping: float

    @classmethod
    def of(cls, frequency: float, damping: float, delay: float) -> Lag | None:
        """A lag of ``frequency`` [rad/s] (0: none) after a dead time [s], as one second order; None without both.

        Equal up to s^2: exp(-T s) / (1 + 2 zeta s / w + s^2 / w^2) = 1 / (1 + b s + c s^2 + ...).
        """
        slope, bend = (2.0 * damping / frequency, 1.0 / frequency**2) if frequency else (0.0, 0.0)
        b, c = slope + delay, bend + slope * delay + delay**2 / 2.0
        return cls(c**-0.5, 0.5 * b * c**-0.5) if c else None

    def matrices(self, duration: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Matrices of segments (m,) [s]: (y, y') at the end from those at the start, (m, 2, 2), and from a cubic,
        (m, 2, 4); the cubic from (y, y') at both ends, (m, 4, 4)."""
        w, z, t = self.frequency, self.damping, duration
        solved = np.eye(4)  # p from c, v, a, j
        for row in (2, 1, 0):
            solved[row] -= 2.0 * z / w * solved[row + 1] + (solved[row + 2] / w**2 if row < 2 else 0.0)
        free = np.stack(_free(w, z, t[:, None]), axis=-1).reshape(-1, 2, 2)
        unity, zero = np.ones_like(t), np.zeros_like(t)
        ahead = np.stack([unity, t, t**2 / 2.0, t**3 / 6.0, zero, unity, t, t**2 / 2.0], axis=-1).reshape(-1, 2, 4)
        hermite = [unity, zero, zero, zero, zero, unity, zero, zero, -6.0 / t**2, -4.0 / t, 6.0 / t**2, -2.0 / t]
        hermite += [12.0 / t**3, 6.0 / t**2, -12.0 / t**3, 6.0 / t**2]
        driven = (ahead - np.concatenate([free, np.zeros_like(free)], axis=-1)) @ solved
        return free, driven, np.stack(hermite, axis=-1).reshape(-1, 4, 4)

    def follow(self, segments: Segments, cubic: np.ndarray) -> np.ndarray:
        """Cubics (m, 4, 3) of the motors that follow cubics (m, 4, 3), equal at the knots."""
        free, driven, hermite = self.matrices(segments.duration)
        state = np.stack([cubic[0, 0], np.zeros(3)])
        n, wide = len(free), np.ascontiguousarray(np.repeat(free.reshape(-1, 4, 1), 3, axis=2))
        start, end = _march(wide, driven @ cubic, np.zeros((n, 3)), np.eye(3)[None], n, state)
        return hermite @ np.concatenate([start, end], axis=1)


@dataclass(frozen=True, eq=False)
class ArmResponse:
    """Modes of the arm on each of the m segments; no modes (r = 0): the tool follows the reference at once.

    Many segments share a posture: ``posture`` numbers those in the order of the path, and the arrays have a row of
    each of the n postures. Without ``posture`` each segment has its own row, n = m.
    """

    frequency: np.ndarray  #: omega [rad/s], (n, r)
    damping: np.ndarray  #: zeta, (n, r)
    inward: np.ndarray  #: reference -> modal coordinate q, (n, r, 3)
    outward: np.ndarray  #: relative modal coordinates u -> displacement of the tool, (n, 3, r)
    push: np.ndarray  #: wrench -> modal force, (n, r, 6)
    carry: np.ndarray  #: u at the end of the last segment of a posture -> u of the next posture, (n, r, r)
    moves: bool = True  #: the reference moves the motors' side of the springs; false: eq. (1) as printed
    gain: float = 1.0  #: gain of the response to the reference, as far as the process changes it
    tool: np.ndarray | None = None  #: compliance of the tool tip against the spindle [m/N], (n, 3, 3); None: rigid
    softness: float = 1.0  #: factor of the displacement under the wrench
    posture: np.ndarray | None = None  #: number of the posture of each segment, (m,); None: each has its own
    lag: Lag | None = None  #: lag of the motors behind a correction; None: they follow at once

    @classmethod
    def rigid(cls, segments: int) -> ArmResponse:
        """No modes: the tool follows the reference at once."""
        none = np.zeros((segments, 0))
        inward, outward = np.zeros((segments, 0, 3)), np.zeros((segments, 3, 0))
        return cls(none, none, inward, outward, np.zeros((segments, 0, 6)), np.zeros((segments, 0, 0)))

    @property
    def order(self) -> int:
        return self.frequency.shape[1]

    def cut(self, part: slice | np.ndarray) -> ArmResponse:
        """The modes on the segments of ``part``, a row of each segment."""
        names = ["frequency", "damping", "inward", "outward", "push", "carry"]
        names += [] if self.tool is None else ["tool"]
        rows = part if self.posture is None else self.posture[part]
        cut = dataclasses.replace(self, posture=None, **{name: getattr(self, name)[rows] for name in names})
        if self.posture is not None:
            following = part + 1 if isinstance(part, np.ndarray) else np.arange(part.start + 1, part.stop + 1)
            after = self.posture[np.minimum(following, self.posture.size - 1)]
            cut.carry[rows == after] = np.eye(self.order)
        return cut

    def scaled(self, frequency, damping, gain: float = 1.0, softness: float = 1.0) -> ArmResponse:
        """Factors on frequencies (r,), damping ratios (r,), gain and static compliance; the shapes stay.

        The static displacement under a wrench, push / omega^2, is that of ``softness`` alone.
        """
        factor = np.broadcast_to(frequency, (self.order,))
        most_damping = 0.95
        least_damping = 1e-4
        return dataclasses.replace(
            self,
            frequency=self.frequency * factor,
            damping=np.clip(self.damping * damping, least_damping, most_damping),
            push=self.push * factor[:, None] ** 2,
            gain=self.gain * gain,
            softness=self.softness * softness,
        )

    def modes(self, chosen: np.ndarray) -> ArmResponse:
        """The arm with some of its modes alone, (r,) bool."""
        fields = {name: getattr(self, name)[:, chosen] for name in ("frequency", "damping", "inward", "push")}
        carry, outward = self.carry[:, chosen][:, :, chosen], self.outward[:, :, chosen]
        return dataclasses.replace(self, carry=carry, outward=outward, **fields)

    def factors_on(self, model: ArmResponse) -> ArmFactors:
        """Return the factors that scaled ``model`` to this arm."""
        frequency, damping = self.frequency / model.frequency, self.damping / model.damping
        return ArmFactors(frequency[0], damping[0], self.gain / model.gain, self.softness / model.softness)

    def runs(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The first of equal segments in a row, and the number of the row of each segment, (m,); time [s], (m,): of
        each. A controller has even steps, and a posture is that of many steps."""
        new = np.append(True, np.diff(time) != 0.0)
        for rows in (self.frequency, self.damping, self.inward, self.outward, self.carry):
            flat = rows.reshape(len(rows), -1)
            new[1:] |= (flat[1:] != flat[:-1]).any(axis=1)
        return np.flatnonzero(new), np.cumsum(new) - 1

    def responses(self, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """``free`` and ``forced`` at times (m, t) [s], computed once for equal segments in a row."""
        first, run = self.runs(time[:, 0])
        some, time = self.cut(first), time[first]
        free = some.free(time)
        return tuple(values[run] for values in (*free, *some.forced(time, free)))

    def free(self, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """h11, h12, h21, h22, (m, t, r), at times (m, t) [s] from the start of each segment."""
        return _free(self.frequency[:, None], self.damping[:, None], time[..., None])

    def forced(self, time: np.ndarray, free: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        """u of a = 1, u of j = 1, u' of a = 1, u' of j = 1, (m, t, r), from rest; free: of these times."""
        h11, h12, h21, h22 = free
        w, z = self.frequency[:, None], self.damping[:, None]
        of_jerk = (2.0 * z / w * (1.0 - h11) + h12 - time[..., None]) / w**2
        return (h11 - 1.0) / w**2, of_jerk, h21 / w**2, (h22 - 1.0 - 2.0 * z / w * h21) / w**2

    def follow(self, segments: Segments, cubic: np.ndarray) -> np.ndarray:
        """Motion of the tool [m], (m, parts, 3), by cubics (m, 4, 3) of a correction of the reference.

        Before the pass the tool is on the correction's first value and does not move with it.
        """
        if not cubic.any():
            return np.zeros((len(segments), segments.parts, 3))
        cubic = self.lag.follow(segments, cubic) if self.lag else cubic
        return self.gain * (segments.powers @ cubic + self.swing(segments, cubic, np.zeros(3)))

    def swing(self, segments: Segments, cubic: np.ndarray, approach: np.ndarray) -> np.ndarray:
        """Displacement delta [m], (m, parts, 3), by the inertia of an arm that follows cubics (m, 4, 3).

        approach: the velocity of the reference before the pass [m/s], (3,).
        """
        if not (self.order and self.moves):
            return np.zeros((len(segments), segments.parts, 3))
        swung, state = np.empty((len(segments), segments.parts, 3)), np.zeros((2, self.order))
        for part in segments.blocks():
            arm, block = self.cut(part), segments.cut(part)
            start = arm.starts(block.duration[:, None], cubic[part], approach, state)[:, :, None]
            place, approach = block.place, _end_speed(block.duration[-1:, None], cubic[part][-1:])[0]
            response = arm.responses(place)
            bend, jerk = (np.einsum("mrd,md->mr", arm.inward, cubic[part, i])[:, None] for i in (2, 3))
            u = response[0] * start[:, 0] + response[1] * start[:, 1] + response[4] * bend + response[5] * jerk
            swung[part] = u @ np.swapaxes(arm.outward, 1, 2)
        return swung

    def starts(self, duration: np.ndarray, cubic: np.ndarray, approach: np.ndarray, state: np.ndarray) -> np.ndarray:
        """u and u' at the start of each segment, (m, 2, r); state (2, r): those before, becomes those after."""
        response = tuple(f[:, 0] for f in self.responses(duration))
        forced = response[4:]
        bend, jerk = (np.einsum("mrd,md->mr", self.inward, cubic[:, i]) for i in (2, 3))
        before = np.vstack([approach, _end_speed(duration, cubic)[:-1]])
        corner = np.einsum("mrd,md->mr", self.inward, before - cubic[:, 1])
        added = np.stack([forced[0] * bend + forced[1] * jerk, forced[2] * bend + forced[3] * jerk], axis=1)
        free = np.stack(response[:4], axis=1)
        return _march(free, added, corner, self.carry, 1, state)[0]

    def deflect(self, segments: Segments, wrench: np.ndarray) -> np.ndarray:
        """Displacement of the tool [m], (m, parts, 3), under mean wrenches (m, parts, 6), from rest."""
        if not self.order:
            return np.zeros(wrench.shape[:2] + (3,))
        parts, moved, state = segments.parts, np.empty(wrench.shape[:2] + (3,)), np.zeros((2, self.order))
        for part in segments.blocks():
            arm, step = self.cut(part), segments.cut(part).duration[:, None] / parts
            static = np.einsum("mrd,mpd->mpr", arm.push, wrench[part]) / arm.frequency[:, None] ** 2
            free = np.stack([h[:, 0] for h in arm.responses(step)[:4]], axis=1)
            added = np.stack([(1.0 - free[:, None, 0]) * static, -free[:, None, 2] * static], axis=2)
            steps = np.repeat(free, parts, axis=0), added.reshape(-1, 2, self.order)
            corner = np.zeros((len(steps[0]), self.order))
            start, end = _march(*steps, corner, arm.carry, parts, state)
            # the cubic through both ends with their slopes, in the middle
            middle = 0.5 * (start[:, 0] + end[:, 0]) + np.repeat(step, parts, axis=0) * (start[:, 1] - end[:, 1]) / 8.0
            moved[part] = self.softness * middle.reshape(static.shape) @ np.swapaxes(arm.outward, 1, 2)
            if arm.tool is not None:
                moved[part] += self.softness * wrench[part, :, :3] @ arm.tool
        return moved


def _free(w, z, time) -> tuple[np.ndarray, ...]:
    """h11, h12, h21, h22 of modes w [rad/s], zeta after evenly spaced times [s], (m, t) or (m, t, 1)."""
    damped = w * np.sqrt(1.0 - z * z)
    root = 1j * damped - z * w
    turned = np.repeat(np.exp(root * time[:, :1]), time.shape[1], axis=1)
    if time.shape[1] > 1:  # products take less time than powers
        step = np.exp(root * (time[:, 1:2] - time[:, :1]))[:, 0]
        for k in range(1, time.shape[1]):
            turned[:, k] = turned[:, k - 1] * step
    cosine, sine = turned.real, turned.imag / damped
    return cosine + z * w * sine, sine, -w * w * sine, cosine - z * w * sine


def _end_speed(duration: np.ndarray, cubic: np.ndarray) -> np.ndarray:
    """Velocity at the end of each segment, (m, 3), from durations (m, 1) and cubics (m, 4, 3)."""
    return cubic[:, 1] + cubic[:, 2] * duration + cubic[:, 3] * duration**2 / 2.0


@njit(cache=True, nogil=True)
def _march(free, added, corner, carry, every, state):
    """u, u' at the start and at the end of n steps, (n, 2, r) each; ``carry`` turns them after each ``every`` steps.

    state: u, u' before the first step, (2, r); becomes that after the last step.
    """
    n, r = corner.shape
    start, end = np.zeros((n, 2, r)), np.zeros((n, 2, r))
    for k in range(n):  # one number at a time: Numba compiles an assignment of arrays for seconds
        for i in range(r):
            state[1, i] += corner[k, i]
            start[k, 0, i], start[k, 1, i] = state[0, i], state[1, i]
            end[k, 0, i] = free[k, 0, i] * state[0, i] + free[k, 1, i] * state[1, i] + added[k, 0, i]
            end[k, 1, i] = free[k, 2, i] * state[0, i] + free[k, 3, i] * state[1, i] + added[k, 1, i]
        turned = (k + 1) % every == 0
        for i in range(r):
            for row in range(2):
                value = end[k, row, i]
                if turned:
                    value = 0.0
                    for j in range(r):
                        value += carry[k // every, i, j] * end[k, row, j]
                state[row, i] = value
    return start, end
