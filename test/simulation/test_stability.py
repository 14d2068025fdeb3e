"""The limit depth of cut of the time-domain model against first-order semi-discretisation, which is written here.

[Insperger2004] Insperger, Stepan: Updated semi-discretization method for periodic delay-differential equations with
discrete delay, Int. J. Numer. Meth. Eng. 61. Two teeth, one mode along the feed, 922 Hz, damping 0.011, 0.03993 kg,
K_t = 6e8, K_n = 2e8 N/m^2.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from kr270_milling.verification.stability import BENCHMARK, LIMITS, BracketError, Milling, growth, limit_depth

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


# --- the oracle itself ---


def test_semi_discretisation_finds_the_closed_form_of_turning():
    """Constant h: the borderline frequency w_c gives a h = (w_c^2 - w^2) / 2 + 2 (zeta w w_c)^2 / (w_c^2 - w^2)."""
    beyond = OMEGA * 1.02
    rise = beyond**2 - OMEGA**2
    strength = rise / 2 + 2 * (ZETA * OMEGA * beyond) ** 2 / rise
    for lobe in (1, 4):
        phase = np.arctan2(rise, 2 * ZETA * OMEGA * beyond)
        delay = 2 * (lobe * np.pi - phase) / beyond
        found, multiplier = limit(delay, np.full(40, 1e9), np.full(160, 1e9), np.geomspace(1e-5, 1e-2, 30))
        assert found * 1e9 / MASS == pytest.approx(strength, rel=2e-3)
        assert abs(multiplier.imag) > 0.01


@pytest.mark.parametrize("case", LIMITS)
def test_semi_discretisation_converges_with_second_order_or_better(case):
    finest, _ = semi_discretisation(case, 200)
    errors = [abs(semi_discretisation(case, n)[0] - finest) for n in (40, 80)]
    assert errors[1] < errors[0] / 3.5 or errors[0] < 1e-3 * finest


def test_one_case_of_period_doubling_and_two_of_hopf_are_among_the_cases():
    at_limit = {case: semi_discretisation(case)[1] for case in LIMITS}
    assert [abs(m.imag) < 1e-6 and m.real < 0 for m in at_limit.values()] == [False, False, True]
    assert all(abs(m.imag) > 0.1 for m in list(at_limit.values())[:2])


def test_the_verification_book_quotes_semi_discretisation():
    for case, quoted in LIMITS.items():
        assert quoted == pytest.approx(semi_discretisation(case)[0], rel=2e-3)


# --- the time-domain model ---


@pytest.mark.parametrize(
    "case, tolerance",
    [
        (Milling(14000.0, "up"), 0.02),  # in a lobe
        (Milling(15000.0, "up"), 0.02),
        (Milling(15000.0, "down"), 0.02),  # period doubling
        (Milling(12000.0, "slot"), 0.02),  # period doubling
        (Milling(5000.0, "slot"), 0.05),
    ],
    ids=lambda v: f"{v.immersion} {v.spindle_rpm:.0f}" if isinstance(v, Milling) else "",
)
def test_the_limit_depth_of_the_time_domain_model_is_that_of_semi_discretisation(case, tolerance):
    expected, _ = semi_discretisation(case)
    assert limit_depth(BENCHMARK, case, 0.8 * expected, 1.25 * expected) == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_disturbances_grow_and_die_as_fast_as_the_multiplier_says(share):
    case = Milling(15000.0, "up")
    depth = share * semi_discretisation(case)[0]
    largest = np.abs(multipliers(depth, 0.002, directional("up", 160))).max()
    assert growth(BENCHMARK, case, depth) == pytest.approx(np.log(largest), rel=0.12)


def test_two_stable_depths_are_no_bracket():
    with pytest.raises(BracketError, match="must lie between"):
        limit_depth(BENCHMARK, Milling(15000.0, "up"), 0.1e-3, 0.15e-3)
