"""First-order semi-discretisation of milling with one mode along the feed: the oracle of the limit depth of cut.

[Insperger2004] Insperger, Stepan: Updated semi-discretization method for periodic delay-differential equations with
discrete delay, Int. J. Numer. Meth. Eng. 61. Two teeth, one mode along the feed, 922 Hz, damping 0.011, 0.03993 kg,
K_t = 6e8, K_n = 2e8 N/m^2.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

OMEGA, ZETA, MASS, TEETH = 2 * np.pi * 922.0, 0.011, 0.03993, 2
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


def multipliers(depth, delay, h):
    """Floquet multipliers of x'' + 2 zeta w x' + w^2 x = -(a / m) h(t) (x - x_tau) over one delay [s].

    Over an interval the coefficients are constant and the delayed term is a straight line between its ends. State:
    x, x', x one interval ago, two, ... len(h) intervals ago.
    """
    k = len(h)
    step, transition = delay / k, np.eye(k + 2)
    strength = depth * np.asarray(h) / MASS
    system = np.zeros((k, 4, 4))  # x, x', delayed term, its rate
    system[:, 0, 1], system[:, 1, 0], system[:, 1, 1] = 1.0, -(OMEGA**2) - strength, -2 * ZETA * OMEGA
    system[:, 1, 2], system[:, 2, 3] = strength, 1.0
    for exact in expm(system * step)[:, :2]:
        ends = np.outer(exact[:, 2] - exact[:, 3] / step, transition[k + 1])  # from x(t_i - tau) ...
        ends += np.outer(exact[:, 3] / step, transition[k])  # ... to x(t_i+1 - tau)
        now = exact[:, :2] @ transition[:2] + ends
        transition = np.vstack([now, transition[:1], transition[2:-1]])
    return np.linalg.eigvals(transition)


def radius(depth, delay, h):
    return np.abs(multipliers(depth, delay, h)).max()


def limit(delay, coarse, fine, depths):
    """Smallest depth [m] at which a multiplier leaves the unit circle, and that multiplier.

    coarse, fine: h in few intervals to look for it, in many to find it.
    """
    first = next(i for i, d in enumerate(depths) if radius(d, delay, coarse) > 1)
    low, high = 0.97 * depths[first - 1], 1.03 * depths[first]
    found = brentq(lambda d: radius(d, delay, fine) - 1, low, high, rtol=1e-5)
    largest = multipliers(found, delay, fine)
    return found, largest[np.argmax(np.abs(largest))]


@functools.cache
def semi_discretisation(case, intervals=160):
    coarse, fine = (directional(case.immersion, n) for n in (40, intervals))
    return limit(60.0 / case.spindle_rpm / TEETH, coarse, fine, np.geomspace(1e-4, 6e-3, 30))
