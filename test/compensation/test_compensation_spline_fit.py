"""The spline nearest to the error of a pass, against dense least squares and a linear programme."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pytest
from scipy.interpolate import BSpline, CubicSpline
from scipy.optimize import linprog

from kr270_milling.compensation.spline_fit import knot_rates, spline_fit

SAMPLE_NS, STEP_NS, ENGAGED_NS = 500_000, 50_000_000, 150_000_000
KNOTS = np.arange(0, 1_200_000_001, STEP_NS)


def basis_of(knots_ns, time_ns):
    """B-splines of the C2 cubic splines with not-a-knot ends on the knots, dense (n, k)."""
    knots = knots_ns * 1e-9
    full = np.r_[[knots[0]] * 4, knots[2:-2], [knots[-1]] * 4]
    return BSpline.design_matrix(time_ns * 1e-9, full, 3).toarray(), full


def problem(seed):
    stamps = np.arange(0, KNOTS[-1] + 1, 2 * SAMPLE_NS)
    t = stamps * 1e-9
    random = np.random.default_rng(seed)
    error = sum(random.normal(0, 20e-6) * np.sin(w * t + random.uniform(0, 6)) for w in (9.0, 42.0, 70.0, 150.0))
    return KNOTS, stamps, error


@pytest.mark.parametrize("seed", range(4))
def test_min_max_comes_within_some_percent_of_the_linear_programme(seed):
    knots, stamps, error = problem(seed)
    basis, full = basis_of(knots, stamps)
    scored = stamps >= ENGAGED_NS
    b, e, k = basis[scored], error[scored] * 1e6, basis.shape[1]
    bounds = np.block([[b, -np.ones((len(b), 1))], [-b, -np.ones((len(b), 1))]])  # |e - B c| <= t
    best = linprog(np.r_[np.zeros(k), 1.0], bounds, np.r_[e, -e], bounds=[(None, None)] * k + [(0, None)])
    values = spline_fit(knots, stamps, error[:, None], scored, "min_max")[:, 0]
    fitted = CubicSpline(knots * 1e-9, values, bc_type="not-a-knot")(stamps * 1e-9)
    largest = np.abs(error - fitted)[scored].max() * 1e6
    assert best.status == 0 and best.fun * 0.999 <= largest <= 1.05 * best.fun


@pytest.mark.parametrize("seed", range(2))
def test_least_squares_is_that_of_numpy(seed):
    knots, stamps, error = problem(seed)
    basis, full = basis_of(knots, stamps)
    coefficients, *_ = np.linalg.lstsq(basis, error, rcond=None)
    expected = BSpline(full, coefficients, 3)(knots * 1e-9)
    found = spline_fit(knots, stamps, np.column_stack([error, 2 * error]), stamps >= 0, "least_squares")
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-6 * np.abs(error).max())
    np.testing.assert_allclose(found[:, 1], 2 * found[:, 0], rtol=1e-9)


def test_the_unscored_part_does_not_pull_at_the_fit():
    knots, stamps, error = problem(0)
    wild = np.where(stamps < ENGAGED_NS, 1e-3, error)
    late = knots > 2 * ENGAGED_NS
    calm, pulled = (
        spline_fit(knots, stamps, e[:, None], stamps >= ENGAGED_NS, "least_squares")[late, 0] for e in (error, wild)
    )
    np.testing.assert_allclose(pulled, calm, atol=1e-8)


@pytest.mark.parametrize("criterion", ["least_squares", "min_max"])
def test_time_and_memory_of_the_fit_are_linear_in_the_length_of_the_pass(criterion):
    """1e5 samples, 1000 knots; a dense matrix of them would take 800 MB."""
    peaks, start = [], time.perf_counter()
    for duration in (25_000_000_000, 50_000_000_000):
        knots, stamps = np.arange(0, duration + 1, STEP_NS), np.arange(0, duration + 1, SAMPLE_NS)
        tracemalloc.start()
        spline_fit(knots, stamps, np.sin(stamps * 3e-8)[:, None] * 1e-5, stamps >= 0, criterion)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 2.2 * peaks[0] and peaks[1] < 60e6
    assert time.perf_counter() - start < 30.0


@pytest.mark.parametrize("criterion", ["least_squares", "min_max"])
def test_a_spline_on_the_knots_is_found_again(criterion):
    values = np.random.default_rng(2).normal(0, 50e-6, (KNOTS.size, 3))
    stamps = np.arange(0, KNOTS[-1] + 1, SAMPLE_NS)
    error = CubicSpline(KNOTS * 1e-9, values, bc_type="not-a-knot")(stamps * 1e-9)
    np.testing.assert_allclose(spline_fit(KNOTS, stamps, error, stamps >= 0, criterion), values, atol=1e-11)


@pytest.mark.parametrize("resting", [[0], [24], [0, 24], [7], [0, 7, 8, 24], list(range(25))])
def test_the_fit_stands_still_where_it_must_and_a_spline_that_does_is_found_again(resting):
    still = np.isin(np.arange(KNOTS.size), resting)
    values, t = np.random.default_rng(2).normal(0, 50e-6, (KNOTS.size, 3)), KNOTS * 1e-9
    rates = knot_rates(t, values, still, "not-a-knot")
    assert not rates[still].any()
    stamps = np.arange(0, KNOTS[-1] + 1, SAMPLE_NS)
    k = np.clip(np.searchsorted(KNOTS, stamps, side="right") - 1, 0, KNOTS.size - 2)
    u, h = ((stamps - KNOTS[k]) / STEP_NS)[:, None], STEP_NS * 1e-9
    move, first, last = values[k + 1] - values[k], h * rates[k], h * rates[k + 1]  # the cubic of its end slopes
    error = values[k] + u * first + u**2 * (3 * move - 2 * first - last) + u**3 * (first + last - 2 * move)
    found = spline_fit(KNOTS, stamps, error, stamps >= 0, "least_squares", still)
    if still[[0, -1]].all():  # else the end conditions differ: natural here, not-a-knot there
        np.testing.assert_allclose(found, values, atol=1e-11)
    assert np.isfinite(found).all() and np.abs(found - values).max() < 100e-6


def test_without_a_rest_the_slopes_are_scipys_and_with_one_the_spline_is_c2_everywhere_else():
    values, t = np.random.default_rng(3).normal(0, 1, (KNOTS.size, 3)), KNOTS * 1e-9
    for ends in ("natural", "not-a-knot"):
        np.testing.assert_array_equal(knot_rates(t, values, None, ends), CubicSpline(t, values, bc_type=ends)(t, 1))
    still = np.arange(KNOTS.size) == 9
    rates, h = knot_rates(t, values, still), STEP_NS * 1e-9
    move = np.diff(values, axis=0)
    left = (-6 * move + 2 * h * rates[:-1] + 4 * h * rates[1:]) / h**2  # second derivative at each segment's end
    right = (6 * move - 4 * h * rates[:-1] - 2 * h * rates[1:]) / h**2  # and at its start
    same = np.isclose(left[:-1], right[1:], rtol=1e-8, atol=1e-6).all(axis=1)
    assert np.flatnonzero(~same).tolist() == [8]  # the knot that rests
    np.testing.assert_allclose([right[0], left[-1]], 0.0, atol=1e-6)  # natural ends
