"""The limit depth of cut of the time-domain model against first-order semi-discretisation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from book import check
from flexible_tool import Milling, growth, limit_depth
from semi_discretisation import (
    MASS,
    OMEGA,
    ZETA,
    directional,
    drifting_limit,
    limit,
    multipliers,
    semi_discretisation,
)

#: Hopf at the foot of a lobe, Hopf within a lobe, period doubling
LOBES = (Milling(15000.0, "up"), Milling(14000.0, "up"), Milling(15000.0, "down"))
SLOTS = (Milling(12000.0, "slot"), Milling(5000.0, "slot"))
SHARE = {5000.0: 0.05}  #: else 0.02; at 5000 rpm a lobe is narrow
#: At 14,000 rpm the growth a period changes by 0.0013 only in 2 % of the depth, while terms of f_z / R, which the
#: oracle leaves out, are worth K_t a f_z T / (2 m omega R) = 0.004 at R / f_z = 1000: 6 % of the depth, and half of
#: it at 2000. So this limit is that of R / f_z = 1000 and 2000, extrapolated.
FLAT = 14000.0


@check(
    "stability limit, {case.spindle_rpm:.0f} rpm, {case.immersion}: where growth changes its sign",
    "first-order semi-discretisation of the benchmark of [Insperger2004], test/book/semi_discretisation.py", "m",
    cases=("case", [(case,) for case in LOBES + SLOTS]),
)  # fmt: skip
def test_limit_depth(case):
    expected, share = semi_discretisation(case)[0], SHARE.get(case.spindle_rpm, 0.02)
    if case.spindle_rpm != FLAT:
        return expected, limit_depth(case, expected, share), share * expected
    near, far = (
        limit_depth(dataclasses.replace(case, radius=radius), (1.0 - 60.0 / radius) * expected, share)
        for radius in (1000, 2000)
    )
    return expected, 2.0 * far - near, share * expected


#: R / f_z of an ordinary cutter; the tolerance: what the grid's noise makes of a narrow lobe
SMALL = {Milling(15000.0, "up", 80): 0.02, Milling(5000.0, "slot", 80): 0.04}


@check(
    "stability limit at R / f_z = 80, {case.spindle_rpm:.0f} rpm, {case.immersion}: chips over the angle seen from the "
    "previous centre", "semi-discretisation with the delay between two trochoids [derived], "
    "test/book/semi_discretisation.py", "m", cases=("case", [(case,) for case in SMALL]),
)  # fmt: skip
def test_limit_depth_of_a_small_radius(case):
    """With the nominal angle the slot's limit would be 40 % high."""
    expected = drifting_limit(case)
    return expected, limit_depth(case, expected, 0.03), SMALL[case] * expected


def test_the_delay_between_two_trochoids_tends_to_the_tooth_period():
    wide, limit_of_the_period = Milling(12000.0, "slot", 100_000), semi_discretisation(SLOTS[0])[0]
    assert drifting_limit(wide) == pytest.approx(limit_of_the_period, rel=2e-3)
    assert drifting_limit(Milling(12000.0, "slot", 80)) > 1.05 * limit_of_the_period


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_disturbances_grow_and_die_as_fast_as_the_multiplier_says(share):
    case = Milling(15000.0, "up")
    depth = share * semi_discretisation(case)[0]
    largest = np.abs(multipliers(depth, 0.002, directional("up", 160))).max()
    assert growth(case, depth) == pytest.approx(np.log(largest), rel=0.12)


# --- the oracle itself ---
def test_semi_discretisation_finds_the_closed_form_of_turning():
    """Constant h: the borderline frequency w_c gives a h = (w_c^2 - w^2) / 2 + 2 (zeta w w_c)^2 / (w_c^2 - w^2)."""
    beyond = OMEGA * 1.02
    rise = beyond**2 - OMEGA**2
    strength = rise / 2 + 2 * (ZETA * OMEGA * beyond) ** 2 / rise
    for lobe in (1, 4):
        phase = np.arctan2(rise, 2 * ZETA * OMEGA * beyond)
        delay = 2 * (lobe * np.pi - phase) / beyond
        depth, multiplier = limit(delay, np.full(40, 1e9), np.full(160, 1e9), np.geomspace(1e-5, 1e-2, 30))
        assert depth * 1e9 / MASS == pytest.approx(strength, rel=2e-3)
        assert abs(multiplier.imag) > 0.01
