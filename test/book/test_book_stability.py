"""The limit depth of cut of the time-domain model against first-order semi-discretisation."""

from __future__ import annotations

import numpy as np
import pytest
from book import check
from flexible_tool import BENCHMARK, Milling, growth, limit_depth
from semi_discretisation import MASS, OMEGA, ZETA, directional, limit, multipliers, semi_discretisation

#: Hopf at the foot of a lobe, Hopf within a lobe, period doubling
LOBES = (Milling(15000.0, "up"), Milling(14000.0, "up"), Milling(15000.0, "down"))
SLOTS = (Milling(12000.0, "slot"), Milling(5000.0, "slot"))
SHARE = {5000.0: 0.05}  # else 0.02: at low speeds a lobe is narrow


@check(
    "stability limit, {case.spindle_rpm:.0f} rpm, {case.immersion}: where growth changes its sign",
    "first-order semi-discretisation of the benchmark of [Insperger2004], test/book/semi_discretisation.py", "m",
    cases=("case", [(case,) for case in LOBES + SLOTS]),
)  # fmt: skip
def test_limit_depth(case):
    expected, share = semi_discretisation(case)[0], SHARE.get(case.spindle_rpm, 0.02)
    return expected, limit_depth(BENCHMARK, case, expected, share), share * expected


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_disturbances_grow_and_die_as_fast_as_the_multiplier_says(share):
    case = Milling(15000.0, "up")
    depth = share * semi_discretisation(case)[0]
    largest = np.abs(multipliers(depth, 0.002, directional("up", 160))).max()
    assert growth(BENCHMARK, case, depth) == pytest.approx(np.log(largest), rel=0.12)


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


@pytest.mark.parametrize("case", LOBES)
def test_semi_discretisation_converges_with_second_order_or_better(case):
    finest, _ = semi_discretisation(case, 200)
    errors = [abs(semi_discretisation(case, n)[0] - finest) for n in (40, 80)]
    assert errors[1] < errors[0] / 3.5 or errors[0] < 1e-3 * finest


def test_one_case_of_period_doubling_and_two_of_hopf_are_among_the_cases():
    at_limit = {case: semi_discretisation(case)[1] for case in LOBES}
    assert [abs(m.imag) < 1e-6 and m.real < 0 for m in at_limit.values()] == [False, False, True]
    assert all(abs(m.imag) > 0.1 for m in list(at_limit.values())[:2])
