"""Revision of the reference at the controller step: exact cases, orders of convergence, and a linear programme."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from kr270_milling.path.controller_motion import spline_slopes
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.limiting import UNBOUNDED, Bounds
from kr270_milling.physics.compensation.revision import (
    PassRecord,
    RevisionError,
    corrected,
    sampled_correction,
)
from kr270_milling.physics.compensation.settings import CompensationSettings

SAMPLE_NS = 500_000
ENGAGED_NS = 150_000_000


def line(step_ns=50_000_000, duration_ns=1_200_000_000):
    """A straight cut with knots at the controller step."""
    knots = np.arange(0, duration_ns + 1, step_ns)
    return Trajectory(knots, np.outer(knots * 1e-9, [0.0667, 0.0, 0.0]), (1.0, 0.0, 0.0, 0.0))


def ran(reference, displacement, scored_from_ns=0):
    """The pass of an arm that gives way by displacement(t) (n, 3) whatever the reference does."""
    stamps = np.arange(0, reference.duration_ns + 1, SAMPLE_NS)
    return PassRecord(stamps, reference.sample(stamps) + displacement(stamps * 1e-9), scored_from_ns)


def sampled(smooth, target, reference, record, bounds=UNBOUNDED):
    """The reference after a pass along ``reference`` by the sampled displacement, and where it was limited."""
    return corrected(target, sampled_correction(target, reference, record), smooth, bounds)


def revised(method, target, first, criterion="min_max", max_correction=50e-3, max_change=50e-3):
    """The reference after the first pass, and where it was limited."""
    limits = {"max_correction": max_correction, "max_change_per_tick": max_change}
    by = Compensator(CompensationSettings(method, criterion=criterion, **limits), target)
    return by.revise(first), by.limited


def left(target, reference, displacement, scored_from_ns=0):
    """Largest error [m] across the feed from scored_from on when the reference is run."""
    record = ran(reference, displacement)
    error = record.position - target.sample(record.time_ns)
    return np.abs(error[record.time_ns >= scored_from_ns, 1]).max()


def knot_spline(target, ends):
    """A random C2 cubic spline on the target's knots as a displacement of some 50 um, in all three axes."""
    values = np.random.default_rng(4).normal(0, 50e-6, (len(target), 3))
    return CubicSpline(target.time, values, bc_type=ends)


def ringing(t, frequency=6.69, damping=0.18):
    """What the paper's arm does when it is loaded in 0.15 s."""
    w = 2 * np.pi * frequency
    load = np.clip(t / 0.15, 0, 1)
    y = 58e-6 * load - 12e-6 * np.exp(-damping * w * t) * np.sin(w * t) * (t > 0)
    return np.column_stack([-0.2 * y, y, 0.1 * y])


# --- exact cases ---


def test_linear_takes_away_what_is_linear_between_the_knots():
    target = line()
    values = np.random.default_rng(1).normal(0, 50e-6, (len(target), 3))

    def displacement(t):
        return np.column_stack([np.interp(t, target.time, v) for v in values.T])

    reference, cut_off = sampled(False, target, target, ran(target, displacement))
    assert left(target, reference, displacement) < 1e-16 and cut_off == () and reference.velocity is None


def test_spline_takes_away_a_spline_that_starts_and_ends_without_slope():
    target = line()
    displacement = knot_spline(target, "clamped")
    reference, _ = sampled(True, target, target, ran(target, displacement))
    assert left(target, reference, displacement) < 1e-16


@pytest.mark.parametrize("criterion", ["min_max", "least_squares"])
def test_learned_takes_away_a_spline_that_starts_and_ends_without_slope(criterion):
    target = line()
    displacement = knot_spline(target, "clamped")
    reference, _ = revised("learned", target, ran(target, displacement), criterion)
    assert left(target, reference, displacement) < 1e-3 * 50e-6  # it sees the means of parts of 3.1 ms, not each sample


@pytest.mark.parametrize("smooth", [False, True])
def test_a_second_pass_leads_to_the_same_reference(smooth):
    """The displacement is taken against the reference that was run, so it does not add up."""
    target = line()
    first, _ = sampled(smooth, target, target, ran(target, ringing))
    second, _ = sampled(smooth, target, first, ran(first, ringing))
    np.testing.assert_allclose(second.position, first.position, atol=1e-16)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_pass_without_error_is_left_as_it_is(smooth):
    target = line()
    reference, _ = sampled(smooth, target, target, ran(target, lambda t: np.zeros((t.size, 3))))
    stamps = np.arange(0, target.duration_ns, 333_333)
    np.testing.assert_allclose(reference.sample(stamps), target.sample(stamps), atol=1e-16)


@pytest.mark.parametrize("smooth", [False, True])
def test_times_orientation_and_frame_stay(smooth):
    target = line()
    reference, _ = sampled(smooth, target, target, ran(target, ringing))
    np.testing.assert_array_equal(reference.time_ns, target.time_ns)
    np.testing.assert_array_equal(reference.quaternion, target.quaternion)
    assert reference.frame == target.frame


def test_a_spline_revision_has_no_jump_in_acceleration():
    target = line()
    reference, _ = sampled(True, target, target, ran(target, ringing))
    again = CubicSpline(reference.time, reference.position - target.position, bc_type="clamped")
    expected = again(reference.time, 1) + target.sample_velocity(target.time_ns)
    np.testing.assert_allclose(reference.velocity, expected, atol=1e-12)


# --- orders of convergence ---


@pytest.mark.parametrize(("method", "order"), [("linear", 2.0), ("spline", 4.0), ("learned", 4.0)])
def test_the_error_left_falls_with_the_controller_step_by_the_order_of_the_interpolation(method, order):
    """Of a smooth displacement without slope at the ends, as the motion of the program needs it."""

    def displacement(t):
        waves = np.cos(np.pi * t / 1.2) - 0.5 * np.cos(2 * np.pi * t / 1.2) + 0.3 * np.cos(5 * np.pi * t / 1.2)
        return 50e-6 * np.outer(waves, [1.0, 1.0, 1.0])

    finest = 50_000_000 if method == "learned" else 25_000_000  # of means, so some nanometres stay at any step
    steps = finest * np.array([4, 2, 1])
    errors = []
    for step in steps:
        target = line(int(step))
        reference, _ = revised(method, target, ran(target, displacement), "least_squares")
        errors.append(left(target, reference, displacement))
    found = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order - 0.35 < found < order + (0.35 if method != "learned" else 1.2)  # the best one gains at the ends too


@pytest.mark.parametrize("frequency", [3.0, 6.69, 9.0])
@pytest.mark.parametrize("damping", [0.03, 0.18])
def test_learned_is_better_than_spline_in_what_it_minimises(frequency, damping):
    """The weighted sum of squares: 1 where it is scored, 0.05 before."""
    target = line()

    def displacement(t):
        return ringing(t, frequency, damping)

    first = ran(target, displacement, ENGAGED_NS)
    weight = np.where(first.time_ns >= ENGAGED_NS, 1.0, 0.05**2)
    scores = {}
    for method in ("linear", "spline", "learned"):
        record = ran(revised(method, target, first, "least_squares")[0], displacement)
        scores[method] = np.sum(weight * (record.position - target.sample(record.time_ns))[:, 1] ** 2)
    assert scores["learned"] <= min(scores["spline"], scores["linear"])


# --- limits and errors ---


def test_knots_without_samples_stay_bounded():
    """A pass that was heard of only up to its middle."""
    target = line()
    half = ran(target, ringing)
    half = PassRecord(half.time_ns[:1200], half.position[:1200])
    for criterion in ("min_max", "least_squares"):
        reference, _ = revised("learned", target, half, criterion)
        assert np.abs(reference.position - target.position).max() < 1e-3


@pytest.mark.parametrize("method", ["linear", "spline", "learned"])
def test_a_correction_beyond_the_largest_is_shortened_and_it_says_by_how_much(method):
    target = line()
    free, nothing = revised(method, target, ran(target, ringing))
    most = 20e-6
    limited, cut_off = revised(method, target, ran(target, ringing), max_correction=most)
    wanted, given = (np.linalg.norm(r.position - target.position, axis=1) for r in (free, limited))
    (found,) = cut_off
    assert nothing == () and found.kind == "size"
    assert found.wanted == pytest.approx(wanted[found.worst - 1], rel=1e-9)
    assert found.missing == pytest.approx((wanted - given).max(), rel=1e-9)
    over = np.flatnonzero(wanted > most * (1 + 1e-9)) + 1
    assert found.first <= over[0] and over[-1] <= found.last
    if method == "linear":
        np.testing.assert_allclose(given, np.minimum(wanted, most), atol=1e-16)
    ticks = np.arange(0, target.duration_ns, 12_000_000)  # a spline overshoots its knots
    size = np.linalg.norm(limited.sample(ticks) - target.sample(ticks), axis=1)
    assert 0.98 * most < size.max() <= most * (1 + 1e-8)
    cosine = np.sum((free.position - target.position) * (limited.position - target.position), axis=1)
    np.testing.assert_allclose(cosine, wanted * given, atol=1e-18)  # the direction stays


@pytest.mark.parametrize("smooth", [False, True])
def test_a_pass_that_shows_nothing_is_refused(smooth):
    target = line()
    for stamps, position in (([0], [[0.0, 0, 0]]), ([], np.zeros((0, 3))), ([0, 1], [[0.0, 0, 0], [np.nan, 0, 0]])):
        with pytest.raises(RevisionError):
            sampled(smooth, target, target, PassRecord(np.array(stamps, np.int64), np.array(position)))


def test_the_mean_wrench_belongs_to_the_nearest_knot():
    record = PassRecord(
        np.array([0, 4, 6, 10, 14, 30]), np.zeros((6, 3)), 0, np.outer([1.0, 2, 3, 4, 5, 6], np.ones(6))
    )
    found = record.mean_wrench(np.array([0, 10, 20, 30]))
    np.testing.assert_allclose(found[:, 0], [1.5, 4.0, 0.0, 6.0])


def test_without_a_wrench_there_is_no_mean():
    with pytest.raises(RevisionError, match="needs the wrench"):
        PassRecord(np.array([0, 1]), np.zeros((2, 3))).mean_wrench(np.array([0, 1]))


@pytest.mark.parametrize("smooth", [False, True])
def test_a_limited_change_holds_in_every_tick_and_is_told(smooth):
    target, most, tick = line(), 6e-6, 12e-3
    _, nothing = sampled(smooth, target, target, ran(target, ringing), Bounds(max_change=1e-3, tick=tick))
    limited, found = sampled(smooth, target, target, ran(target, ringing), Bounds(max_change=most, tick=tick))
    stamps = np.arange(0, target.duration_ns, round(tick * 1e9) // 12)
    correction = limited.sample(stamps) - target.sample(stamps)
    assert nothing == () and np.linalg.norm(correction[12:] - correction[:-12], axis=1).max() < 1.05 * most
    assert {f.kind for f in found} == {"change"} and all(f.missing > 0 for f in found)


def test_the_sampled_displacement_is_free_of_what_repeats_every_revolution():
    target = Trajectory.straight_line([0, 0, 0], [1, 0, 0], 0.05, 0.05, 0.05)
    time_ns, revolution = np.arange(0, 10**9, 500_000), 7_500_000
    slow = 50e-6 + 20e-6 * time_ns * 1e-9  # [m]
    ripple = 15e-6 * np.sin(2 * np.pi * 4 * time_ns / revolution)  # four teeth, 15 samples a revolution
    moved = np.column_stack([np.zeros(time_ns.size), slow + ripple, np.zeros(time_ns.size)])
    record = PassRecord(time_ns, target.sample(time_ns) + moved, revolution_ns=revolution)
    inner = target.time_ns[(target.time_ns > revolution) & (target.time_ns < 10**9 - revolution)]
    found = record.sampled_displacement(target, inner)[:, 1]
    assert np.abs(found - (50e-6 + 20e-6 * inner * 1e-9)).max() < 1e-8  # the ripple alone is 15e-6


def test_the_slopes_are_scipys_and_a_stop_is_the_only_knot_where_the_spline_is_not_c2():
    values, t = np.random.default_rng(3).normal(0, 1, (25, 3)), 0.05 * np.arange(25)
    ends = np.isin(np.arange(25), [0, 24])
    expected = CubicSpline(t, values, bc_type="clamped")(t, 1)
    np.testing.assert_allclose(spline_slopes(t, values, ends), expected, rtol=0.0, atol=1e-12)
    rates, h = spline_slopes(t, values, ends | (np.arange(25) == 9)), 0.05
    move = np.diff(values, axis=0)
    left = (-6 * move + 2 * h * rates[:-1] + 4 * h * rates[1:]) / h**2  # second derivative at each segment's end
    right = (6 * move - 4 * h * rates[:-1] - 2 * h * rates[1:]) / h**2  # and at its start
    same = np.isclose(left[:-1], right[1:], rtol=1e-8, atol=1e-6).all(axis=1)
    assert np.flatnonzero(~same).tolist() == [8]  # the knot that rests
    assert not rates[[0, 9, 24]].any()
