"""Revision of the reference at the controller step and along a tool path, and the static mirror (30) to (32)."""

import numpy as np
import pytest
from arm_oracle import ARM, PAPER
from book import check
from samples.small_part import GCODE, assignments, small_part
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import ModelError
from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.cell.arm import mirrored
from kr270_milling.cell.jobs import compensated, compensator, record_of, simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.cli import main
from kr270_milling.decide.check_arm import correction_per_tick, correction_size
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.physics.compensation.compensator import Compensator, remaining_error
from kr270_milling.physics.compensation.revision import (
    LEVER,
    UNBOUNDED,
    Bounds,
    PassRecord,
    corrected,
    loaded_pose,
    mirror,
    sampled_correction,
)
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.robot import Mount, equilibrium, pose


def line(step_ns=50_000_000):
    """A straight cut of 1.2 s with knots at the controller step."""
    knots = np.arange(0, 1_200_000_001, step_ns)
    return Trajectory(knots, np.outer(knots * 1e-9, [0.0667, 0.0, 0.0]), (1.0, 0.0, 0.0, 0.0), frame="fixture")


def ran(reference, displacement):
    """The pass of an arm that deflects by displacement(t) (n, 3) whatever the reference does."""
    stamps = np.arange(0, reference.duration_ns + 1, 500_000)
    return PassRecord(stamps, reference.sample(stamps) + displacement(stamps * 1e-9))


def sampled(smooth, target, reference, record, bounds=UNBOUNDED):
    """The reference after a pass along ``reference`` by the sampled displacement, and where it was limited."""
    return corrected(target, sampled_correction(target, reference, record), smooth, bounds)


def revised(method, target, first, criterion):
    """The reference after the first pass."""
    limits = {"max_correction": 50e-3, "max_change_per_tick": 50e-3}
    return Compensator(CompensationSettings(method, criterion=criterion, **limits), target).revise(first)


def left(target, reference, displacement):
    """Largest error [m] across the feed when the reference is run."""
    record = ran(reference, displacement)
    return np.abs(record.position - target.sample(record.time_ns))[:, 1].max()


def ringing(t, frequency=6.69, damping=0.18):
    """What the paper's arm does when it is loaded in 0.15 s."""
    w = 2 * np.pi * frequency
    load = np.clip(t / 0.15, 0, 1)
    y = 58e-6 * load - 12e-6 * np.exp(-damping * w * t) * np.sin(w * t) * (t > 0)
    return np.column_stack([-0.2 * y, y, 0.1 * y])


def test_a_displacement_that_the_knots_can_make_is_taken_away_and_not_twice_in_a_second_pass():
    target = line()
    values = np.random.default_rng(4).normal(0, 50e-6, (len(target), 3))  # [m], at the knots
    lines, c2 = make_interp_spline(target.time, values, 1), CubicSpline(target.time, values, bc_type="clamped")
    for smooth, displacement in ((False, lines), (True, c2)):
        reference, cut_off = sampled(smooth, target, target, ran(target, displacement))
        assert left(target, reference, displacement) < 1e-16 and cut_off == ()
        assert (reference.velocity is None) != smooth
        # the displacement is taken against the reference that was run, so it does not add up
        first, _ = sampled(smooth, target, target, ran(target, ringing))
        second, _ = sampled(smooth, target, first, ran(first, ringing))
        np.testing.assert_allclose(second.position, first.position, atol=1e-16)
        assert second.frame == "fixture" and np.array_equal(second.time_ns, target.time_ns)
    for criterion in ("min_max", "least_squares"):
        reference = revised("learned", target, ran(target, displacement), criterion)
        # it sees the means of parts of 3.1 ms, not each sample
        assert left(target, reference, displacement) < 1e-3 * 50e-6


@check("order of the interpolation, {method}", "interpolation theory: 2 for straight lines, 4 for a cubic C2 spline; "
       "learned gains at the ends too", cases=("method expected low high", [
           ("linear", 2.0, 1.65, 2.35), ("spline", 4.0, 3.65, 4.35), ("learned", 4.0, 3.65, 5.2)]))  # fmt: skip
def test_interpolation_order(method, expected, low, high):
    """The error left of a smooth displacement without slope at the ends, as the motion of the program needs it."""

    def displacement(t):
        waves = np.cos(np.pi * t / 1.2) - 0.5 * np.cos(2 * np.pi * t / 1.2) + 0.3 * np.cos(5 * np.pi * t / 1.2)
        return 50e-6 * np.outer(waves, [1.0, 1.0, 1.0])

    finest = 50_000_000 if method == "learned" else 25_000_000  # of means, so some nanometres stay at any step
    steps, errors = finest * np.array([4, 2, 1]), []
    for step in steps:
        target = line(int(step))
        reference = revised(method, target, ran(target, displacement), "least_squares")
        errors.append(left(target, reference, displacement))
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert low < order < high
    return expected, order, high - expected


def test_knots_without_samples_stay_bounded_and_a_pass_that_shows_nothing_is_refused():
    # a pass that was received only up to its middle
    target = line()
    half = ran(target, ringing)
    half = PassRecord(half.time_ns[:1200], half.position[:1200])
    for criterion in ("min_max", "least_squares"):
        reference = revised("learned", target, half, criterion)
        assert np.abs(reference.position - target.position).max() < 1e-3
    for smooth in (False, True):
        for stamps, position in (([0], [[0.0, 0, 0]]), ([], np.zeros((0, 3))), ([0, 1], [[0.0, 0, 0], [np.nan, 0, 0]])):
            with pytest.raises(ModelError):
                sampled(smooth, target, target, PassRecord(np.array(stamps, np.int64), np.array(position)))


def test_the_mean_wrench_belongs_to_the_nearest_knot_and_the_displacement_is_free_of_what_every_revolution_repeats():
    wrench = np.outer([1.0, 2, 3, 4, 5, 6], np.ones(6))
    record = PassRecord(np.array([0, 4, 6, 10, 14, 30]), np.zeros((6, 3)), 0, wrench)
    np.testing.assert_allclose(record.mean_wrench(np.array([0, 10, 20, 30]))[:, 0], [1.5, 4.0, 0.0, 6.0])
    target = Trajectory.straight_line([0, 0, 0], [1, 0, 0], 0.05, 0.05, 0.05)
    time_ns, revolution = np.arange(0, 10**9, 500_000), 7_500_000
    slow = 50e-6 + 20e-6 * time_ns * 1e-9  # [m]
    ripple = 15e-6 * np.sin(2 * np.pi * 4 * time_ns / revolution)  # four teeth, 15 samples a revolution
    moved = np.column_stack([np.zeros(time_ns.size), slow + ripple, np.zeros(time_ns.size)])
    record = PassRecord(time_ns, target.sample(time_ns) + moved, revolution_ns=revolution)
    inner = target.time_ns[(target.time_ns > revolution) & (target.time_ns < 10**9 - revolution)]
    smooth = record.sampled_displacement(target, inner)[:, 1]
    assert np.abs(smooth - (50e-6 + 20e-6 * inner * 1e-9)).max() < 1e-8  # the ripple alone is 15e-6


# --- Compensation along a tool path ---
METHODS = ("linear", "spline", "learned", "mirror")


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_part(tmp_path_factory.mktemp("part"))


@pytest.fixture(scope="module")
def passes(cell):
    """The original pass, and for each method its compensator and the pass along its reference."""
    original = simulate(cell)
    runs = {"original": (None, original)}
    for method in METHODS:
        by = compensator(cell, path_of(cell).target, method)
        runs[method] = by, compensated(cell, original, method, by=by)
    return runs


def test_every_method_takes_the_error_away_by_a_c2_reference_at_rest_in_stops_and_near_in_the_air(cell, passes):
    errors = {
        name: remaining_error(path_of(cell).target, record_of(cell, one.result)) for name, (_, one) in passes.items()
    }
    for method, left in (("linear", 0.25), ("spline", 0.1), ("learned", 0.1), ("mirror", 0.5)):
        assert errors[method] < left * errors["original"]
    stops = np.flatnonzero(~path_of(cell).target.velocity.any(axis=1))
    for method in METHODS[1:]:
        run = passes[method][1].reference
        assert len(stops) == 5 and np.array_equal(run.velocity[stops], np.zeros((5, 3)))
        shift, rate = run.position, run.velocity
        h = np.diff(run.time)[:, None]
        move = 3 * np.diff(shift, axis=0) / h
        starts = 2 * (move - 2 * rate[:-1] - rate[1:]) / h  # second derivative at both ends of a Hermite segment
        ends = 2 * (rate[:-1] + 2 * rate[1:] - move) / h
        jump = np.abs(ends[:-1] - starts[1:])
        between = np.setdiff1d(np.arange(1, len(run) - 1), stops)
        assert jump[between - 1].max() < 1e-9 * np.abs(starts).max()
        assert jump[stops[1:-1] - 1].max() > 1e-3 * np.abs(starts).max()
    # the spline must not swing out where nothing is scored: beside the part it would cut
    run, ran = passes["learned"][1].reference, passes["original"][1].result
    largest = np.linalg.norm(ran.deflection[:, :3], axis=1).max()
    assert np.linalg.norm(run.position - path_of(cell).target.position, axis=1).max() < 1.5 * largest


def test_a_rest_is_held_at_one_correction():
    time_ns = np.arange(12) * 50_000_000
    x = np.concatenate([np.linspace(0, 10e-3, 5), np.full(3, 10e-3), np.linspace(10e-3, 20e-3, 5)[1:]])  # (12,)
    position, velocity = np.zeros((12, 3)), np.zeros((12, 3))
    position[:, 0], velocity[[1, 2, 3, 8, 9, 10], 0] = x, 0.05
    target = Trajectory(time_ns, position, TOOL_DOWN, velocity)
    wanted = np.outer(np.linspace(0, 110e-6, 12), [0.0, 1.0, 0.0])
    run, limited = corrected(target, wanted, True)
    rest = slice(4, 8)  # four knots at x = 10 mm
    assert limited == () and np.ptp(run.position[rest], axis=0).max() == 0 and not run.velocity[rest].any()
    assert run.position[4, 1] == pytest.approx(wanted[rest, 1].mean())
    within = run.sample(np.linspace(time_ns[4], time_ns[7], 50).astype(np.int64))
    assert np.ptp(within, axis=0).max() < 1e-18
    assert run.position[[3, 8], 1] == pytest.approx(wanted[[3, 8], 1])


def test_the_mirror_turns_the_tool_against_the_turning_of_the_arm(cell):
    """A wrench with moments: what (30) makes of the modified poses is the target again, its orientation as well."""
    target = path_of(cell).target
    k = np.arange(0, len(target), 20)
    some = Trajectory(target.time_ns[k] - target.time_ns[k[0]], target.position[k], target.quaternion[k])
    wrench = np.tile([80.0, -150.0, 60.0, 20.0, -30.0, 40.0], (len(some), 1))
    points = mirrored(arm_of(cell), cell.compensation.relaxation, some, wrench)
    modified, _ = corrected(some, points.position - some.position, False, quaternion=points.quaternion)
    turn, part = np.kron(np.eye(2), cell.workpiece.pose.rotation), cell.workpiece.pose
    loaded = loaded_pose(cell.arm, cell.mount, arm_of(cell).joints(modified), wrench @ turn.T, True)
    wanted = part @ Pose(some.position, rotation_from_quaternion(some.quaternion))
    assert np.abs(loaded.position - wanted.position).max() < 2e-9
    left = Rotation.from_matrix(loaded.rotation @ np.swapaxes(wanted.rotation, 1, 2)).magnitude()
    bare = loaded_pose(cell.arm, cell.mount, arm_of(cell).joints(some), wrench @ turn.T, True)
    turned = Rotation.from_matrix(bare.rotation @ np.swapaxes(wanted.rotation, 1, 2)).magnitude()
    assert turned.min() > 1e-5 and left.max() < 1e-7


def test_a_limit_shortens_the_turn_alike_bounds_a_spline_between_its_knots_and_shares_a_step_before_and_after():
    way = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.05, 0.05, 0.25)
    whole = (Rotation.from_rotvec([0, 2e-3, 0]) * Rotation.from_quat(TOOL_DOWN)).as_quat()
    shift = np.tile([0.0, 4e-4, 0.0], (len(way), 1))
    run, limited = corrected(way, shift, False, Bounds(1e-4), quaternion=np.tile(whole, (len(way), 1)))
    turned = Rotation.from_quat(run.quaternion) * Rotation.from_quat(TOOL_DOWN).inv()
    assert turned.as_rotvec() == pytest.approx(np.tile([0, 0.5e-3, 0], (len(way), 1)), abs=1e-9)
    (part,) = limited
    assert (part.kind, part.first, part.last) == ("size", 1, len(way))
    assert part.wanted == pytest.approx(4e-4) and part.missing == pytest.approx(3e-4)
    way = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.05, 0.05, 0.012)
    step = np.outer(np.where(np.arange(len(way)) < 40, 0.0, 80e-6), [0.0, 1.0, 0.0])
    run, (part,) = corrected(way, step, False, Bounds(max_change=10e-6, tick=12e-3))
    y = run.position[:, 1]
    assert np.diff(y).max() == pytest.approx(10e-6) and np.all(np.diff(y) >= 0)
    assert y[:40] + y[79:39:-1] == pytest.approx(np.full(40, 80e-6)) and y[31] == 0 and y[33] > 0
    assert part.kind == "change" and part.first <= 40 <= part.last
    for kind, bounds in (("size", Bounds(20e-6)), ("change", Bounds(max_change=6e-6))):
        target = line()
        reference, limited = sampled(True, target, target, ran(target, ringing), bounds)
        ticks = np.arange(0, target.duration_ns, 12_000_000)
        correction = reference.sample(ticks) - target.sample(ticks)
        values, most = (correction, 20e-6) if kind == "size" else (np.diff(correction, axis=0), 6e-6)
        largest = np.linalg.norm(values, axis=1).max()
        assert {one.kind for one in limited} == {kind} and 0.97 * most < largest <= most * (1 + 1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_limits_hold_along_the_path_and_what_they_took_is_stated(cell, passes, method):
    most, change = 40e-6, 4e-6
    own = cell.replace(compensation=cell.compensation.replace(max_correction=most, max_change_per_tick=change))
    by = compensator(own, path_of(cell).target, method)
    by.revise(record_of(cell, passes["original"][1].result))
    target = path_of(cell).target
    assert correction_size(target, by.reference, own.compensation.tick_ns, most * 1.0001) == []
    assert correction_per_tick(target, by.reference, own.compensation.tick_ns, change * 1.0001) == []
    free = compensator(cell, target, method)
    free.revise(record_of(cell, passes["original"][1].result))
    missing = np.linalg.norm(free.reference.position - by.reference.position, axis=1)
    assert {part.kind for part in by.limited} == {"size", "change"} and free.limited == ()
    stated = np.zeros(len(target), bool)
    for part in by.limited:
        assert part.first <= part.worst <= part.last and part.missing <= part.wanted + most
        assert part.time == target.time[part.worst - 1] and f"at point {part.worst} (" in part.sentence
        stated[part.first - 1 : part.last] = True
    assert not np.any((missing > 1e-8) & ~stated)


def test_a_corner_out_of_reach_says_at_which_feed_it_is_in_reach(tmp_path, capsys):
    """The arm's own inertia asks for the correction at a corner, the load for that of a straight cut."""
    sets = assignments(tmp_path, GCODE, "compensation.method=inverse", "dynamics.reference_inertia=true")
    words = [part for pair in (*sets, "compensation.max_correction_mm=0.03") for part in ("--set", pair)]
    main(["compensate", "paper.yaml", "--verdict", "0", "--out", str(tmp_path / "out"), *words])
    text = capsys.readouterr().out
    assert "is too large at points" in text and "% of the programmed feed there" in text


# --- The static mirror (30)-(32): under load the modified target ends where the target is ---
SPINDLE = Mount(xyz=np.array([0.25, 0.0, 0.1]), mass=60.0, mass_centre=np.array([0.1, 0.0, 0.05]))
START = pose(ARM, SPINDLE, PAPER)
TARGET = Pose(
    START.position + np.linspace(0, 0.08, 5)[:, None] * START.rotation[:, 0], np.tile(START.rotation, (5, 1, 1))
)
WRENCH = np.array([800.0, -600.0, 400.0, 60.0, -90.0, 40.0])
LOADS = {"1 kN and moments": [1] * 6, "1 kN": [1, 1, 1, 0, 0, 0], "moments": [0, 0, 0, 1, 1, 1]}


def gap(first: Pose, second: Pose) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between two stacks of poses."""
    turn = Rotation.from_matrix(first.rotation @ np.swapaxes(second.rotation, -1, -2)).magnitude()
    return np.linalg.norm(first.position - second.position, axis=-1).max(), np.max(turn)


@check(
    "mirror (31), {load}, alpha {relaxation}: loaded tool where the target is", "(31) solved: the target; link weights",
    "m", cases=("load relaxation", [(load, alpha) for load in LOADS for alpha in (0.5, 0.9, 1.0)]),
)  # fmt: skip
def test_mirror_target(load, relaxation):
    force = WRENCH * LOADS[load]
    modified, joints, _ = mirror(ARM, SPINDLE, TARGET, force, PAPER, relaxation=relaxation, sag_compensated=False)
    loaded = equilibrium(ARM, SPINDLE, joints, np.tile(force, (5, 1)), gravity=True).pose
    assert gap(loaded, TARGET)[1] < 1e-8
    assert gap(pose(ARM, SPINDLE, joints), modified)[0] < 1e-12  # the joints command the modified target
    return 0.0, gap(loaded, TARGET)[0], 1e-9


def test_the_mirror_works_point_by_point_leaves_the_sag_to_the_controller_weighs_turns_and_states_what_is_left():
    modified, joints, _ = mirror(ARM, SPINDLE, TARGET, WRENCH, PAPER)
    heavy, light = (
        equilibrium(ARM, SPINDLE, joints, w * np.ones((5, 1)), gravity=True).pose for w in (WRENCH, 0 * WRENCH)
    )
    moved = modified.position + heavy.position - light.position
    np.testing.assert_allclose(moved, TARGET.position, atol=1e-9)
    turned = heavy.rotation @ np.swapaxes(light.rotation, -1, -2) @ modified.rotation
    assert gap(Pose(moved, turned), TARGET)[1] < 1e-8
    wrenches = WRENCH * np.linspace(-1, 1, 5)[:, None]
    whole = mirror(ARM, SPINDLE, TARGET, wrenches, PAPER)[0]
    for k in range(5):
        one = mirror(ARM, SPINDLE, Pose(TARGET.position[k : k + 1], TARGET.rotation[:1]), wrenches[k], PAPER)[0]
        assert gap(one, Pose(whole.position[k : k + 1], whole.rotation[k : k + 1]))[0] < 2e-9
    moment = np.array([0, 0, 0, 0, 0, 30.0])
    _, _, history = mirror(ARM, SPINDLE, TARGET, moment, PAPER)
    tilted = loaded_pose(ARM, SPINDLE, np.tile(PAPER, (1, 1)), moment[None], True)
    shift, turn = gap(tilted, Pose(START.position[None], START.rotation[None]))
    assert history[0] == pytest.approx(shift + LEVER * turn, rel=0.05)
    for relaxation, iterations in ((0.01, 60), (0.9, 3), (1.0, 1)):
        with pytest.raises(ModelError, match=rf"m left after {iterations} iterations of \(32\), wanted 1e-09 m"):
            mirror(ARM, SPINDLE, TARGET, WRENCH, PAPER, relaxation=relaxation, max_iterations=iterations)


@check(
    "mirror (32): error of an iteration / of the one before, alpha {relaxation}", "1 - alpha for a nearly linear arm",
    cases=("relaxation", [(0.2,), (0.5,), (0.8,), (0.9,)]),
)  # fmt: skip
def test_mirror_rate(relaxation):
    history = np.array(mirror(ARM, SPINDLE, TARGET, WRENCH, PAPER, relaxation=relaxation, max_iterations=200)[2])
    assert np.all(np.diff(history) < 0)
    rate = np.exp(np.polyfit(np.arange(len(history) - 1), np.log(history[:-1]), 1)[0])
    return 1 - relaxation, rate, 0.05 * (1 - relaxation)
