"""The correction by dynamic programming, against the dense least squares of the same lifted model."""

from __future__ import annotations

import time

import numpy as np
import pytest
from arms import one_mode
from scipy.interpolate import CubicSpline

from kr270_milling.physics.compensation.lifted import KnotConditions, Lifted
from kr270_milling.physics.compensation.limiting import Limited
from kr270_milling.physics.compensation.response import ArmResponse, Segments, cubic_coefficients

KNOTS = np.cumsum([0, 50, 50, 30, 70, 50, 50, 20, 80, 50, 50, 50, 50]) * 1_000_000
SEGMENTS = Segments(KNOTS, 8)
M = len(SEGMENTS)
SMOOTH = 1e-3


def course(smooth=True, resting=(), held=()) -> KnotConditions:
    still, rest = np.zeros(M + 1, bool), np.zeros(M, bool)
    still[list(resting)], rest[list(held)] = True, True
    return KnotConditions(smooth, still, rest)


def deviation(seed=0) -> np.ndarray:
    t = SEGMENTS.middle_ns * 1e-9
    waves = np.stack([np.sin(20 * t + i) + 0.3 * np.cos(55 * t * (i + 1)) for i in range(3)], axis=-1)
    return 1e-5 * waves + 1e-6 * np.random.default_rng(seed).standard_normal(waves.shape)


def weights() -> np.ndarray:
    size = np.where(SEGMENTS.middle_ns < 150_000_000, 0.05**2, 1.0)
    return size[..., None, None] * np.diag([0.1, 1.0, 0.5])


def dense(arm, numbers_to_cubic, count, smooth):
    """The same least squares with every column of H simulated by itself; y only."""
    weight = weights()[..., 1, 1].ravel()
    typical = np.median(SEGMENTS.duration)
    columns, rough = [], []
    for number in np.eye(count):
        cubic = np.zeros((M, 4, 3))
        cubic[:, :, 1] = numbers_to_cubic(number)
        columns.append(arm.follow(SEGMENTS, cubic)[..., 1].ravel())
        rough.append(cubic[:, 3, 1] * typical**3 if smooth else np.diff(cubic[:, 1, 1]) * typical)
    h, r, d = np.array(columns).T, np.array(rough).T, deviation()[..., 1].ravel()
    rows = np.vstack([h * np.sqrt(weight)[:, None], np.sqrt(SMOOTH) * r])
    right = np.concatenate([-d * np.sqrt(weight), np.zeros(len(r))])
    best = np.linalg.lstsq(rows, right, rcond=None)[0]
    return numbers_to_cubic(best)


def spline_numbers(number):
    """m + 3 numbers of a C2 cubic spline: the values at the knots and the slopes at both ends."""
    spline = CubicSpline(KNOTS * 1e-9, number[:-2], bc_type=((1, number[-2]), (1, number[-1])))
    return cubic_coefficients(KNOTS, number[:-2, None], spline(KNOTS * 1e-9, 1)[:, None])[..., 0]


def line_numbers(number):
    return cubic_coefficients(KNOTS, number[:, None], None)[..., 0]


@pytest.mark.parametrize("smooth", [True, False])
def test_dynamic_programming_finds_the_dense_least_squares(smooth):
    arm = one_mode()
    found = Lifted(arm, SEGMENTS, course(smooth)).least_squares(deviation(), weights(), SMOOTH)
    expected = dense(arm, *((spline_numbers, M + 3) if smooth else (line_numbers, M + 1)), smooth)
    scale = np.abs(expected).max(axis=0)[: 4 if smooth else 2]
    difference = np.abs(found.cubic[:, :, 1] - expected)[:, : scale.size]
    assert np.all(difference.max(axis=0) < 1e-5 * scale)


@pytest.mark.parametrize("smooth", [True, False])
def test_what_is_left_is_what_the_response_to_the_correction_leaves(smooth):
    arm = one_mode()
    found = Lifted(arm, SEGMENTS, course(smooth)).least_squares(deviation(), weights(), SMOOTH)
    assert found.left == pytest.approx(deviation() + arm.follow(SEGMENTS, found.cubic), abs=1e-15)


def test_what_a_spline_of_the_knots_did_is_taken_away_whole():
    """d0 = -H c for a c of its own kind; without noise and smoothness nothing is left, however slowly the arm rings."""
    arm = one_mode(damping=0.005)
    cubic = np.zeros((M, 4, 3))
    cubic[:, :, 1] = spline_numbers(np.random.default_rng(1).normal(0, 1e-5, M + 3) * ([1] * (M + 1) + [10, 10]))
    found = Lifted(arm, SEGMENTS, course()).least_squares(-arm.follow(SEGMENTS, cubic), weights(), 1e-14)
    assert np.abs(found.left[..., 1]).max() < 1e-9 and np.abs(cubic[:, 0, 1]).max() > 1e-5


def test_the_correction_is_c2_between_stops_rests_in_them_and_is_held_while_the_path_rests():
    found = Lifted(one_mode(), SEGMENTS, course(True, (0, 5, 8, 9), (8,))).least_squares(deviation(), weights(), SMOOTH)
    t = SEGMENTS.duration[:, None]
    c, v, a, j = np.swapaxes(found.cubic, 0, 1)
    ends = c + v * t + a * t**2 / 2 + j * t**3 / 6, v + a * t + j * t**2 / 2, a + j * t
    for end, start, size in zip(ends, (c, v, a), (1e-5, 1e-3, 1e-1), strict=True):
        jump = np.abs(end[:-1] - start[1:]).max(axis=1)
        assert np.delete(jump, [4, 7, 8]).max() < 1e-8 * size
        assert size == 1e-1 or jump.max() < 1e-8 * size
    for knot in (5, 8, 9):
        assert np.abs(v[knot]).max() < 1e-12 and np.abs(ends[1][knot - 1]).max() < 1e-12
    assert not found.cubic[8, 1:].any() and np.abs(v[0]).max() == 0.0
    assert np.abs(ends[2][4] - a[5]).max() > 1e-3  # a bend of its own after a stop


def test_min_max_lowers_the_largest_deviation_and_its_peaks_are_alike():
    scored = SEGMENTS.middle_ns >= 150_000_000
    lifted = Lifted(one_mode(), SEGMENTS, course())
    plain, even = (
        np.abs(found.left[..., 1][scored])
        for found in (
            lifted.least_squares(deviation(), weights(), 1e-9),
            lifted.min_max(deviation(), weights(), 1e-9, scored),
        )
    )
    assert even.max() < 0.9 * plain.max() and even.std() / even.max() < plain.std() / plain.max() + 0.1


def test_a_long_path_costs_in_proportion_to_its_length():
    """Ten times the knots take about ten times as long; a dense lifted model would take a thousand times."""

    def cost(count: int) -> float:
        segments = Segments(np.arange(count + 1) * 12_000_000, 4)
        base = one_mode(damping=0.01)
        arm = ArmResponse(*(np.tile(getattr(base, name)[:1], (count,) + (1,) * (getattr(base, name).ndim - 1))
                            for name in ("frequency", "damping", "inward", "outward", "push", "carry")))  # fmt: skip
        still = KnotConditions(True, np.zeros(count + 1, bool), np.zeros(count, bool))
        d0 = 1e-5 * np.sin(segments.middle_ns * 3e-8)[..., None] * np.ones(3)
        weight = np.broadcast_to(np.eye(3), (count, 4, 3, 3))
        begun = time.process_time()
        left = Lifted(arm, segments, still).least_squares(d0, weight, 1e-6).left
        assert np.abs(left).max() < 1e-6
        return time.process_time() - begun

    cost(50)
    assert cost(3000) < 40 * cost(300)


def test_a_limited_correction_is_in_reach_at_a_lower_feed():
    """Size goes with the square of the feed, its change in a tick with the cube."""
    size = Limited("size", 1, 2, 1, 0.0, wanted=400e-6, missing=300e-6)
    change = Limited("change", 1, 2, 1, 0.0, wanted=80e-6, missing=70e-6)
    assert size.feed_share == pytest.approx(0.5) and change.feed_share == pytest.approx(0.5)
