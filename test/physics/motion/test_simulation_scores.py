"""Scores of Table 2 and the ringing found in a pass."""

from __future__ import annotations

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st

from kr270_milling.physics.motion.scores import path_deviation, ringing_frequency, score

TIME = np.arange(0, 1.05, 5e-4)
X, Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def ringing(frequency, damping, amplitude=5e-6, phase=0.3, mean=60e-6):
    """Free vibration of the undamped frequency [Hz] about a mean."""
    w = 2 * np.pi * frequency
    return mean + amplitude * np.exp(-damping * w * TIME) * np.cos(w * np.sqrt(1 - damping**2) * TIME + phase)


def along(direction, count=5):
    return np.tile(direction, (count, 1))


def test_the_deviation_is_positive_to_the_left_of_the_feed():
    zero = np.zeros((5, 3))
    np.testing.assert_array_equal(path_deviation(along(Y * 1e-6), zero, along(X)), 1e-6)
    np.testing.assert_array_equal(path_deviation(along(Y * 1e-6), zero, along(-X)), -1e-6)
    np.testing.assert_array_equal(path_deviation(along(X * 1e-6), zero, along(Y)), -1e-6)


def test_the_deviation_knows_neither_the_feed_direction_nor_the_height_nor_the_speed():
    offset = along([3.0, 4.0, 5.0])
    expected = (-3.0 + 4.0) / np.sqrt(2)
    for speed in (1e-3, 1.0, 70.0):
        np.testing.assert_allclose(path_deviation(offset, 0 * offset, along(speed * (X + Y))), expected, rtol=1e-15)


def test_a_tool_that_rests_has_no_deviation():
    assert not path_deviation(along(Y), along(0 * Y), along(0 * X)).any()


def test_the_static_deviation_is_the_mean_over_the_last_quarter():
    """Samples 9, 10 and 11 of 12."""
    y = np.array([100.0, 90, 80, 70, 60, 50, 40, 30, 20, 4, 3, 2]) * 1e-6
    found = score(np.arange(12.0), np.outer(y, Y), np.zeros((12, 3)), along(X, 12), 0.0, 6.7, y)
    assert found.static_deviation == pytest.approx(3e-6, rel=1e-12) and found.low_frequency == 6.7


def test_the_largest_deviation_counts_from_full_engagement_on_and_on_both_sides():
    y = np.array([9.0, 9, -5, 1, 4, 1, 1, 1]) * 1e-6
    for engaged, largest in ((0.0, 9e-6), (1.0, 9e-6), (1.5, 5e-6), (2.0, 5e-6), (2.5, 4e-6), (99.0, 1e-6)):
        found = score(np.arange(8.0), np.outer(y, Y), np.zeros((8, 3)), along(X, 8), engaged, 6.7, y)
        assert found.max_deviation == pytest.approx(largest, rel=1e-12)


def test_a_deviation_along_the_feed_is_none():
    run = np.outer(np.arange(8.0), X)
    found = score(np.arange(8.0), run + 5e-6 * X, run, along(X, 8), 0.0, 6.7, np.zeros(8))
    assert found.max_deviation == found.static_deviation == 0.0 and np.isnan(found.ringing_frequency)


@settings(max_examples=budget(60), deadline=None)
@given(st.floats(3.0, 40.0), st.floats(0.01, 0.3), st.floats(0.0, 6.28), st.floats(-1e-4, 1e-4))
def test_the_ringing_of_a_damped_vibration_is_found(frequency, damping, phase, mean):
    found = ringing_frequency(TIME, ringing(frequency, damping, 5e-6, phase, mean))
    assert found == (pytest.approx(frequency, rel=2e-3), pytest.approx(damping, abs=2e-3))


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_a_tenth_and_the_hum_of_the_teeth_hardly_move_it(seed):
    noise = np.random.default_rng(seed).normal(0.0, 0.5e-6, TIME.size)
    hum = 0.5e-6 * np.sin(2 * np.pi * 533.3 * TIME)
    frequency, damping = ringing_frequency(TIME, ringing(6.69, 0.18) + noise + hum)
    assert frequency == pytest.approx(6.69, rel=0.03) and damping == pytest.approx(0.18, abs=0.03)


def test_the_start_of_the_clock_does_not_matter():
    shifted = ringing_frequency(TIME + 12.5, ringing(6.69, 0.05))
    np.testing.assert_allclose(shifted, ringing_frequency(TIME, ringing(6.69, 0.05)), rtol=1e-6)


@pytest.mark.parametrize(
    "displacement", [np.zeros(TIME.size), np.full(TIME.size, 3e-3), ringing(6.7, 0.1, amplitude=5e-10), np.ones(15)],
)  # fmt: skip
def test_where_nothing_rings_no_frequency_is_made_up(displacement):
    assert np.isnan(ringing_frequency(TIME[: displacement.size], displacement)).all()


def test_a_path_without_one_feed_direction_has_no_static_deviation_and_does_not_ring():
    course = np.column_stack([np.cos(TIME), np.sin(TIME), 0 * TIME])
    feed = np.column_stack([-np.sin(TIME), np.cos(TIME), 0 * TIME])
    found = score(TIME, course * 1.001, course, feed, 0.0, 6.7, course[:, 1], straight=False)
    assert np.isnan([found.static_deviation, found.ringing_frequency, found.ringing_damping]).all()
    assert found.max_deviation == pytest.approx(1e-3, rel=1e-9)  # the circle is 1 mm too large all the way
