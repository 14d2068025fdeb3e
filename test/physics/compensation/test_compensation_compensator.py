"""The compensator between the passes, and what it hears of one."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.compensator import Compensator, remaining_error
from kr270_milling.physics.compensation.method import Correction
from kr270_milling.physics.compensation.models import CellModels
from kr270_milling.physics.compensation.revision import KnotsError, PassRecord, RevisionError, sampled_correction
from kr270_milling.physics.compensation.settings import CompensationSettings

KNOTS = np.arange(0, 1_200_000_001, 50_000_000)
TARGET = Trajectory(KNOTS, np.outer(KNOTS * 1e-9, [0.0667, 0.0, 0.0]), (1.0, 0.0, 0.0, 0.0))
STAMPS = np.arange(0, TARGET.duration_ns + 1, 500_000)
LIMITS = {"max_change_per_tick": 10e-3}


def sway(t, amplitude=50e-6):
    return amplitude * np.outer(np.sin(7.0 * t) ** 2 + 0.2 * np.sin(45.0 * t), [0.1, 1.0, 0.2])


def pass_along(reference, share=0.0, noise=0.0, wrench=None):
    """An arm whose displacement takes on ``share`` of the correction: the next pass is not the last one."""
    correction = reference.sample(STAMPS) - TARGET.sample(STAMPS)
    random = np.random.default_rng(len(STAMPS)).normal(0, noise, (STAMPS.size, 3))
    moved = sway(STAMPS * 1e-9) + share * correction + random
    return PassRecord(STAMPS, reference.sample(STAMPS) + moved, 150_000_000, wrench)


def compensator(method, **changes):
    return Compensator(CompensationSettings(method, **{**LIMITS, **changes}), TARGET)


def same(first, second):
    return np.array_equal(first.position, second.position)


# --- remaining error ---


def test_the_remaining_error_is_across_the_feed_and_counts_where_it_is_scored():
    position = TARGET.sample(STAMPS)
    position += [5e-3, 0.0, 0.0]  # along the feed: no error
    position[100] += [0.0, 9e-3, 0.0]  # before it is scored
    position[1000] += [0.0, 30e-6, 40e-6]
    assert remaining_error(TARGET, PassRecord(STAMPS, position, 150_000_000)) == pytest.approx(50e-6, rel=1e-9)
    assert remaining_error(TARGET, PassRecord(STAMPS, position, 0)) == pytest.approx(9e-3, rel=1e-9)


def test_a_pass_that_ends_before_it_is_scored_is_scored_at_its_end():
    short = PassRecord(STAMPS[:100], TARGET.sample(STAMPS[:100]) + [0.0, 7e-6, 0.0], 10**12)
    assert remaining_error(TARGET, short) == pytest.approx(7e-6, rel=1e-9)


def test_a_tool_in_the_air_is_not_scored_where_the_wrench_is_known():
    position, wrench = TARGET.sample(STAMPS), np.ones((STAMPS.size, 6))
    position[2000] += [0.0, 1e-3, 0.0]
    wrench[1900:2100] = 0.0
    assert remaining_error(TARGET, PassRecord(STAMPS, position, 0, wrench)) < 1e-15


# --- the states ---


def test_before_any_pass_the_reference_is_the_target():
    found = compensator("learned")
    assert found.reference is TARGET and found.errors == () and not found.finished and found.first is None


@pytest.mark.parametrize("knots", [2, 7, KNOTS.size])
@pytest.mark.parametrize("method", ["inverse", "learned"])
def test_nothing_is_learned_from_a_reference_with_other_knots(method, knots):
    time = np.linspace(0, KNOTS[-1] - 100_000_000, knots).astype(np.int64)
    found, other = compensator(method), Trajectory(time, TARGET.sample(time), (1.0, 0.0, 0.0, 0.0))
    found.resume(other)
    with pytest.raises(KnotsError, match=f"{knots} knots in 1.1 s.* the times of the target's .25 in 1.2 s"):
        found.revise(pass_along(other))


@pytest.mark.parametrize("method", ["linear", "spline"])
def test_a_method_that_does_not_repeat_revises_after_every_pass(method):
    found = compensator(method)
    first = found.revise(pass_along(TARGET, 0.3))
    second = found.revise(pass_along(first, 0.3))
    assert not same(first, second) and found.reference is second and not found.finished
    assert found.errors[1] < found.errors[0]


@pytest.mark.parametrize("method", ["linear", "spline", "learned"])
def test_repeating_ends_at_a_reference_no_worse_than_any_that_was_run(method):
    found = compensator(method, repeat=True)
    tried = []

    def run(reference):
        tried.append((remaining_error(TARGET, pass_along(reference, 0.3)), reference))
        return pass_along(reference, 0.3)

    kept = found.improve(pass_along(TARGET, 0.3), run)
    assert found.finished and len(tried) >= 2 and kept is found.reference
    assert kept is min(tried, key=lambda t: t[0])[1]
    assert remaining_error(TARGET, pass_along(kept, 0.3)) == min(found.errors)


def test_learning_keeps_the_target_where_every_revision_harms():
    """An arm that gives way three times as much to a correction."""
    found = compensator("learned")
    assert found.improve(pass_along(TARGET, -3.0), lambda r: pass_along(r, -3.0)) is TARGET
    assert found.finished and found.errors[1] > found.errors[0]


@pytest.mark.parametrize(("share", "passes"), [(-0.995, 2), (-0.98, 4)])
def test_learning_stops_at_a_pass_that_brings_less_than_a_percent(share, passes):
    """An arm that takes all but 1 + share of each correction back."""
    found = compensator("learned", max_passes=3)
    found.improve(pass_along(TARGET, share), lambda r: pass_along(r, share))
    assert found.finished and len(found.errors) == passes


def test_learning_stops_where_noise_is_all_that_is_left():
    found = compensator("learned", max_passes=50)
    found.improve(pass_along(TARGET, noise=1e-6), lambda r: pass_along(r, noise=1e-6))
    assert found.finished and len(found.errors) < 10


@pytest.mark.parametrize("most", [1, 3])
def test_no_more_passes_are_taken_than_allowed(most):
    runs = []

    def run(reference):
        runs.append(reference)
        return pass_along(reference, 0.6)  # converges slowly

    found = compensator("learned", max_passes=most)
    found.improve(pass_along(TARGET, 0.6), run)
    assert found.finished and len(runs) == most


def test_after_the_end_a_further_pass_changes_nothing():
    found = compensator("learned")
    kept = found.improve(pass_along(TARGET, 0.3), lambda r: pass_along(r, 0.3))
    assert found.revise(pass_along(kept, -5.0)) is kept and found.finished


def test_reset_goes_back_to_the_target_and_forgets_the_passes():
    found = compensator("learned")
    found.improve(pass_along(TARGET), pass_along)
    found.reset()
    assert found.reference is TARGET and found.errors == () and not found.finished and found.limited == ()


def test_another_method_goes_on_from_the_pass_along_the_target():
    found = compensator("learned")
    found.improve(pass_along(TARGET, 0.2), lambda r: pass_along(r, 0.2))
    for method in ("linear", "spline"):
        alone = compensator(method)
        alone.revise(pass_along(TARGET, 0.2))
        assert same(found.choose(method), alone.reference) and found.method == method and not found.finished


def test_another_method_before_any_pass_leaves_the_target():
    assert compensator("linear").choose("spline") is TARGET


def test_the_method_given_wins_over_that_of_the_parameters():
    assert Compensator(CompensationSettings("linear"), TARGET, "spline").method == "spline"


def test_what_the_limit_took_away_is_known_until_the_next_revision():
    found = compensator("linear", max_correction=20e-6)
    found.revise(pass_along(TARGET))
    size = np.linalg.norm(sway(TARGET.time), axis=1).max()
    assert found.cut_off == pytest.approx(size - 20e-6, rel=1e-6)
    assert np.linalg.norm(found.reference.position - TARGET.position, axis=1).max() <= 20e-6 * (1 + 1e-9)
    found.reset()
    assert found.cut_off == 0.0


# --- a method from outside ---


class Halved:
    """Half of the sampled displacement."""

    name, needs_arm, repeats, smooth = "halved", False, True, False

    def revise(self, task):
        return Correction(0.5 * sampled_correction(task.target, task.reference, task.ran), self.smooth)


def test_a_method_object_runs_through_the_compensator_and_a_cell_without_being_in_the_table():
    by = Compensator(CompensationSettings("linear", **LIMITS), TARGET, Halved())
    assert by.method == "halved" and by.repeats
    by.revise(pass_along(TARGET))
    full = compensator("linear")
    full.revise(pass_along(TARGET))
    np.testing.assert_allclose(
        by.reference.position - TARGET.position, 0.5 * (full.reference.position - TARGET.position), atol=1e-16
    )
    cell = read_cell(find_file("paper.yaml"), ["path.length_mm=30", "stock.grid_step_um=40"])
    original = simulate(cell)
    ran = compensated(cell, original, Halved())
    assert ran.name == "halved" and ran.scores.max_deviation < 0.55 * original.scores.max_deviation


# --- mirror ---


def test_mirror_hands_the_mean_wrench_at_the_knots_over_and_takes_the_modified_points():
    asked = []

    def mirror(target, wrench):
        asked.append((target, wrench))
        return target.with_position(target.position + [0.0, -30e-6, 10e-6])

    found = Compensator(CompensationSettings("mirror", **LIMITS), TARGET, models=CellModels(mirror))
    wrench = np.outer(STAMPS * 1e-9, np.arange(6.0))
    found.revise(pass_along(TARGET, wrench=wrench))
    assert asked[0][0] is TARGET
    np.testing.assert_allclose(asked[0][1][1:-1, 1], TARGET.time[1:-1], atol=3e-4)  # half a sample off centre
    np.testing.assert_allclose(
        found.reference.position - TARGET.position, [[0, -30e-6, 10e-6]] * len(TARGET), atol=1e-15
    )


def test_mirror_without_a_model_of_the_arm_is_refused():
    with pytest.raises(RevisionError, match="the method mirror needs the model of the arm"):
        compensator("mirror").revise(pass_along(TARGET, wrench=np.ones((STAMPS.size, 6))))


def test_mirror_without_a_wrench_is_refused():
    found = Compensator(CompensationSettings("mirror"), TARGET, models=CellModels(lambda t, w: t))
    with pytest.raises(RevisionError, match="needs the wrench"):
        found.revise(pass_along(TARGET))


@pytest.mark.parametrize(
    "wrong", [{"method": "magic"}, {"relaxation": 0.0}, {"relaxation": 1.1}, {"max_passes": 0}, {"criterion": "best"},
              {"max_correction": 0.0}, {"max_correction": np.nan}],
)  # fmt: skip
def test_parameters_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ParameterError):
        CompensationSettings(**({"method": "linear"} | wrong))


# --- the arm itself ---


def test_the_mirror_of_the_papers_case_takes_the_static_part_away():
    cell = read_cell(find_file("paper.yaml"))
    original = simulate(cell)
    mirrored = compensated(cell, original, "mirror")
    assert abs(mirrored.scores.static_deviation) < 0.08 * original.scores.static_deviation
