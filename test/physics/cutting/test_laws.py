"""Force laws as functions of the chip thickness."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cuttings import ALUMINIUM, PAPER_LAW
from hypothesis import given
from hypothesis import strategies as st

from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.record import build, find_file, flatten
from kr270_milling.cell.cell import read_cell
from kr270_milling.physics.cutting import AL7075_T6, KLIMCHIK2014, Cutting, fractional, linear_edge

thickness = st.floats(0.0, 1e-3)


def test_fractional_law_has_the_stiffness_k_0_at_first_and_r_k_0_at_last():
    law = PAPER_LAW.fractional
    slope = [(fractional(h + d, 5e6, 18e-6, 0.1) - fractional(h, 5e6, 18e-6, 0.1)) / d for h, d in ((0, 1e-10), (1, 1))]
    assert slope == pytest.approx([law.stiffness / 1e-3, law.ratio * law.stiffness / 1e-3], rel=1e-4)


@pytest.mark.parametrize("cutting", [PAPER_LAW, ALUMINIUM], ids=["fractional", "linear_edge"])
def test_no_chip_means_no_force(cutting):
    for h in (0.0, -1e-6, -1.0):
        assert cutting.force_per_depth(h) == (0.0, 0.0)


@given(thickness, thickness)
def test_a_thicker_chip_needs_more_force(a, b):
    for cutting in (PAPER_LAW, ALUMINIUM):
        low, high = (cutting.force_per_depth(h) for h in sorted((a, b)))
        assert low[0] <= high[0] and low[1] <= high[1]


@pytest.mark.parametrize("cutting", [PAPER_LAW, ALUMINIUM], ids=["fractional", "linear_edge"])
def test_arrays_give_what_numbers_give(cutting):
    h = np.linspace(-2e-5, 2e-4, 50)
    tangential, radial = cutting.force_per_depth(h)
    assert np.array_equal(tangential, [cutting.force_per_depth(x)[0] for x in h])
    assert np.array_equal(radial, [cutting.force_per_depth(x)[1] for x in h])


def test_linear_edge_law_jumps_in_with_the_edge_force():
    assert linear_edge(1e-12, 600.46e6, 17.9e3) == pytest.approx(17.9e3, rel=1e-6)
    assert linear_edge(1e-4, 600.46e6, 17.9e3) == pytest.approx(60.046e3 + 17.9e3)


LINEAR_EDGE = {
    "tangential_cutting_n_per_mm2": 700.0,
    "tangential_edge_n_per_mm": 17.9,
    "radial_cutting_n_per_mm2": 180.96,
    "radial_edge_n_per_mm": 20.42,
}
FRACTIONAL = {"stiffness_n_per_m": 5e6, "specific_chip_thickness_um": 18.0, "ratio": 0.1, "radial_ratio": 0.3}


def test_a_file_names_only_the_law_that_it_uses():
    cutting = build(Cutting, {"law": "linear_edge", "linear_edge": LINEAR_EDGE})
    assert cutting.coefficients == pytest.approx([700e6, 17.9e3, 180.96e6, 20.42e3, 0.0, 0.0])
    assert build(Cutting, {"fractional": FRACTIONAL}).coefficients == pytest.approx([5e6, 18e-6, 0.1, 0.3, 0.0])
    assert set(flatten(cutting)) == {
        "law",
        "moments",
        "chip_angle",
        "detail",
        "end_ratio",
        "fractional.axial_ratio",
    } | {f"linear_edge.{key}" for key in (*LINEAR_EDGE, "axial_cutting_n_per_mm2", "axial_edge_n_per_mm")}


@pytest.mark.parametrize("law, coefficients", [("linear_edge", LINEAR_EDGE), ("fractional", FRACTIONAL)])
def test_a_law_without_one_of_its_coefficients_is_refused_with_its_key(law, coefficients):
    for missing in coefficients:
        given = {key: value for key, value in coefficients.items() if key != missing}
        with pytest.raises(ConfigError, match=f"{law}.{missing}: has no value, it must be given where cutting.law is"):
            build(Cutting, {"law": law, law: given})
    with pytest.raises(ConfigError, match="has no value"):
        build(Cutting, {"law": law})
    with pytest.raises(ParameterError, match="must be given"):
        Cutting(law)


def test_not_a_number_is_not_a_missing_coefficient():
    with pytest.raises(ConfigError, match="nan is not usable"):
        build(Cutting, {"fractional": {**FRACTIONAL, "ratio": math.nan}})
    with pytest.raises(ConfigError, match="nan is not usable"):
        build(Cutting, {"fractional": FRACTIONAL, "linear_edge": {"radial_edge_n_per_mm": math.nan}})


def test_a_node_is_given_no_coefficient_that_the_cell_does_not_have():
    keys = flatten(read_cell(find_file("paper.yaml")))
    assert "cutting.fractional.ratio" in keys and "cutting.linear_edge.radial_edge_n_per_mm" not in keys


def test_the_axial_force_has_coefficients_of_its_own():
    steel = Cutting("linear_edge", linear_edge=AL7075_T6.replace(axial_cutting=220e6, axial_edge=1e3))
    assert steel.axial and not ALUMINIUM.axial and not PAPER_LAW.axial
    assert steel.axial_per_depth(1e-4) == pytest.approx(220e6 * 1e-4 + 1e3) and steel.axial_per_depth(0.0) == 0.0
    bent = Cutting(fractional=KLIMCHIK2014.replace(axial_ratio=0.4))
    assert bent.axial_per_depth(1e-4) == pytest.approx(0.4 * bent.force_per_depth(1e-4)[0])


@pytest.mark.parametrize("tree", [{"law": "kienzle"}, {"fractional": {"ratio": 1.5}}, {"fractional": {"ratio": True}}])
def test_unusable_laws_are_refused(tree):
    with pytest.raises(ConfigError):
        build(Cutting, tree)
