"""First-order semi-discretisation of milling with one mode along the feed: the oracle of the limit depth of cut.

[Insperger2004] Insperger, Stepan: Updated semi-discretization method for periodic delay-differential equations with
discrete delay, Int. J. Numer. Meth. Eng. 61. Two teeth, one mode along the feed, 922 Hz, damping 0.011, 0.03993 kg,
K_t = 6e8, K_n = 2e8 N/m^2.
"""

import functools

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.sparse.linalg import eigs

OMEGA, ZETA, MASS, TEETH = 2 * np.pi * 922.0, 0.011, 0.03993, 2
#: the benchmark as settings of a cell
BENCHMARK = (
    "cutting.law=linear_edge", "cutting.linear_edge.tangential_cutting_n_per_mm2=600",
    "cutting.linear_edge.tangential_edge_n_per_mm=0", "cutting.linear_edge.radial_cutting_n_per_mm2=200",
    "cutting.linear_edge.radial_edge_n_per_mm=0", f"tool.teeth={TEETH}",
    f"tool.modes=[{{direction: [1, 0, 0], frequency_hz: 922, damping_ratio: {ZETA}, mass_kg: {MASS}}}]",
)  # fmt: skip
ENGAGED = {"slot": (0.0, np.pi), "up": (0.0, np.pi / 2), "down": (np.pi / 2, np.pi)}  # phi from +y, clockwise


def directional(immersion, intervals):
    """h(t) of m x'' + ... = -a h(t) (x(t) - x(t - tau)), its mean over each interval of a tooth period [N/m^2]."""
    entry, leave = ENGAGED[immersion]
    fine = (np.arange(intervals * 20) + 0.5) * 2 * np.pi / TEETH / (intervals * 20)
    total = np.zeros(fine.size)
    for tooth in range(TEETH):
        phi = fine + tooth * 2 * np.pi / TEETH
        total += ((phi >= entry) & (phi <= leave)) * (6e8 * np.cos(phi) + 2e8 * np.sin(phi)) * np.sin(phi)
    return total.reshape(intervals, 20).mean(1)


def later(immersion, intervals, radius):
    """By how many intervals the delay of the engaged tooth is longer than a tooth period; radius: R / f_z of a slot.

    The centre was at a distance f_z behind, so that the tooth before passed the same point of the surface at another
    angle: the delay is (pitch + phi - psi) / Omega with phi - psi = f_z sin(phi) / R, phi from the feed direction.
    """
    entry, leave = ENGAGED[immersion]
    phi = (np.arange(intervals) + 0.5) * np.pi / intervals  # from +y; one of two teeth is within half a turn
    return -np.cos(phi) * ((phi >= entry) & (phi <= leave)) * intervals / (np.pi * radius)


def multipliers(depth, delay, h, shift=None):
    """Floquet multipliers of x'' + 2 zeta w x' + w^2 x = -(a / m) h(t) (x - x_tau) over one delay [s].

    Over an interval the coefficients are constant and the delayed term is a straight line between its ends. State:
    x, x', x one interval ago, two, ... some more than len(h) intervals ago. shift: of the delay, in intervals, each.
    """
    k = len(h)
    shift = np.zeros(k) if shift is None else shift
    step, transition = delay / k, np.eye(k + 5)
    strength = depth * np.asarray(h) / MASS
    system = np.zeros((k, 4, 4))  # x, x', delayed term, its rate
    system[:, 0, 1], system[:, 1, 0], system[:, 1, 1] = 1.0, -(OMEGA**2) - strength, -2 * ZETA * OMEGA
    system[:, 1, 2], system[:, 2, 3] = strength, 1.0
    for exact, more in zip(expm(system * step)[:, :2], shift, strict=True):
        ends = np.outer(exact[:, 2] - exact[:, 3] / step, _ago(transition, k + more))  # from x(t_i - tau) ...
        ends += np.outer(exact[:, 3] / step, _ago(transition, k + more - 1))  # ... to x(t_i+1 - tau)
        now = exact[:, :2] @ transition[:2] + ends
        transition = np.vstack([now, transition[:1], transition[2:-1]])
    return np.linalg.eigvals(transition)


def modal_radius(modes, depth, period, lags, matrices):
    """Largest magnitude of a Floquet multiplier of n modes over k intervals of a period [s].

    As above, with q'' + 2 zeta w q' + w^2 q = a phi . sum B_j (u - u(t - tau_j)), u = sum phi q along x and y. lags:
    tau_j in intervals, (teeth,); matrices: B_j over an interval, its mean, (teeth, k, 3, 2).
    """
    k, n, step = matrices.shape[1], len(modes.frequency), period / matrices.shape[1]
    system = np.zeros((k, 4 * n, 4 * n))  # q, q', delayed term, its rate
    load = depth * modes.shape @ matrices
    system[:, :n, n : 2 * n] = np.eye(n)
    system[:, n : 2 * n, :n] = load.sum(0) @ modes.shape[:, :2].T - np.diag(modes.frequency**2)
    system[:, n : 2 * n, n : 2 * n] = -2 * np.diag(modes.damping_ratio * modes.frequency)
    system[:, n : 2 * n, 2 * n : 3 * n] = system[:, 2 * n : 3 * n, 3 * n :] = np.eye(n)
    transition = np.eye(2 * n + 2 * max(lags))  # q, q', u one interval ago, two, ...
    tip = np.hstack([modes.shape[:, :2].T, np.zeros((2, n))])
    for i, exact in enumerate(expm(system * step)[:, : 2 * n]):
        first, last = (
            -sum(load[j, i] @ transition[2 * (n + age - 1) : 2 * (n + age)] for j, age in enumerate(ages))
            for ages in (lags, np.subtract(lags, 1))
        )
        now = exact[:, : 2 * n] @ transition[: 2 * n] + exact[:, 2 * n : 3 * n] @ first
        now += exact[:, 3 * n :] @ (last - first) / step
        transition = np.vstack([now, tip @ transition[: 2 * n], transition[2 * n : -2]])
    return np.abs(eigs(transition, 6, v0=np.ones(len(transition)), return_eigenvectors=False)).max()


def _ago(transition, age):
    """x ``age`` intervals ago, on a straight line between two; age >= 1."""
    whole = int(age)
    return transition[whole + 1] + (age - whole) * (transition[whole + 2] - transition[whole + 1])


def radius(depth, delay, h, shift=None):
    return np.abs(multipliers(depth, delay, h, shift)).max()


def drifting_limit(case, intervals=320):
    """Limit depth [m] with the delays of ``later``: a tool whose radius is no large multiple of the feed per tooth."""
    near, _ = semi_discretisation(case)
    h, shift = directional(case.immersion, intervals), later(case.immersion, intervals, case.radius)
    delay = 60.0 / case.spindle_rpm / TEETH
    return brentq(lambda d: radius(d, delay, h, shift) - 1, 0.85 * near, 1.2 * near, rtol=1e-4)


def limit(delay, coarse, fine, depths):
    """Smallest depth [m] at which a multiplier leaves the unit circle, and that multiplier.

    coarse, fine: h in few intervals to look for it, in many to find it.
    """
    first = next(i for i, d in enumerate(depths) if radius(d, delay, coarse) > 1)
    low, high = 0.97 * depths[first - 1], 1.03 * depths[first]
    depth = brentq(lambda d: radius(d, delay, fine) - 1, low, high, rtol=1e-5)
    largest = multipliers(depth, delay, fine)
    return depth, largest[np.argmax(np.abs(largest))]


@functools.cache
def semi_discretisation(case, intervals=160):
    coarse, fine = (directional(case.immersion, n) for n in (40, intervals))
    return limit(60.0 / case.spindle_rpm / TEETH, coarse, fine, np.geomspace(1e-4, 6e-3, 30))
