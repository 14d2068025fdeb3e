"""Force coefficients from mean forces: closed forms of slots and the compiled cut as references, honest intervals."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from known_cuts import FEEDS, TOOL, TRUE, cuts, measured

from kr270_milling.base.errors import InputError
from kr270_milling.physics.cutting import Cut, Cutting, FractionalLaw, LinearEdgeLaw, Stock
from kr270_milling.physics.cutting.materials import find_material, materials
from kr270_milling.studies.identification.cuts import Sensor, read_cuts
from kr270_milling.studies.identification.forces import (
    OneFeedError,
    fit_forces,
    law_sections,
)


def test_slot_means_are_the_closed_forms():
    """[Altintas2012]: F_x = -N a (K_rc f / 4 + K_re / pi), F_y = N a (K_tc f / 4 + K_te / pi), F_z = N a (K_ac f / pi
    + K_ae / 2), toward the part as ``cutting`` has it."""
    k_tc, k_te, k_rc, k_re, k_ac, k_ae = TRUE
    f, na = np.array(FEEDS), 4 * 1e-3
    f_x, f_y = -k_rc * f / 4 - k_re / np.pi, k_tc * f / 4 + k_te / np.pi
    f_z = k_ac * f / np.pi + k_ae / 2
    assert LinearEdgeLaw(*map(float, TRUE)).mean_forces(cuts()) == pytest.approx(
        na * np.stack([f_x, f_y, -f_z], -1), rel=1e-12
    )


@pytest.mark.parametrize(("mode", "width"), [("up", 0.01), ("down", 0.01), ("up", 0.005), ("down", 0.015)])
@pytest.mark.parametrize("rotation", ["clockwise", "counterclockwise"])
def test_means_of_partial_immersion_are_those_of_the_cut_itself(mode, width, rotation):
    """The compiled sweep over a grid, a revolution after a run-in; 1 % as its own checks in the book."""
    tool = TOOL.replace(rotation=rotation)
    law = LinearEdgeLaw(*(float(v) for v in TRUE))
    # with clockwise teeth the chip of up-milling begins at +y: the part lies on that side
    side = (1.0 if mode == "up" else -1.0) * -tool.sense
    low, high = sorted([side * (0.01 - width), side * 0.012])
    stock = Stock(min=np.array([0.0, low, -5e-3]), max=np.array([0.03, high, 0.0]), grid_step=10e-6)
    cut = Cut(tool, Cutting("linear_edge", linear_edge=law), stock, math.radians(1.0))
    step = 4 * 0.1e-3
    at = np.array([0.012, 0.0, -1e-3])
    cut.sweep([-0.011, 0.0, -1e-3], at, 0, 360 * 60)
    for turn in range(60, 64):
        wrench = cut.sweep(at, at + [step, 0, 0], 360 * turn, 360)
        at = at + [step, 0.0, 0.0]
    expected = law.mean_forces(cuts(mode, width, (0.1e-3,), tool))[0]
    assert wrench[:3] == pytest.approx(expected, abs=0.015 * np.abs(expected).max())


@pytest.mark.parametrize(("mode", "width"), [("slot", 0.02), ("up", 0.01), ("down", 0.004)])
def test_coefficients_are_exact_without_noise(mode, width):
    result = fit_forces("linear_edge", measured(cuts(mode, width)))
    assert result.values == pytest.approx(TRUE, rel=1e-9)


def test_intervals_cover_the_truth():
    """300 campaigns of six coefficients, unknown noise: Student's interval; 0.95 +- 3 sqrt(0.05 0.95 / 1800)."""
    rng = np.random.default_rng(5)
    hits = []
    for _ in range(300):
        result = fit_forces("linear_edge", measured(cuts("up", 0.012), rng=rng, sigma=2.0))
        hits.append(np.abs(result.values - TRUE) <= result.half_widths)
    assert 0.93 <= np.mean(hits) <= 0.97


def test_without_axial_forces_the_axial_pair_is_not_identified():
    some = measured(cuts())
    some.force[:, 2] = np.nan
    result = fit_forces("linear_edge", some)
    assert np.isnan(result.values[4:]).all() and result.values[:4] == pytest.approx(TRUE[:4])


def test_an_axial_force_into_the_holder_has_positive_coefficients_too_and_is_reported():
    some = measured(cuts())
    some.force[:, 2] *= -1.0
    result = fit_forces("linear_edge", some)
    assert result.values == pytest.approx(TRUE) and result.axial == 1.0
    sections = law_sections("linear_edge", result.values, result.half_widths, result.axial)
    assert sections["cutting"]["linear_edge"]["axial_cutting_n_per_mm2"][0] == pytest.approx(-222.0)
    spreads = sections["uncertainty"]["force_coefficients"][0]  # the verdict scatters the axial ones by what is known
    assert spreads == pytest.approx(np.clip(result.half_widths / 1.96 / result.values, 1e-4, 1.0))


def test_one_feed_is_refused():
    with pytest.raises(OneFeedError, match="at least 2 feeds"):
        fit_forces("linear_edge", measured(cuts(feeds=(0.1e-3,) * 5)))
    with pytest.raises(OneFeedError, match="2 feeds per tooth"):
        fit_forces("fractional", measured(cuts(feeds=(0.1e-3, 0.2e-3))))


def test_fractional_means_are_those_of_the_facts():
    """Rigid slot, f = 0.125 mm, 1 mm deep: -44.39 and 147.98 N; half immersion by quadrature elsewhere [derived]."""
    paper = (5e6, 18e-6, 0.1, 0.3)
    for mode, width, expected in (
        ("slot", 0.02, (-44.39, 147.98)), ("up", 0.01, (-78.268, 57.168)), ("down", 0.01, (33.874, 90.811)),
    ):  # fmt: skip
        got = FractionalLaw(*paper).mean_forces(cuts(mode, width, (0.125e-3,)))[0, :2]
        assert got == pytest.approx(expected, abs=5e-3)


def test_the_fractional_law_is_identified_and_differs_from_the_other_law():
    paper = np.array([5e6, 18e-6, 0.1, 0.3, 0.2])
    some = cuts(feeds=np.linspace(0.01e-3, 0.25e-3, 12))
    rng = np.random.default_rng(1)
    force = FractionalLaw(*paper).mean_forces(some) + 0.3 * rng.normal(size=(12, 3))
    some = dataclasses.replace(some, force=force)
    result = fit_forces("fractional", some)
    assert np.all(np.abs(result.values - paper) < 1.5 * result.half_widths)
    assert np.all(result.half_widths < 0.2 * paper)
    assert result.lateral_rms < 0.5 * fit_forces("linear_edge", some).lateral_rms


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ("0.1,1,20,sideways,1,2,3", "one of slot, up, down"),
        ("0.1,1,25,up,1,2,3", "at most the tool's diameter"),
        ("0.1,1,10,slot,1,2,3", "the tool's diameter in a slot"),
        ("0.1,-1,10,up,1,2,3", "must be above 0"),
        ("0.1,1,10,up,,2,3", "neither fx_n and fy_n nor a recording"),
        ("0.1,1,10,up,1,x,3", "is no number"),
        ("0.1,1,10,up,1,2", "6 values where the header has 7"),
    ],
)
def test_unusable_rows_are_refused_with_their_line(tmp_path, row, text):
    file = tmp_path / "cuts.csv"
    file.write_text(f"feed_per_tooth_mm,depth_mm,width_mm,mode,fx_n,fy_n,fz_n\n0.1,1,10,up,1,2,3\n{row}\n")
    with pytest.raises(InputError, match="line 3") as refused:
        read_cuts(file, TOOL, Sensor())
    assert text in str(refused.value)


# --- The shipped table of published force coefficients ---


def test_every_material_has_a_source_and_the_coefficients_of_the_milling_plane():
    rows = materials()
    assert len(rows) >= 6
    for row in rows:
        assert "10.1186/s10033-021-00536-9" in row.source and np.isfinite(row.values[:4]).all()
    assert find_material("al7075-T6")[0].values[0] == pytest.approx(600.46e6)
    with pytest.raises(InputError, match="has no material"):
        find_material("wood")
