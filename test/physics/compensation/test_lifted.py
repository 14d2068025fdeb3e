"""The lifted model: response of the arm to a correction, and the correction by dynamic programming."""

import dataclasses
from time import process_time
from timeit import timeit

import numpy as np
import pytest
from book import check
from scipy.interpolate import CubicSpline
from scipy.signal import lsim
from splines import spline

from kr270_milling import read_cell
from kr270_milling.cell.jobs import arm_response, simulate
from kr270_milling.cell.models import path_of
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation import learning, lifted, response
from kr270_milling.physics.compensation.ensemble import Ensemble, least_mean_square
from kr270_milling.physics.compensation.learning import Evidence, fit_arm
from kr270_milling.physics.compensation.lifted import KnotConditions, Lifted, knots
from kr270_milling.physics.compensation.response import ArmResponse, Lag, Segments, cubic_coefficients
from kr270_milling.physics.compensation.revision import Limited

OMEGA, ZETA = 42.0, 0.04
KNOTS = np.cumsum([0, 50, 50, 30, 70, 50, 50, 20, 80, 50, 50, 50, 50]) * 1_000_000  # unevenly spaced
SEGMENTS = Segments(KNOTS, 16)
FINE = np.arange(0, KNOTS[-1] + 1, 50_000)


def one_mode(frequency=OMEGA, damping=ZETA) -> ArmResponse:
    """A mass of 1 kg on a spring across the feed, y; the other axes are rigid."""
    y, one = np.eye(6)[1], np.ones((len(SEGMENTS), 1, 1))
    return ArmResponse(frequency * one[..., 0], damping * one[..., 0], one * y[:3], one * y[:3, None], one * y, one)


# --- The response of the arm to a correction and to a wrench, against scipy's simulation of the transfer functions ---
def correction(smooth: bool) -> Trajectory:
    values = np.random.default_rng(2).normal(0.0, 50e-6, (KNOTS.size, 3))
    return spline(KNOTS, values) if smooth else Trajectory(KNOTS, values, (0.0, 0.0, 0.0, 1.0))


@check("lifted model: tool along a correction of 50 um, {kind}, zeta {damping}",
       "scipy.signal.lsim of (2 z w s + w^2) / (s^2 + 2 z w s + w^2)", "m",
       cases=("kind damping", [(kind, zeta) for kind in ("spline", "lines") for zeta in (0.04, 0.182)]))  # fmt: skip
def test_lifted_response(kind, damping):
    run = correction(kind == "spline")
    shift = run.sample(FINE)[:, 1]
    top, bottom = [2 * damping * OMEGA, OMEGA**2], [1.0, 2 * damping * OMEGA, OMEGA**2]
    expected = lsim((top, bottom), shift - shift[0], FINE * 1e-9)[1] + shift[0]
    obtained = one_mode(damping=damping).follow(SEGMENTS, cubic_coefficients(KNOTS, run.position, run.velocity))
    assert obtained[..., 0] == pytest.approx(run.sample(SEGMENTS.middle_ns)[..., 0], abs=1e-18)  # rigid there
    middle = np.interp(SEGMENTS.middle_ns.ravel(), FINE, expected)
    return 0.0, np.abs(obtained[..., 1].ravel() - middle).max(), 1e-9  # 50 us steps of lsim: 2e-5 of 50 um


def test_motors_follow_a_correction_late():
    """Second order of 10 Hz, against lsim. A dead time T is exact up to s^2; at s = 2 pi i the s^3 leaves 4e-4."""
    w, run = 2 * np.pi * 10.0, correction(True)
    shift = run.sample(FINE)
    rest = [lsim(([w * w], [1.0, 1.4 * w, w * w]), axis - axis[0], FINE * 1e-9)[1] + axis[0] for axis in shift.T]
    expected = np.stack([np.interp(KNOTS[:-1], FINE, axis) for axis in rest], axis=1)
    cubic = cubic_coefficients(KNOTS, run.position, run.velocity)
    assert np.abs(Lag.of(w, 0.7, 0.0).follow(SEGMENTS, cubic)[:, 0] - expected).max() < 1e-9
    late, s = Lag.of(w, 0.7, 5e-3), 2j * np.pi
    obtained, exact = ((1 + 2 * z * s / v + (s / v) ** 2) for v, z in ((late.frequency, late.damping), (w, 0.7)))
    assert abs(1.0 / obtained - np.exp(-5e-3 * s) / exact) < 5e-4
    assert Lag.of(0.0, 0.7, 0.0) is None


def test_the_slope_of_many_robots_is_that_of_their_responses_one_by_one():
    """<slope of c, e> = sum of shares <W H c, H e>: modes that turn from posture to posture, with and without a lag."""
    rng, (m, n, r) = np.random.default_rng(3), (len(SEGMENTS), 4, 3)

    def arm(**others) -> ArmResponse:
        posture, carry = np.arange(m) * n // m, np.eye(r) + 0.1 * rng.normal(size=(n, r, r))
        shapes = rng.normal(size=(n, r, 3)), rng.normal(size=(n, 3, r)), np.zeros((n, r, 6))
        frequency = rng.uniform(30, 90, (n, r))
        return ArmResponse(frequency, np.full((n, r), 0.05), *shapes, carry, gain=0.9, posture=posture, **others)

    arms = arm(), arm(lag=Lag(60.0, 0.7)), arm(moves=False), arm(lag=Lag(40.0, 0.7)).cut(slice(0, m))
    shares, factor = np.array([1.0, 0.3, 0.7, 0.5]), rng.normal(size=(m, 16, 3, 3))
    weight, deviations = factor @ np.swapaxes(factor, -1, -2), rng.normal(size=(4, m, 16, 3))
    cubic, other = rng.normal(size=(2, m, 4, 3)) * [[1.0], [1e1], [1e2], [1e3]]
    robots = list(zip(arms, deviations, strict=True))
    slope = Ensemble(robots, shares, SEGMENTS, weight, slice(0, m)).slope(cubic, 0.6)
    expected = 0.0
    for share, (one, deviation) in zip(shares / 4, robots, strict=True):
        left = 0.6 * deviation + one.follow(SEGMENTS, cubic)
        expected += share * np.sum((weight @ left[..., None])[..., 0] * one.follow(SEGMENTS, other))
    assert np.sum(slope * other) == pytest.approx(expected)


ROBOTS = [dataclasses.replace(one_mode(w), lag=Lag(3.0 * w, 0.7)) for w in (36.0, 42.0, 50.0)]
SHARES = np.array([1.0, 0.3, 0.7])


@pytest.mark.parametrize("smooth", [True, False])
def test_the_least_mean_square_over_robots_has_no_slope_in_any_direction_that_the_knots_allow(smooth):
    """Three robots with other modes, lags, shares. The cost is quadratic: its differences to both sides are equal."""
    rng, m = np.random.default_rng(5), len(SEGMENTS)
    conditions = KnotConditions(smooth, np.zeros(m + 1, bool), np.zeros(m, bool))
    deviations = rng.normal(50e-6, 20e-6, (3, 1, 1, 3)) * np.ones((3, m, 16, 1))
    weight, lifted = np.broadcast_to(np.eye(3), (m, 16, 3, 3)), Lifted(one_mode(), SEGMENTS, conditions)
    robots = list(zip(ROBOTS, deviations, strict=True))
    best = least_mean_square(one_mode(), SEGMENTS, conditions, robots, SHARES, weight, 1e-3, 1e-24)

    def cost(cubic):
        left = np.array([np.sum((d + arm.follow(SEGMENTS, cubic)) ** 2) for arm, d in robots])
        return np.mean(SHARES * left) + np.sum(lifted.roughness(cubic, 1e-3) * cubic)

    least = cost(best)
    assert least < 0.8 * cost(np.zeros_like(best))
    for _ in range(8):
        way = lifted.least_squares(rng.normal(0.0, 20e-6, (m, 16, 3)), weight, 1e-3)[0]
        ahead, behind = cost(best + way) - least, cost(best - way) - least
        assert min(ahead, behind) > 0.0 and abs(ahead - behind) < 1e-3 * (ahead + behind)


@pytest.mark.parametrize("smooth", [True, False])
def test_windows_of_the_path_find_the_least_mean_square_of_the_whole_path(smooth, monkeypatch):
    """6 s before and after each window of 4 s: modes of 36 rad/s with a damping of 4 % decay to 2e-4."""
    segments, m = Segments(np.arange(401) * 50_000_000, 4), 400
    conditions = KnotConditions(smooth, np.arange(m + 1) == 250, np.zeros(m, bool))
    deviation = np.random.default_rng(6).normal(0.0, 20e-6, (3, m, 4, 3))
    robots = [(arm.cut(np.zeros(m, int)), one) for arm, one in zip(ROBOTS, deviation, strict=True)]
    weight = np.broadcast_to(np.eye(3), (m, 4, 3, 3))
    arm = one_mode().cut(np.zeros(m, int))
    numbers = arm, segments, conditions, robots, SHARES, weight, 1e-1, 1e-24

    def solved(shorter: int) -> tuple[np.ndarray, ...]:
        monkeypatch.setattr(lifted, "WINDOW", lifted.WINDOW // shorter)
        model = Lifted(arm, segments, conditions).least_squares(deviation[0], weight, 1e-1)
        return knots(segments, least_mean_square(*numbers)), knots(segments, model[0]), model[1]

    whole = solved(1)
    monkeypatch.setattr(lifted, "REACH", 6.0)
    for path, in_windows in zip(whole, solved(51), strict=True):
        np.testing.assert_allclose(in_windows, path, atol=1e-4 * np.abs(path).max())


def test_under_a_wrench_the_tool_gives_way_by_the_filter_of_its_mode_and_at_last_by_its_compliance():
    force = 80.0
    wrench = np.zeros((len(SEGMENTS), 16, 6))
    wrench[4:, :, 1] = force
    step = np.where(KNOTS[4] <= FINE, force, 0.0)
    expected = lsim(([1.0], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), step, FINE * 1e-9)[1]
    obtained = one_mode().deflect(SEGMENTS, wrench)[..., 1].ravel()
    middle = np.interp(SEGMENTS.middle_ns.ravel(), FINE, expected)
    assert obtained == pytest.approx(middle, abs=1e-3 * force / OMEGA**2)  # a cubic over parts of up to 5 ms
    stiff = one_mode(damping=0.9).scaled(2.0, 1.0, softness=1.5).deflect(SEGMENTS, wrench)[-1, -1, 1]
    assert stiff == pytest.approx(1.5 * force / OMEGA**2, rel=1e-3)  # softness alone changes it, not the frequency


def test_postures_hand_the_displacement_over_whatever_their_modes_are_called_and_share_the_row_of_their_segments():
    # a posture whose mode has the other sign is the same arm
    arm, run = one_mode(), correction(True)
    cubic = cubic_coefficients(KNOTS, run.position, run.velocity)
    sign = np.where(np.arange(12) % 3 == 0, -1.0, 1.0)[:, None, None]
    turned = ArmResponse(
        arm.frequency, arm.damping, sign * arm.inward, sign * arm.outward, sign * arm.push,
        np.concatenate([sign[1:] * sign[:-1], [[[1.0]]]]),
    )  # fmt: skip
    assert turned.follow(SEGMENTS, cubic) == pytest.approx(arm.follow(SEGMENTS, cubic), abs=1e-16)
    # three postures of five, four and three segments, beside an arm with a row of each segment
    rng = np.random.default_rng(3)
    posture = np.repeat([0, 1, 2], [5, 4, 3])
    shared = ArmResponse(
        rng.uniform(30.0, 60.0, (3, 2)), rng.uniform(0.02, 0.2, (3, 2)), rng.normal(size=(3, 2, 3)),
        rng.normal(size=(3, 3, 2)), rng.normal(size=(3, 2, 6)), rng.normal(size=(3, 2, 2)), posture=posture,
    )  # fmt: skip
    names = ("frequency", "damping", "inward", "outward", "push")
    carry = np.where((posture == np.append(posture[1:], 2))[:, None, None], np.eye(2), shared.carry[posture])
    single = ArmResponse(*(getattr(shared, name)[posture] for name in names), carry)
    wrench = rng.normal(size=(len(SEGMENTS), SEGMENTS.parts, 6))
    assert np.array_equal(shared.follow(SEGMENTS, cubic), single.follow(SEGMENTS, cubic))
    assert np.array_equal(shared.deflect(SEGMENTS, wrench), single.deflect(SEGMENTS, wrench))
    for part in (slice(3, 7), slice(8, 12), np.array([1, 4, 11])):
        assert np.array_equal(shared.cut(part).carry, single.cut(part).carry)


MEASURED = (
    "dynamics.modes=[{frequency_hz: 7.1, damping_ratio: 0.037, shape: [0.0, 0.05, 0.0, 0.0, 0.0, 0.0]}, "
    "{frequency_hz: 10.3, damping_ratio: 0.022, shape: [0.02, 0.01, 0.03, 0.0, 0.0, 0.0]}]"
)


@pytest.mark.parametrize("sets", [("dynamics.mass_model=lumped",), ("dynamics.mass_model=rigid",), (MEASURED,)])
def test_the_lifted_model_of_a_cell_is_the_arm_that_its_pass_runs(sets):
    """In the air the pass knows nothing but the inertia of the arm: correction and path against the lifted model."""
    short = ("path.length_mm=12", "stock.min_mm=[50,-1,-1]", "stock.max_mm=[51,1,0]", "timing.controller_step_ms=20")
    cell = read_cell("paper.yaml", *sets, *short, "dynamics.reference_inertia=true")
    target = path_of(cell).target
    shift = np.random.default_rng(1).normal(0.0, 50e-6, (len(target), 3))
    smooth = spline(target.time_ns, target.position + shift, target.quaternion)
    ran = simulate(cell, smooth).result
    assert not ran.wrench.any()
    segments = Segments.of(target.time_ns)
    straight = cubic_coefficients(target.time_ns, target.position, target.velocity)
    cubic = cubic_coefficients(target.time_ns, smooth.position, smooth.velocity) - straight
    obtained = arm_response(cell, target).follow(segments, cubic)
    deviation = np.stack([np.interp(segments.middle_ns, ran.time_ns, d) for d in (ran.actual - ran.target).T], axis=-1)
    assert obtained == pytest.approx(deviation, abs=2e-3 * np.abs(deviation).max())  # linear between samples of 0.5 ms


def test_eq_1_as_printed_moves_the_tool_with_the_reference():
    cell = read_cell("paper.yaml", "path.length_mm=12")
    segments, run = Segments.of(path_of(cell).target.time_ns), correction(True)
    cubic = cubic_coefficients(KNOTS, run.position, run.velocity)[: len(segments)]
    obtained = arm_response(cell, path_of(cell).target).follow(segments, cubic)
    assert obtained == pytest.approx(segments.powers @ cubic, abs=1e-18)


# --- The correction by dynamic programming, against the dense least squares of the same lifted model ---
EIGHTH = Segments(KNOTS, 8)
M = len(EIGHTH)
SMOOTH = 1e-3
WEIGHTS = np.where(EIGHTH.middle_ns < 150_000_000, 0.05**2, 1.0)[..., None, None] * np.diag([0.1, 1.0, 0.5])


def course(smooth=True, stops=(), rests=()) -> KnotConditions:
    still, rest = np.zeros(M + 1, bool), np.zeros(M, bool)
    still[list(stops)], rest[list(rests)] = True, True
    return KnotConditions(smooth, still, rest)


WAVES = [np.sin(20e-9 * EIGHTH.middle_ns + i) + 0.3 * np.cos(55e-9 * EIGHTH.middle_ns * (i + 1)) for i in range(3)]
DEVIATION = 1e-5 * np.stack(WAVES, axis=-1) + 1e-6 * np.random.default_rng(0).standard_normal((M, 8, 3))


def dense(arm, smooth):
    """The same least squares with every column of H simulated by itself; y only."""
    count = M + 3 if smooth else M + 1

    def numbers_to_cubic(number):
        return spline_numbers(number) if smooth else cubic_coefficients(KNOTS, number[:, None], None)[..., 0]

    weight = WEIGHTS[..., 1, 1].ravel()
    typical = np.median(EIGHTH.duration)
    columns, rough = [], []
    for number in np.eye(count):
        cubic = np.zeros((M, 4, 3))
        cubic[:, :, 1] = numbers_to_cubic(number)
        columns.append(arm.follow(EIGHTH, cubic)[..., 1].ravel())
        rough.append(cubic[:, 3, 1] * typical**3 if smooth else np.diff(cubic[:, 1, 1]) * typical)
    h, r, d = np.array(columns).T, np.array(rough).T, DEVIATION[..., 1].ravel()
    rows = np.vstack([h * np.sqrt(weight)[:, None], np.sqrt(SMOOTH) * r])
    right = np.concatenate([-d * np.sqrt(weight), np.zeros(len(r))])
    best = np.linalg.lstsq(rows, right, rcond=None)[0]
    return numbers_to_cubic(best)


def spline_numbers(number):
    """m + 3 numbers of a C2 cubic spline: the values at the knots and the slopes at both ends."""
    spline = CubicSpline(KNOTS * 1e-9, number[:-2], bc_type=((1, number[-2]), (1, number[-1])))
    return cubic_coefficients(KNOTS, number[:-2, None], spline(KNOTS * 1e-9, 1)[:, None])[..., 0]


@pytest.mark.parametrize("smooth", [True, False])
def test_dynamic_programming_finds_the_dense_least_squares(smooth):
    arm = one_mode()
    cubic, _ = Lifted(arm, EIGHTH, course(smooth)).least_squares(DEVIATION, WEIGHTS, SMOOTH)
    expected = dense(arm, smooth)
    scale = np.abs(expected).max(axis=0)[: 4 if smooth else 2]
    difference = np.abs(cubic[:, :, 1] - expected)[:, : scale.size]
    assert np.all(difference.max(axis=0) < 1e-5 * scale)


def test_the_correction_is_c2_between_stops_rests_in_them_and_by_min_max_has_even_peaks():
    lifted = Lifted(one_mode(), EIGHTH, course(True, (0, 5, 8, 9), (8,)))
    cubic, _ = lifted.least_squares(DEVIATION, WEIGHTS, SMOOTH)
    t = EIGHTH.duration[:, None]
    c, v, a, j = np.swapaxes(cubic, 0, 1)
    ends = c + v * t + a * t**2 / 2 + j * t**3 / 6, v + a * t + j * t**2 / 2, a + j * t
    for end, start, size in zip(ends, (c, v, a), (1e-5, 1e-3, 1e-1), strict=True):
        jump = np.abs(end[:-1] - start[1:]).max(axis=1)
        assert np.delete(jump, [4, 7, 8]).max() < 1e-8 * size
        assert size == 1e-1 or jump.max() < 1e-8 * size
    for knot in (5, 8, 9):
        assert np.abs(v[knot]).max() < 1e-12 and np.abs(ends[1][knot - 1]).max() < 1e-12
    assert not cubic[8, 1:].any() and np.abs(v[0]).max() == 0.0
    assert np.abs(ends[2][4] - a[5]).max() > 1e-3  # a separate bend after a stop
    scored = EIGHTH.middle_ns >= 150_000_000
    lifted = Lifted(one_mode(), EIGHTH, course())
    both = lifted.least_squares(DEVIATION, WEIGHTS, 1e-9), lifted.min_max(DEVIATION, WEIGHTS, 1e-9, scored)
    plain, even = (np.abs(left[..., 1][scored]) for _, left in both)
    assert even.max() < 0.9 * plain.max() and even.std() / even.max() < plain.std() / plain.max() + 0.1


def test_a_limited_correction_is_in_reach_at_a_lower_feed():
    """Size goes with the square of the feed, its change in a tick with the cube."""
    size = Limited("size", 1, 2, 1, 0.0, wanted=400e-6, missing=300e-6)
    change = Limited("change", 1, 2, 1, 0.0, wanted=80e-6, missing=70e-6)
    assert size.feed_share == pytest.approx(0.5) and change.feed_share == pytest.approx(0.5)
    turned = dataclasses.replace(change, wanted=1e-5, missing=4e-5)
    assert "10.0 um are wanted, and the correction is 40.0 um away from them" in turned.sentence


# --- a long path: pieces identify the arm, and blocks of segments are one path ---
MANY = 9000
LONG = Segments(np.arange(MANY + 1) * 12_000_000, 4)
LONG_ARM = one_mode().cut(np.zeros(MANY, int))
LONG_PATH = np.zeros((MANY, 4, 3))


def test_pieces_of_a_long_path_identify_the_arm_and_it_costs_in_proportion_to_its_length():
    # a hundred seconds of random wrenches; the pieces have 4096 of the 9000 segments
    assert MANY > learning.MOST_FITTED
    true = LONG_ARM.scaled(1.1, 0.8, 1.0, 1.15)
    wrench = np.random.default_rng(3).normal(0.0, 0.1, (MANY, 4, 6))
    passes = (Evidence(LONG_PATH, true.deflect(LONG, wrench), wrench),)
    fitted, obtained = fit_arm(LONG_ARM, LONG, LONG_PATH, np.zeros(3), passes, np.ones((MANY, 4)), 0.0)
    assert len(fitted.frequency) == MANY
    assert obtained["modes"][0]["frequency_hz"] * 2 * np.pi == pytest.approx(true.frequency[0, 0], rel=1e-3)
    assert obtained["modes"][0]["damping_ratio"] == pytest.approx(true.damping[0, 0], rel=0.02)
    assert obtained["compliance_factor"] == pytest.approx(1.15, rel=1e-3)

    # ten times the knots take about ten times as long; a dense lifted model would take a thousand times
    def cost(count: int) -> float:
        arm, segments = LONG_ARM.cut(slice(0, count)), LONG.cut(slice(0, count))
        conditions = KnotConditions(True, np.zeros(count + 1, bool), np.zeros(count, bool))
        d0 = 1e-5 * np.sin(segments.middle_ns * 3e-8)[..., None] * np.ones(3)
        weight, lifted = np.broadcast_to(np.eye(3), (count, 4, 3, 3)), Lifted(arm, segments, conditions)
        return timeit(lambda: lifted.least_squares(d0, weight, 1e-6), timer=process_time, number=1)

    cost(50)
    assert cost(3000) < 40 * cost(300)


def test_blocks_of_segments_are_one_path(monkeypatch):
    rows = slice(0, 90)
    arm, segments = LONG_ARM.cut(rows), LONG.cut(rows)
    random = np.random.default_rng(4)
    wrench, deviation = random.normal(0.0, 0.1, (90, 4, 6)), random.normal(0.0, 1e-5, (90, 4, 3))
    cubic = random.normal(0.0, 1e-5, (90, 4, 3))
    weight = np.broadcast_to(np.eye(3), (90, 4, 3, 3))

    def results() -> list[np.ndarray]:
        solved = []
        for smooth in (True, False):
            conditions = KnotConditions(smooth, np.arange(91) % 40 == 0, np.zeros(90, bool))
            solved += Lifted(arm, segments, conditions).least_squares(deviation, weight, 1e-6)
        return [arm.deflect(segments, wrench), arm.swing(segments, cubic, np.ones(3)), *solved]

    at_once = results()
    monkeypatch.setattr(response, "BLOCK", 7)
    for whole, in_blocks in zip(at_once, results(), strict=True):
        np.testing.assert_allclose(in_blocks, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


@pytest.mark.parametrize("period_ms", [0.5, 4.0, 5.0])
def test_samples_of_a_vibration_give_its_values_in_the_middle_of_the_parts(period_ms):
    """A mode at 20 Hz, parts of 3 ms: with poses every 4 and 5 ms most parts hold one or none, beside their middle."""
    segments = Segments(np.arange(101) * 12_000_000, 4)
    time_ns = np.arange(0, 1_200_000_001, round(period_ms * 1e6))

    def vibration(time_ns):
        return np.stack([1e-4 * np.sin(40.0 * np.pi * 1e-9 * time_ns + phase) for phase in (0.0, 1.0, 2.0)], axis=-1)

    obtained = segments.middle(time_ns, vibration(time_ns))
    error = np.abs(obtained - vibration(segments.middle_ns))[1:-1]
    assert error.max() < 1e-6
