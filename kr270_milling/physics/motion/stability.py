"""Stability of milling against regenerative chatter: the smallest depth of cut at which vibration does not die out.

Modes q_i'' + 2 zeta_i w_i q_i' + w_i^2 q_i = phi_i . F carry the tool tip, u = sum phi_i q_i. A tooth at the angle psi
with the unit vectors e (radial) and t (direction of motion) meets the dynamic chip e . (u(t) - u(t - tau)), so that

    F = a f e . (u(t) - u(t - tau)),   f = -(K_r e + K_t t - K_a z)

with a the depth of cut, tau the period of a tooth and K = dF/dh per depth at the static chip thickness. At a limit the
vibration repeats itself but for a factor of magnitude 1: u(t + tau) = mu u(t), mu = exp(i w tau). The delay then is the
factor 1 - 1/mu, and the chip vibration h = e . u of one tooth obeys

    h(s) / a = (1 - 1/mu) integral of e(s) . G(s - r) f(r) h(r) dr over the arc of engagement,
    G(t) = sum phi_i phi_i^T g_i(t),   g_i(t) = Im_i [exp(p_i t) / (1 - exp(p_i tau) / mu)] / w_di,   0 <= t < tau,
    g_i(t + tau) = mu g_i(t)

where Im_i is (x - its counterpart with the conjugate pole) / 2i. Teeth of unequal pitch have an h each, tau is a turn
or the part that repeats, and the tooth ahead, which was at the same angle before, takes the place of the delay:
h_j / a = v_j - v_j+1, v_j the integral over the arcs of all teeth, v_N = v_0 / mu. Gauss-Legendre nodes on the arc make
of it a matrix whose eigenvalues are 1/a. Real and positive eigenvalues are the limits, at all depths: period doubling
at mu = -1, Hopf between mu = 1 and -1. Source of the factor: [Budak1998], of mu at period doubling: [Insperger2004].
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import column
from kr270_milling.physics.cutting.laws import Cutting
from kr270_milling.physics.cutting.tool import Tool

DEEPEST = 0.1  #: [m], up to which limits are looked for
NODES = 8  #: on the arc for each wave, and 8 more: random limits are then within 1 % of another solution

_gauss = functools.cache(np.polynomial.legendre.leggauss)


@dataclass(frozen=True, eq=False)
class Modes:
    """n modes at the tool tip, workpiece axes."""

    frequency: np.ndarray  #: undamped [rad/s], (n,)
    damping_ratio: np.ndarray  #: (n,)
    shape: np.ndarray  #: mass-normalised, of the translations [kg^-1/2], (n, 3)


@dataclass(frozen=True)
class Lobe:
    """Limit depth at one spindle speed."""

    #: [rad/s]
    spindle_speed: float = column("spindle_speed_rpm", 30.0 / math.pi, unit="rpm", digits=0, short="spindle speed")
    #: [m]; infinite where no depth below 100 mm chatters
    depth_limit: float = column("depth_limit_mm", 1e3, unit="mm", digits=3, short="limit depth", infinite="above 100")
    #: [rad/s]; NaN where the limit is infinite
    chatter_frequency: float = column("chatter_hz", 0.5 / math.pi, unit="Hz", short="chatter")


def stability_limit(
    modes: Modes,
    tool: Tool,
    cutting: Cutting,
    feed_per_tooth: float,
    entry: float,
    leave: float,
    speed: float,
    deepest: float = DEEPEST,
) -> tuple[float, float]:
    """Smallest depth [m] up to ``deepest`` at which vibration does not die out, and its frequency [rad/s].

    Where there is none: infinite, NaN. modes: in axes with x along the feed; entry, leave: angles of a tooth [rad] from
    the feed, in the sense of rotation; speed: of the spindle [rad/s].
    """
    waves = modes.frequency * (leave - entry) / (2.0 * math.pi * speed)
    most_waves = 20.0  # waves of a mode on the arc of engagement
    # a mode with more waves keeps its stiffness: its lobes are so dense that its lowest limit counts at every speed
    slower = most_waves / np.maximum(waves, most_waves)
    modes = Modes(modes.frequency * slower, modes.damping_ratio, modes.shape * slower[:, None])
    after = range(1, tool.teeth)  # teeth, after which the pitches repeat
    repeat = next((n for n in after if np.ptp(tool.pitches - np.roll(tool.pitches, n)) < 1e-9), tool.teeth)
    pitches = tool.pitches[:repeat]
    density = NODES if repeat == 1 else 2 * NODES  # kinks of G are between the nodes of unequal teeth
    period = float(pitches.sum()) / speed
    nodes = _nodes(entry, leave, float(pitches.mean()), math.ceil(density * float(np.max(waves * slower))) + 8, density)
    inverse_depths = _inverse_depths(modes, tool, cutting, feed_per_tooth, *nodes, pitches, speed)
    inverse, frequency = _largest_real(inverse_depths, _starts(modes, period), 1.0 / deepest)
    if math.isnan(frequency):
        return math.inf, math.nan
    # mu is the same for each w + 2 pi k / T; chatter is near the mode that the cut excites
    line, signed = 2.0 * np.pi / period, np.array([[frequency], [-frequency]])
    candidates = signed + line * np.round((modes.frequency - signed) / line)
    away = np.abs(candidates / modes.frequency - 1.0)
    place = np.unravel_index(np.argmin(away), away.shape)
    return 1.0 / inverse, float(abs(candidates[place]) / slower[place[1]])


def _inverse_depths(
    modes: Modes,
    tool: Tool,
    cutting: Cutting,
    feed_per_tooth: float,
    angle: np.ndarray,
    weight: np.ndarray,
    basis: np.ndarray,
    pitches: np.ndarray,
    speed: float,
) -> Callable:
    """Return the function of frequencies [rad/s] (m,) that yields the 1/a there [1/m], (m, k); 0 for small ones.

    pitches: to the tooth ahead [rad], of the teeth of a period, (n,).
    """
    teeth, count, period = pitches.size, angle.size, float(pitches.sum()) / speed
    lead, share = np.repeat([np.cumsum(pitches) - pitches, pitches / pitches.mean()], count, axis=1)
    angle, weight = np.tile(angle, teeth), np.tile(weight, teeth)
    radial = np.stack([np.cos(angle), tool.sense * np.sin(angle)], -1)
    motion = np.stack([-np.sin(angle), tool.sense * np.cos(angle)], -1)
    chip = feed_per_tooth * share * np.maximum(np.cos(angle), 1e-3)
    k_t, k_r, k_a = cutting.active.slopes(chip)
    plane = -(k_r[:, None] * radial + k_t[:, None] * motion)
    force = np.column_stack([plane, -k_a])  # k_a above 0 pulls the tool toward the part, -z
    step = weight / speed  # [s]
    # a resonance with this damping ratio is finite
    w, zeta = modes.frequency, np.maximum(modes.damping_ratio, 1e-6)
    damped = w * np.sqrt(1.0 - zeta * zeta)
    pole = -zeta * w + 1j * damped
    moment = (angle - lead) / speed
    time = moment[:, None] - moment
    turns = np.floor(time / period + 1e-6)
    within = time - turns * period
    gain = (modes.shape[:, :2] @ radial.T)[:, :, None] * (modes.shape @ force.T)[:, None]
    gain *= np.sqrt(step[:, None] * step)  # symmetric weights: the same eigenvalues, a smaller norm
    kernel = gain * np.exp(pole[:, None, None] * within) / (2j * damped[:, None, None])
    decay = np.exp(pole * period)
    # G has a kink at t = 0, where the rate of g jumps by 1: the rule is wrong by the square of the step / 12
    kink = np.where(within < 1e-6 * period, gain.sum(0) * step / 12.0, 0.0)

    shifts, shift = np.unique(turns, return_inverse=True)
    parts = np.concatenate([kernel, kink[None]])[:, None]
    parts = parts * (shift.reshape(time.shape) == np.arange(shifts.size)[:, None, None])
    parts = parts.reshape(-1, shifts.size, teeth, count, teeth, count).swapaxes(3, 4)
    parts = (basis.T @ parts @ basis).swapaxes(3, 4)
    size = teeth * basis.shape[1]
    parts = np.concatenate([parts[:-1], parts[:-1].conj(), parts[-1:]]).reshape(-1, size**2)
    decay = np.concatenate([decay, decay.conj(), [0.0]])

    def at(frequency: np.ndarray, least: float) -> np.ndarray:
        mu = np.exp(1j * frequency * period)[:, None]
        factors = (1.0 / (1.0 - decay / mu))[:, :, None] * mu[..., None] ** shifts
        loop = (factors.reshape(frequency.size, -1) @ parts).reshape(-1, size, size)
        first = loop[:, : basis.shape[1]] / mu[..., None]
        loop[:, : -basis.shape[1]] -= loop[:, basis.shape[1] :]  # the tooth ahead
        loop[:, -basis.shape[1] :] -= first
        # no eigenvalue is larger than the root of the norm of the square
        # eigenvalues below 70 % of the least 1/a do not matter
        large = np.linalg.norm(loop @ loop, axis=(1, 2)) > (0.7 * least) ** 2
        values = np.zeros(loop.shape[:2], complex)
        values[large] = np.linalg.eigvals(loop[large])
        return values

    return at


@functools.lru_cache(64)
def _nodes(
    entry: float, leave: float, pitch: float, count: int, density: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles and weights of some ``count`` nodes, by Gauss' rule between places that a pitch repeats, and a basis.

    Where a tooth is at a node, the others in cut are at nodes too, and so are the kinks of G. The vibrations are
    smooth: a few polynomials on the arc, the basis, make a smaller matrix of the same largest eigenvalues.
    """
    repeats = np.arange(math.ceil((leave - entry) / pitch)) * pitch
    ends = np.unique(np.round(np.concatenate([entry + repeats, leave - repeats]), 9))
    lengths = np.diff(ends)
    rules = [_gauss(max(2, math.ceil(count * part))) for part in lengths / (leave - entry)]
    half = 0.5 * lengths
    angles = [start + size * (1.0 + rule[0]) for start, size, rule in zip(ends[:-1], half, rules, strict=True)]
    angle = np.concatenate(angles)
    weight = np.concatenate([size * rule[1] for size, rule in zip(half, rules, strict=True)])
    span = (2.0 * angle - angle[0] - angle[-1]) / (angle[-1] - angle[0])
    degree = (
        math.ceil(3.6 * angle.size / density) + 6
    )  # for each wave, pi at least; 4.5 give limits that differ by 3e-5
    basis = np.linalg.qr(np.sqrt(weight)[:, None] * np.polynomial.legendre.legvander(span, degree))[0]
    return angle, weight, basis


def _starts(modes: Modes, period: float) -> np.ndarray:
    """Frequencies [rad/s] from mu = 1 to mu = -1, ascending: equal steps, and about the resonances."""
    most = np.pi / period
    about = modes.frequency[:, None] * (
        # in half widths of a resonance from its frequency
        np.sqrt(1.0 - modes.damping_ratio**2)[:, None]
        + modes.damping_ratio[:, None] * np.array([-2.5, -0.7, 0.0, 0.7, 2.5])
    )
    folded = np.abs((about.ravel() + most) % (2.0 * most) - most)
    # the search starts at 9 frequencies from mu = 1 to -1
    return np.unique(np.append(folded[folded > 1e-6 * most], np.linspace(0.0, most, 9)))


def _largest_real(inverse_depths: Callable, frequency: np.ndarray, least: float) -> tuple[float, float]:
    """The largest real 1/a above ``least`` and its frequency, NaN where there is none.

    An interval of frequencies is halved while an eigenvalue on the way from one end to the other, which is the nearest
    one, may pass the real axis above the largest crossing so far.
    """
    values = inverse_depths(frequency, least)
    best, at = least, math.nan
    for end in (0, -1):  # at mu = 1 and -1, where the imaginary part of a real eigenvalue is rounding
        real = values[end].real[np.abs(values[end].imag) <= 1e-7 * np.abs(values[end])]
        best, at = max((best, at), (float(real.max(initial=0.0)), float(frequency[end])))
    low, high, before, after = frequency[:-1], frequency[1:], values[:-1], values[1:]
    reach, guess, crossing = _interval(low, high, before, after)
    while True:
        k = int(np.argmax(crossing[:, 0]))
        if crossing[k, 0] > best:
            best, at = float(crossing[k, 0]), float(crossing[k, 1])
        rest = (reach > best) & (high - low > 1e-9 * high)
        low, high, before, after = low[rest], high[rest], before[rest], after[rest]
        reach, guess, crossing = reach[rest], guess[rest], crossing[rest]
        if not low.size:
            return best, at
        # the most promising interval first, because a large limit ends the search in the others
        now = guess == guess.max() if guess.max() > best else np.ones(low.size, bool)
        middle = 0.5 * (low[now] + high[now])
        values = inverse_depths(middle, best)
        halves = (
            np.concatenate([low[now], middle]),
            np.concatenate([middle, high[now]]),
            np.concatenate([before[now], values]),
            np.concatenate([values, after[now]]),
        )
        new = (*halves, *_interval(*halves))
        old = (each[~now] for each in (low, high, before, after, reach, guess, crossing))
        low, high, before, after, reach, guess, crossing = map(np.concatenate, zip(old, new, strict=True))


def _interval(low: np.ndarray, high: np.ndarray, before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return what intervals of frequencies may contain: see ``_largest_real``.

    The largest 1/a that an eigenvalue may have on the real axis, (n,), 0 where none comes near it or all that do
    are known; a guess of it, (n,), 0: none; the largest known one and its frequency, (n, 2), 0: none.
    """
    apart = np.abs(before[:, :, None] - after[:, None])
    rows = np.arange(low.size)
    start = np.concatenate([before, before[rows[:, None], apart.argmin(1)]], 1)
    end = np.concatenate([after[rows[:, None], apart.argmin(2)], after], 1)
    travel, passes = np.abs(end - start), start.imag * end.imag <= 0.0
    near = 0.35  # distance from the real axis, as a share of that to the next eigenvalue, that makes a limit possible
    close = passes | (np.minimum(np.abs(start.imag), np.abs(end.imag)) < near * travel)
    # two eigenvalues that differ by less than 0.5 % enclose a limit
    fine = travel <= 5e-3 * np.maximum(np.abs(start), np.abs(end))
    share = start.imag / np.where(start.imag == end.imag, 1.0, start.imag - end.imag)
    on_axis = np.where(passes, start.real + share * (end.real - start.real), 0.0)
    known, guess = np.where(fine, on_axis, 0.0), np.where(fine, 0.0, on_axis)
    k = known.argmax(1)
    crossing = np.stack([known[rows, k], low + share[rows, k] * (high - low)], 1)
    reach = np.where(close & ~fine, np.maximum(start.real, end.real) + near * travel, 0.0)
    return reach.max(1), guess.max(1), crossing
