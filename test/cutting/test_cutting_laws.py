"""Force laws as functions of the chip thickness."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.record import build
from kr270_milling.cutting import Cutting, FractionalLaw, LinearEdgeLaw, fractional, linear_edge

thickness = st.floats(0.0, 1e-3)


def test_one_tooth_at_full_chip_feels_133_newtons_per_millimetre():
    """facts: k_0 read for one millimetre of depth, h = 0.125 mm."""
    tangential, radial = Cutting().force_per_depth(0.125e-3)
    assert tangential * 1e-3 == pytest.approx(133.3, abs=0.05)
    assert radial == pytest.approx(0.3 * tangential, rel=1e-12)


def test_fractional_law_has_the_stiffness_k_0_at_first_and_r_k_0_at_last():
    law = Cutting().fractional
    slope = [(fractional(h + d, 5e6, 18e-6, 0.1) - fractional(h, 5e6, 18e-6, 0.1)) / d for h, d in ((0, 1e-10), (1, 1))]
    assert slope == pytest.approx([law.stiffness / 1e-3, law.ratio * law.stiffness / 1e-3], rel=1e-4)


@pytest.mark.parametrize("cutting", [Cutting(), Cutting(law="linear_edge")], ids=["fractional", "linear_edge"])
def test_no_chip_means_no_force(cutting):
    for h in (0.0, -1e-6, -1.0):
        assert cutting.force_per_depth(h) == (0.0, 0.0)


@given(thickness, thickness)
def test_a_thicker_chip_needs_more_force(a, b):
    for cutting in (Cutting(), Cutting(law="linear_edge")):
        low, high = (cutting.force_per_depth(h) for h in sorted((a, b)))
        assert low[0] <= high[0] and low[1] <= high[1]


@pytest.mark.parametrize("cutting", [Cutting(), Cutting(law="linear_edge")], ids=["fractional", "linear_edge"])
def test_arrays_give_what_numbers_give(cutting):
    h = np.linspace(-2e-5, 2e-4, 50)
    tangential, radial = cutting.force_per_depth(h)
    assert np.array_equal(tangential, [cutting.force_per_depth(x)[0] for x in h])
    assert np.array_equal(radial, [cutting.force_per_depth(x)[1] for x in h])


def test_linear_edge_law_jumps_in_with_the_edge_force():
    assert linear_edge(1e-12, 600.46e6, 17.9e3) == pytest.approx(17.9e3, rel=1e-6)
    assert linear_edge(1e-4, 600.46e6, 17.9e3) == pytest.approx(60.046e3 + 17.9e3)


def test_a_file_names_only_the_law_that_it_uses():
    cutting = build(Cutting, {"law": "linear_edge", "linear_edge": {"tangential_cutting_n_per_mm2": 700.0}})
    assert cutting.coefficients == pytest.approx([700e6, 17.9e3, 180.96e6, 20.42e3])
    assert build(Cutting, {}).coefficients == pytest.approx([5e6, 18e-6, 0.1, 0.3])
    assert isinstance(cutting.fractional, FractionalLaw) and isinstance(cutting.linear_edge, LinearEdgeLaw)


@pytest.mark.parametrize("tree", [{"law": "kienzle"}, {"fractional": {"ratio": 1.5}}, {"fractional": {"ratio": True}}])
def test_unusable_laws_are_refused(tree):
    with pytest.raises(ConfigError):
        build(Cutting, tree)
