"""Compensation along a tool path: corners with stops, arcs, limits, every method."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_part import GCODE, assignments, small_part

from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.cell.jobs import compensated, compensator, mirrored, record_of, simulate
from kr270_milling.decide.path_limits import correction_per_tick, correction_size
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.physics.compensation.compensator import remaining_error
from kr270_milling.physics.compensation.limiting import Bounds
from kr270_milling.physics.compensation.mirror import loaded_pose
from kr270_milling.physics.compensation.revision import chord_error, corrected

METHODS = ("linear", "spline", "learned", "mirror")
SMOOTH = ("spline", "learned", "mirror")


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_part(tmp_path_factory.mktemp("part"))


@pytest.fixture(scope="module")
def passes(cell):
    """The original pass, and for each method its compensator and the pass along its reference."""
    original = simulate(cell)
    found = {"original": (None, original)}
    for method in METHODS:
        by = compensator(cell, cell.target(), method)
        found[method] = by, compensated(cell, original, method, by=by)
    return found


def error(cell, ran) -> float:
    return remaining_error(cell.target(), record_of(cell, ran.result))


def stops(cell) -> np.ndarray:
    return np.flatnonzero(~cell.target().velocity.any(axis=1))


@pytest.mark.parametrize(("method", "left"), [("linear", 0.25), ("spline", 0.1), ("learned", 0.1), ("mirror", 0.5)])
def test_every_method_takes_the_error_of_the_whole_path_away(cell, passes, method, left):
    assert error(cell, passes[method][1]) < left * error(cell, passes["original"][1])


@pytest.mark.parametrize("method", METHODS)
def test_the_correction_has_three_components(cell, passes, method):
    reference = passes[method][1].reference
    size = np.abs(reference.position - cell.target().position).max(axis=0)
    pushed = np.abs(passes["original"][1].result.deflection[:, :3]).max(axis=0)
    assert size == pytest.approx(pushed, rel=0.5) and pushed.min() > 3e-6


@pytest.mark.parametrize("method", SMOOTH)
def test_the_path_keeps_its_velocity_in_every_knot(cell, passes, method):
    """C1: the slopes to both sides of a knot are its velocity."""
    run = passes[method][1].reference
    inner, h = run.time_ns[1:-1], 1000  # [ns]
    before = (run.sample(inner) - run.sample(inner - h)) / (h * 1e-9)
    after = (run.sample(inner + h) - run.sample(inner)) / (h * 1e-9)
    assert before == pytest.approx(run.velocity[1:-1], abs=2e-5) and after == pytest.approx(before, abs=4e-5)


@pytest.mark.parametrize("method", SMOOTH)
def test_the_reference_is_c2_between_stops_and_rests_in_them(cell, passes, method):
    run = passes[method][1].reference
    assert len(stops(cell)) == 5 and np.array_equal(run.velocity[stops(cell)], np.zeros((5, 3)))
    shift, rate = run.position, run.velocity
    h = np.diff(run.time)[:, None]
    move = 3 * np.diff(shift, axis=0) / h
    starts = 2 * (move - 2 * rate[:-1] - rate[1:]) / h  # second derivative at both ends of a Hermite segment
    ends = 2 * (rate[:-1] + 2 * rate[1:] - move) / h
    jump = np.abs(ends[:-1] - starts[1:])
    between = np.setdiff1d(np.arange(1, len(run) - 1), stops(cell))
    assert jump[between - 1].max() < 1e-9 * np.abs(starts).max()
    assert jump[stops(cell)[1:-1] - 1].max() > 1e-3 * np.abs(starts).max()


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


def test_linear_runs_the_chords_and_its_chord_error_is_the_sagitta(cell, passes):
    run = passes["linear"][1].reference
    assert run.velocity is None
    chord = 4 / 60 * 12e-3  # at 4 m/min in 12 ms; the arc has a radius of 8 mm
    assert chord_error(cell.target()) == pytest.approx(chord**2 / (8 * 8e-3), rel=0.02)
    straight = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.05, 0.05, 0.012)
    assert chord_error(straight) < 1e-15


def test_the_mirror_turns_the_tool_against_the_turning_of_the_arm(cell):
    """A wrench with moments: what (30) makes of the modified poses is the target again, its orientation as well."""
    k = np.arange(0, len(cell.target()), 20)
    target = cell.target()
    some = Trajectory(target.time_ns[k] - target.time_ns[k[0]], target.position[k], target.quaternion[k])
    wrench = np.tile([80.0, -150.0, 60.0, 20.0, -30.0, 40.0], (len(some), 1))
    by = compensator(cell, some, "mirror")
    points = mirrored(cell, some, wrench)
    modified, _ = corrected(some, points.position - some.position, False, quaternion=points.quaternion)
    assert by.method == "mirror"
    turn, part = np.kron(np.eye(2), cell.workpiece.pose.rotation), cell.workpiece.pose
    loaded = loaded_pose(cell.arm, cell.mount, cell.joints(modified), wrench @ turn.T, True)
    wanted = part @ Pose(some.position, rotation_from_quaternion(some.quaternion))
    assert np.abs(loaded.position - wanted.position).max() < 2e-9
    left = Rotation.from_matrix(loaded.rotation @ np.swapaxes(wanted.rotation, 1, 2)).magnitude()
    bare = loaded_pose(cell.arm, cell.mount, cell.joints(some), wrench @ turn.T, True)
    turned = Rotation.from_matrix(bare.rotation @ np.swapaxes(wanted.rotation, 1, 2)).magnitude()
    assert turned.min() > 1e-5 and left.max() < 1e-7


def test_a_shortened_correction_turns_the_tool_by_the_same_share():
    line = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.05, 0.05, 0.25)
    whole = (Rotation.from_rotvec([0, 2e-3, 0]) * Rotation.from_quat(TOOL_DOWN)).as_quat()
    shift = np.tile([0.0, 4e-4, 0.0], (len(line), 1))
    run, limited = corrected(line, shift, False, Bounds(1e-4), quaternion=np.tile(whole, (len(line), 1)))
    turned = Rotation.from_quat(run.quaternion) * Rotation.from_quat(TOOL_DOWN).inv()
    assert turned.as_rotvec() == pytest.approx(np.tile([0, 0.5e-3, 0], (len(line), 1)), abs=1e-9)
    (found,) = limited
    assert (found.kind, found.first, found.last) == ("size", 1, len(line))
    assert found.wanted == pytest.approx(4e-4) and found.missing == pytest.approx(3e-4)


@pytest.mark.parametrize("method", METHODS)
def test_limits_hold_along_the_path_and_what_they_took_is_told(cell, passes, method):
    most, change = 40e-6, 4e-6
    own = cell.replace(compensation=cell.compensation.replace(max_correction=most, max_change_per_tick=change))
    by = compensator(own, cell.target(), method)
    by.revise(record_of(cell, passes["original"][1].result))
    target = cell.target()
    assert correction_size(target, by.reference, own.compensation.tick_ns, most * 1.0001) == []
    assert correction_per_tick(target, by.reference, own.compensation.tick_ns, change * 1.0001) == []
    free = compensator(cell, target, method)
    free.revise(record_of(cell, passes["original"][1].result))
    missing = np.linalg.norm(free.reference.position - by.reference.position, axis=1)
    assert {found.kind for found in by.limited} == {"size", "change"} and free.limited == ()
    told = np.zeros(len(target), bool)
    for found in by.limited:
        assert found.first <= found.worst <= found.last and found.missing <= found.wanted + most
        assert found.time == target.time[found.worst - 1] and f"at point {found.worst} (" in found.sentence
        told[found.first - 1 : found.last] = True
    assert not np.any((missing > 1e-8) & ~told)


def test_a_step_is_taken_half_before_and_half_after_so_that_it_does_not_lag():
    line = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.05, 0.05, 0.012)
    step = np.outer(np.where(np.arange(len(line)) < 40, 0.0, 80e-6), [0.0, 1.0, 0.0])
    run, (found,) = corrected(line, step, False, Bounds(max_change=10e-6, tick=12e-3))
    y = run.position[:, 1]
    assert np.diff(y).max() == pytest.approx(10e-6) and np.all(np.diff(y) >= 0)
    assert y[:40] + y[79:39:-1] == pytest.approx(np.full(40, 80e-6)) and y[31] == 0 and y[33] > 0
    assert found.kind == "change" and found.first <= 40 <= found.last


def test_repeating_goes_on_while_it_helps_and_keeps_the_best(cell, passes):
    own = cell.replace(compensation=cell.compensation.replace(repeat=True, max_passes=6))
    by = compensator(own, cell.target(), "mirror")
    ran = compensated(own, passes["original"][1], "mirror", by=by)
    assert by.finished and len(by.errors) > 2 and error(cell, ran) == pytest.approx(min(by.errors))
    assert error(cell, ran) <= error(cell, passes["mirror"][1])


def test_learning_keeps_still_in_the_air(cell, passes):
    """The spline must not swing out where nothing is scored: beside the part it would cut."""
    run, ran = passes["learned"][1].reference, passes["original"][1].result
    largest = np.linalg.norm(ran.deflection[:, :3], axis=1).max()
    assert np.linalg.norm(run.position - cell.target().position, axis=1).max() < 1.5 * largest


def test_a_corner_out_of_reach_says_at_which_feed_it_is_in_reach(tmp_path, capsys):
    """The arm's own inertia asks for the correction at a corner, the load for that of a straight cut."""
    from kr270_milling.cli import main

    sets = assignments(tmp_path, GCODE, "compensation.method=inverse", "dynamics.reference_inertia=true")
    words = [part for pair in (*sets, "compensation.max_correction_mm=0.03") for part in ("--set", pair)]
    main(["compensate", "paper.yaml", "--no-verdict", "--out", str(tmp_path / "out"), *words])
    text = capsys.readouterr().out
    assert "is too large at points" in text and "% of the programmed feed there" in text


def test_a_corner_is_in_reach_at_the_feed_that_is_said(tmp_path):
    """All of the path slower by that share f: its acceleration goes with f^2, its jerk with f^3."""
    most, timing = 30e-6, small_part(tmp_path).timing

    def out_of_reach(share):
        """Limited for the arm's own inertia, which asks for most of the correction."""
        slower = (
            f"timing.acceleration_m_per_s2={timing.acceleration * share**2}",
            f"timing.jerk_m_per_s3={timing.jerk * share**3}",
            f"timing.rapid_feed_m_per_min={60.0 * timing.rapid_feed * share}",
        )
        text = GCODE.replace("F4000", f"F{4000.0 * share:.3f}")
        cell = small_part(tmp_path, text, *slower, "dynamics.reference_inertia=true")
        own = cell.replace(compensation=cell.compensation.replace(max_correction=most))
        by = compensator(own, own.target(), "inverse")
        by.revise(record_of(own, simulate(own)))
        return [p for p in by.limited if p.kind == "size" and by.learner.inertia(p.time) > 0.5 * p.wanted]

    before = out_of_reach(1.0)
    after = out_of_reach(min(p.feed_share for p in before))
    assert max(p.wanted for p in before) > 15 * most
    assert all(p.wanted < 1.2 * most for p in after)  # what the load asks for does not become less
