"""S-shaped ramps: closed forms, reach, and the bounds on acceleration and jerk."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kr270_milling.path.timing import Ramps, peak_speeds, ramp_time, reachable, vertex_speeds

A, J = 2.0, 20.0
speeds, lengths = st.floats(0, 1), st.floats(1e-6, 1)


def way(first, last):
    """Distance of a ramp: mean speed times duration."""
    return (first + last) / 2 * ramp_time(last - first, A, J)


def test_a_small_change_of_speed_takes_two_ramps_of_acceleration():
    assert ramp_time(0.05, A, J) == pytest.approx(2 * np.sqrt(0.05 / J))


def test_a_large_change_of_speed_holds_the_acceleration():
    assert ramp_time(-1.0, A, J) == pytest.approx(1.0 / A + A / J)


def test_both_kinds_of_ramp_agree_where_the_acceleration_just_reaches_its_limit():
    assert ramp_time(A**2 / J * (1 + 1e-12), A, J) == pytest.approx(float(ramp_time(A**2 / J, A, J)))


@given(speeds, lengths)
def test_the_reachable_speed_uses_up_the_whole_length(speed, length):
    reached = reachable(speed, length, A, J)
    assert way(speed, max(speed, reached * (1 - 1e-12))) <= length <= way(speed, reached * (1 + 1e-12) + 1e-15)


@given(st.lists(st.tuples(lengths, speeds), min_size=1, max_size=20))
def test_speeds_at_the_vertices_are_below_their_caps_and_within_reach_of_each_other(segments):
    length = np.array([s[0] for s in segments])
    cap = np.array([0.0, *(s[1] for s in segments[:-1]), 0.0])
    speed = vertex_speeds(cap, length, A, J)
    assert np.all(speed <= cap) and np.all(speed >= 0)
    assert np.all(way(speed[:-1], speed[1:]) <= length + 1e-9)  # an ulp of speed
    raised = cap - speed > 1e-6  # none of them could be higher
    for i in np.flatnonzero(raised):
        higher = speed.copy()
        higher[i] += 1e-6
        assert np.any(way(higher[:-1], higher[1:]) > length * (1 - 1e-6))


def test_the_peak_of_a_short_run_from_rest_to_rest_has_a_closed_form():
    length = np.array([1e-5, 1e-4, 1e-3])
    peak = peak_speeds(np.zeros(3), np.zeros(3), np.ones(3), length, A, J)
    np.testing.assert_allclose(peak, (length / 2) ** (2 / 3) * J ** (1 / 3), rtol=1e-12)  # length = 2 v sqrt(v / j)


def test_the_peak_is_the_cap_where_there_is_room():
    assert peak_speeds(np.zeros(1), np.zeros(1), np.array([0.1]), np.array([1.0]), A, J) == 0.1


def chain() -> Ramps:
    first, last = np.array([0.0, 0.5, 0.5, 0.45, 0.0]), np.array([0.5, 0.5, 0.45, 0.0, 0.0])
    duration = ramp_time(last - first, A, J) + np.array([0, 0.3, 0, 0.2, 0.1])  # the fourth is stretched
    return Ramps.make(duration, first, last, A, J)


def test_distance_speed_and_acceleration_are_derivatives_of_each_other():
    ramps = chain()
    time, step = np.linspace(0, ramps.start[-1], 40001, retstep=True)
    distance, speed, acceleration = ramps.sample(time)
    assert np.abs(np.gradient(distance, step) - speed)[1:-1].max() < step * A
    assert np.abs(np.gradient(speed, step) - acceleration)[1:-1].max() < step * J


def test_acceleration_and_jerk_reach_their_limits_and_never_exceed_them():
    ramps = chain()
    time, step = np.linspace(0, ramps.start[-1], 40001, retstep=True)
    acceleration = ramps.sample(time)[2]
    assert np.abs(acceleration).max() == pytest.approx(A, rel=1e-9)
    assert np.abs(np.diff(acceleration)).max() / step == pytest.approx(J, rel=1e-6)


def test_a_chain_covers_the_mean_speed_times_the_duration_of_each_ramp():
    ramps = chain()
    total = np.sum((ramps.first + ramps.last) / 2 * ramps.duration)
    assert ramps.sample(np.array([ramps.start[-1] + 9.0]))[0] == pytest.approx(total)
