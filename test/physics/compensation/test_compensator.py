"""The compensator between the passes, and learning of an arm that is not the model's."""

import copy
import dataclasses
import json
import re

import numpy as np
import pages
import pytest
from samples.small_part import small_part

from kr270_milling import read_cell
from kr270_milling.base.errors import ModelError
from kr270_milling.cell import jobs
from kr270_milling.cell.jobs import compensated, cut_along, record_of, simulate
from kr270_milling.cell.models import modal_model_of, path_of
from kr270_milling.cell.plant import Plant
from kr270_milling.cli import main
from kr270_milling.decide.verdict import monte_carlo
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.compensator import Compensator, noise_floor, remaining_error
from kr270_milling.physics.compensation.learning import CellModels, Learner
from kr270_milling.physics.compensation.method import Correction
from kr270_milling.physics.compensation.revision import PassRecord, sampled_correction
from kr270_milling.physics.compensation.settings import CompensationSettings

KNOTS = np.arange(0, 1_200_000_001, 50_000_000)
TARGET = Trajectory(KNOTS, np.outer(KNOTS * 1e-9, [0.0667, 0.0, 0.0]), (1.0, 0.0, 0.0, 0.0))
STAMPS = np.arange(0, TARGET.duration_ns + 1, 500_000)
LIMITS = {"max_change_per_tick": 10e-3}
UM = 1e-6
COARSE = ("stock.grid_step_um=40", "exchange.micro_step_deg=3", "dynamics.reference_inertia=true")


def sway(t):
    return 50e-6 * np.outer(np.sin(7.0 * t) ** 2 + 0.2 * np.sin(45.0 * t), [0.1, 1.0, 0.2])


def pass_along(reference, share=0.0, noise=0.0, wrench=None):
    """An arm whose displacement takes on ``share`` of the correction: the next pass is not the last one."""
    correction = reference.sample(STAMPS) - TARGET.sample(STAMPS)
    random = np.random.default_rng(len(STAMPS)).normal(0, noise, (STAMPS.size, 3))
    moved = sway(STAMPS * 1e-9) + share * correction + random
    return PassRecord(STAMPS, reference.sample(STAMPS) + moved, 150_000_000, wrench)


def compensator(method, **changes):
    return Compensator(CompensationSettings(method, **{**LIMITS, **changes}), TARGET)


# --- remaining error ---
def test_the_remaining_error_is_across_the_feed_and_counts_where_it_is_scored_and_not_in_the_air():
    position = TARGET.sample(STAMPS)
    position += [5e-3, 0.0, 0.0]  # along the feed: no error
    position[100] += [0.0, 9e-3, 0.0]  # before it is scored
    position[1000] += [0.0, 30e-6, 40e-6]
    assert remaining_error(TARGET, PassRecord(STAMPS, position, 150_000_000)) == pytest.approx(50e-6, rel=1e-9)
    assert remaining_error(TARGET, PassRecord(STAMPS, position, 0)) == pytest.approx(9e-3, rel=1e-9)
    short = PassRecord(STAMPS[:100], TARGET.sample(STAMPS[:100]) + [0.0, 7e-6, 0.0], 10**12)
    assert remaining_error(TARGET, short) == pytest.approx(7e-6, rel=1e-9)
    position, wrench = TARGET.sample(STAMPS), np.ones((STAMPS.size, 6))
    position[2000] += [0.0, 1e-3, 0.0]
    wrench[1900:2100] = 0.0
    assert remaining_error(TARGET, PassRecord(STAMPS, position, 0, wrench)) < 1e-15


# --- the states ---
@pytest.mark.parametrize("knots", [2, 7, KNOTS.size])
@pytest.mark.parametrize("method", ["inverse", "learned"])
def test_nothing_is_learned_from_a_reference_with_other_knots(method, knots):
    time = np.linspace(0, KNOTS[-1] - 100_000_000, knots).astype(np.int64)
    by, other = compensator(method), Trajectory(time, TARGET.sample(time), (1.0, 0.0, 0.0, 0.0))
    by.resume(other)
    with pytest.raises(ModelError, match=f"{knots} knots in 1.1 s.* the times of the target's .25 in 1.2 s"):
        by.revise(pass_along(other))


def test_a_method_revises_after_every_pass_and_repeating_ends_at_a_reference_no_worse_than_any_that_was_run():
    for method in ("linear", "spline"):
        by = compensator(method)
        first = by.revise(pass_along(TARGET, 0.3))
        second = by.revise(pass_along(first, 0.3))
        assert not np.array_equal(first.position, second.position) and by.reference is second and not by.finished
        assert by.errors[1] < by.errors[0]
    for method in ("linear", "spline", "learned"):
        by, tried = compensator(method, repeat=True), []
        best = by.improve(pass_along(TARGET, 0.3), lambda r, tried=tried: tried.append(r) or pass_along(r, 0.3))
        assert by.finished and len(tried) >= 2 and best is by.reference
        assert best is min(tried, key=lambda r: remaining_error(TARGET, pass_along(r, 0.3)))
        assert remaining_error(TARGET, pass_along(best, 0.3)) == min(by.errors)


def test_learning_ends_where_revisions_harm_or_bring_less_than_a_percent_or_the_noise_or_are_as_many_as_allowed():
    # an arm that deflects three times as much to a correction
    by = compensator("learned")
    assert by.improve(pass_along(TARGET, -3.0), lambda r: pass_along(r, -3.0)) is TARGET
    assert by.finished and by.errors[1] > by.errors[0]
    assert "no pass better than the one without compensation" in by.note
    # an arm that takes all but 1 + share of each correction back
    for share, passes in ((-0.995, 2), (-0.98, 4)):
        by = compensator("learned", max_passes=3)
        by.improve(pass_along(TARGET, share), lambda r, share=share: pass_along(r, share))
        assert by.finished and len(by.errors) == passes
    for most in (1, 3):  # converges slowly
        by, runs = compensator("learned", max_passes=most), []
        by.improve(pass_along(TARGET, 0.6), lambda r, runs=runs: runs.append(r) or pass_along(r, 0.6))
        assert by.finished and len(runs) == most

    # the noise of a least-squares fit: sigma times the root of 25 knots over 2401 samples
    def noisy(reference):
        return dataclasses.replace(pass_along(reference, noise=1e-6), noise=1e-6)

    by, floor = compensator("learned", max_passes=50), noise_floor(TARGET, noisy(TARGET))
    assert floor == pytest.approx(1e-6 * np.sqrt(25 / 2401), rel=1e-9)
    by.improve(noisy(TARGET), noisy)
    gains = np.minimum.accumulate(by.errors)[:-1] - by.errors[1:]
    assert by.finished and np.all(gains[-2:] < floor)
    assert not any(np.all(gains[k : k + 2] < floor) for k in range(len(gains) - 2))


def test_after_the_end_a_pass_changes_nothing_another_method_or_reset_starts_again_and_the_limited_part_is_known():
    by = compensator("learned")
    best = by.improve(pass_along(TARGET, 0.3), lambda r: pass_along(r, 0.3))
    assert by.revise(pass_along(best, -5.0)) is best and by.finished
    by.reset()
    assert by.reference is TARGET and by.errors == () and not by.finished and by.limited == ()
    by = compensator("learned")
    by.improve(pass_along(TARGET, 0.2), lambda r: pass_along(r, 0.2))
    for method in ("linear", "spline"):
        alone = compensator(method)
        alone.revise(pass_along(TARGET, 0.2))
        np.testing.assert_array_equal(by.choose(method).position, alone.reference.position)
        assert by.method == method and not by.finished
    by = compensator("linear", max_correction=20e-6)
    by.revise(pass_along(TARGET))
    size = np.linalg.norm(sway(TARGET.time), axis=1).max()
    assert by.cut_off == pytest.approx(size - 20e-6, rel=1e-6)
    assert np.linalg.norm(by.reference.position - TARGET.position, axis=1).max() <= 20e-6 * (1 + 1e-9)
    by.reset()
    assert by.cut_off == 0.0


# --- a method from outside ---
class Halved:
    """Half of the sampled displacement."""

    name, repeats, smooth = "halved", True, False

    def revise(self, task):
        return Correction(0.5 * sampled_correction(task.target, task.reference, task.ran), self.smooth)


def test_a_method_object_revises_without_being_in_the_table():
    by, full = Compensator(CompensationSettings("linear", **LIMITS), TARGET, Halved()), compensator("linear")
    half, whole = (one.revise(pass_along(TARGET)).position - TARGET.position for one in (by, full))
    assert by.method == "halved" and by.repeats
    np.testing.assert_allclose(half, 0.5 * whole, atol=1e-16)


# --- mirror ---
def test_mirror_takes_the_points_of_its_model_for_the_mean_wrench_at_the_knots_and_needs_both():
    asked = []

    def mirror(target, wrench):
        asked.append((target, wrench))
        return target.with_position(target.position + [0.0, -30e-6, 10e-6])

    by = Compensator(CompensationSettings("mirror", **LIMITS), TARGET, models=CellModels(mirror))
    wrench = np.outer(STAMPS * 1e-9, np.arange(6.0))
    by.revise(pass_along(TARGET, wrench=wrench))
    assert asked[0][0] is TARGET
    np.testing.assert_allclose(asked[0][1][1:-1, 1], TARGET.time[1:-1], atol=3e-4)  # half a sample off centre
    moved = by.reference.position - TARGET.position
    np.testing.assert_allclose(moved, [[0, -30e-6, 10e-6]] * len(TARGET), atol=1e-15)
    with pytest.raises(ModelError, match="the method mirror needs the model of the arm"):
        compensator("mirror").revise(pass_along(TARGET, wrench=np.ones((STAMPS.size, 6))))
    with pytest.raises(ModelError, match="needs the wrench"):
        Compensator(CompensationSettings("mirror"), TARGET, models=CellModels(mirror)).revise(pass_along(TARGET))


# --- Learning of an arm that is not the model's ---
FREQUENCY, DAMPING, SOFT = 1.15, 0.5, 1.1


@pytest.fixture(scope="module")
def cell():
    return read_cell("paper.yaml", *COARSE, "dynamics.damping_ratio=0.04", "compensation.max_passes=4")


def plant_of(cell, **imperfections) -> Plant:
    """An arm that is softer, lighter and less damped than the model's: omega^2 is stiffness / mass."""
    mass = cell.arm.link_mass / (FREQUENCY**2 * SOFT)
    arm = cell.arm.replace(link_mass=mass, joint_compliance=SOFT * cell.arm.joint_compliance)
    dynamics = cell.dynamics.replace(damping_ratio=DAMPING * cell.dynamics.damping_ratio)
    imperfect = cell.imperfections.replace(wrench="exact", **imperfections)  # a noisy wrench biases the fit
    return Plant(cell, cell.replace(arm=arm, dynamics=dynamics), imperfect)


@pytest.fixture(scope="module")
def learned(cell):
    """Plant, original pass, compensator, learned pass."""
    plant = plant_of(cell)
    original = simulate(cell, plant=plant)
    by = jobs.compensator(cell, path_of(cell).target, "learned")
    return plant, original, by, compensated(cell, original, "learned", by=by, plant=plant)


def test_learning_identifies_the_plant_leaves_less_than_a_hundredth_and_changes_no_copy_of_itself(cell, learned):
    plant, original, by, ran = learned
    true = modal_model_of(plant.cell).frequency / (2 * np.pi)
    identified = by.identified
    assert identified["modes"][0]["mode"] == 1
    for mode, frequency, damping in (row.values() for row in identified["modes"]):
        assert frequency == pytest.approx(true[mode - 1], rel=0.01)
        assert damping == pytest.approx(plant.cell.dynamics.damping_ratio, rel=0.15)
    assert identified["compliance_factor"] == pytest.approx(SOFT, rel=0.02)
    assert identified["gain"] == pytest.approx(1.0, abs=0.01)
    assert by.finished and len(by.errors) <= 5
    assert original.scores.max_deviation > 70 * UM and ran.scores.max_deviation < 0.01 * original.scores.max_deviation
    # the node tries a revision on a copy of its compensator
    by = jobs.compensator(cell, path_of(cell).target, "learned")
    copied = copy.copy(by)
    copied.revise(record_of(cell, original))
    assert by.learner is None and by.errors == () and len(copied.learner.passes) == 1


SHALLOW = "G21 G90 S8000 M3\nG0 X-14 Y0 Z5\n(slot)\nG0 Z-0.4\nG1 X30 F4000\nG0 Z5\nM30\n"


def test_the_cut_answers_a_tool_that_sinks(tmp_path):
    """The rapid move down leaves the arm swinging: where the tool sinks it cuts with its whole end, F_z and F_y change.

    On the path it does not sink; the wrench there is that of a rigid arm.
    """
    cell = small_part(
        tmp_path, SHALLOW, "cutting.fractional.axial_ratio=0.4", "dynamics.reference_inertia=true",
        "dynamics.damping_ratio=0.04", "dynamics.mass_model=rigid",
    )  # fmt: skip
    original, by = simulate(cell), jobs.compensator(cell, path_of(cell).target, "inverse")
    by.revise(record_of(cell, original))
    (evidence,), scored = by.learner.passes, by.learner.scored
    rigid = cut_along(cell, path_of(cell).target)
    exact = by.learner.segments.mean(rigid.time_ns - 125_000, rigid.wrench)[scored]  # each is of the period before

    def off(wrench):
        return np.sqrt(np.mean((wrench[scored] - exact)[:, :3] ** 2, axis=0))

    assert np.all(off(evidence.wrench) > 0.7) and np.all(off(evidence.on_path) < 0.15)  # [N]
    before, after = (
        np.abs((ran.result.actual - ran.result.target)[ran.result.volume > 0.0]).max(axis=0)
        for ran in (original, simulate(cell, by.reference))
    )
    assert before.min() > 30 * UM and after.max() < 1 * UM


def test_a_long_program_learns_from_passes_of_the_model_and_ends_with_a_tenth_of_the_error(tmp_path, monkeypatch):
    """The wrench on the path is that of the rigid cut: a pass of the model is the pass that the model predicts."""
    cell = small_part(
        tmp_path, SHALLOW, "cutting.detail=engagement", "dynamics.reference_inertia=true",
        "dynamics.damping_ratio=0.04", "dynamics.mass_model=rigid",
    )  # fmt: skip
    monkeypatch.setattr(jobs, "FEW_PERIODS", 10)
    monkeypatch.setattr(jobs, "predicted", None)
    by = jobs.compensator(cell, path_of(cell).target, "learned")
    evidence: list = []
    by.revise, revise = lambda record: (revise(record), evidence.extend(by.learner.passes))[0], by.revise
    planned = compensated(cell, simulate(cell), "learned", by=by)
    first, *between, last = by.errors
    assert last <= 0.1 * first and all(error > 0.1 * first for error in between)
    assert planned.result is None and planned.reference is by.best
    rigid = cut_along(cell, path_of(cell).target)
    exact = by.learner.segments.mean(rigid.time_ns - round(0.5e9 * cell.exchange.period), rigid.wrench)
    on_path = evidence[0].on_path
    np.testing.assert_allclose(on_path[:-1], exact[:-1], atol=1e-6 * np.abs(exact).max())  # [N, N m]


def test_robust_equals_inverse_without_uncertainty_and_is_better_in_the_mean_of_other_robots(cell, few_robots):
    """Robots with a soft base and a lag of 10 to 20 Hz, other ones than it planned for."""
    moving = cell.replace(compensation=cell.compensation.replace(criterion="least_squares"))
    numbers = {k: 0.0 for k, v in vars(cell.uncertainty).items() if isinstance(v, float) and k != "reference_inertia"}
    exact = cell.uncertainty.replace(servo_frequency=np.array([]), end_share=np.array([]), **numbers)
    ran = record_of(moving, simulate(moving))

    def revised(uncertainty, method):
        planned = moving.replace(uncertainty=uncertainty)
        return jobs.compensator(planned, path_of(planned).target, method).revise(ran)

    inverse, same = revised(exact, "inverse"), revised(exact, "robust")
    assert same.position == pytest.approx(inverse.position, abs=1e-9)
    lagging = exact.replace(servo_frequency=np.array([10.0, 20.0]), base_compliance=0.08e-6)
    robust, judged = revised(lagging, "robust"), moving.replace(uncertainty=lagging)
    errors = np.array([monte_carlo(judged, run, 6, 1).compensated for run in (inverse, robust)])
    assert np.mean(errors[1] ** 2) < 0.5 * np.mean(errors[0] ** 2)


def test_a_robot_that_strays_by_itself_leaves_the_plan_for_the_others(cell):
    """Three robots are 20 um beside the model, a fourth 2 mm with s = 1e-4: 20.1 um, and not the mean of 515 um."""
    moving = cell.replace(compensation=cell.compensation.replace(criterion="least_squares"))
    target, arm = path_of(moving).target, jobs.arm_response(moving, path_of(moving).target)

    def robots(target, reference):
        ran = simulate(moving, reference).result
        shifts = [0.0, 20 * UM, 20 * UM, 20 * UM, 2000 * UM]
        return [(arm, PassRecord(ran.time_ns, ran.actual + np.array([0.0, shift, 0.0]))) for shift in shifts]

    models = dataclasses.replace(jobs.models_of(moving), robots=robots)
    learner = Learner.of_model(target, models, "least_squares", True).expect()
    change = (learner.robust_correction() - learner.correction())[len(target) // 2]
    assert change == pytest.approx([0.0, -20 * UM, 0.0], abs=1 * UM)


def test_lines_between_the_knots_a_missing_wrench_and_noise_of_the_pose_leave_little(cell, learned):
    lines = cell.replace(compensation=cell.compensation.replace(interpolation="linear"))
    ran = compensated(lines, simulate(lines), "learned")
    assert ran.reference.velocity is None and ran.scores.max_deviation < 1 * UM
    plant, original, *_ = learned
    blind = dataclasses.replace(record_of(cell, original), wrench=None)
    reference = jobs.compensator(cell, path_of(cell).target, "inverse").revise(blind)
    ran = simulate(cell, reference, plant=plant)
    assert ran.scores.max_deviation < 0.1 * original.scores.max_deviation
    plant = plant_of(cell, pose_noise=20 * UM, seed=5)
    original = simulate(cell, plant=plant)
    assert original.record.noise == 20 * UM
    assert compensated(cell, original, "learned", plant=plant).scores.max_deviation < 6 * UM


# --- The page ---
PAGE = pages.ROOT / "kr270_milling/guide/contributing/methods.md"
COMMANDS = [line for block in pages.blocks(PAGE) for line in block.commands]
QUICK = ["--set", "path.length_mm=30", "--set", "stock.grid_step_um=40", "--set", "exchange.micro_step_deg=3"]


@pytest.mark.parametrize("words", [line.split()[1:] for line in COMMANDS if line.startswith("kr270_milling")])
def test_the_commands_of_the_page_run_and_help(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for line in COMMANDS:
        if line.startswith("cat "):
            pages.run_here(line)
    assert main([*words, *QUICK, "--verdict", "0", "--json"]) == 0  # the verdict has separate tests
    answer = json.loads(capsys.readouterr().out)
    original, best = answer["passes"]
    assert original["name"] == "original" and best["name"] == answer["method"]
    assert best["max_deviation_um"] < 0.1 * original["max_deviation_um"]
    frequency = 6.69 * (1.1 if "--plant" in words else 1)
    assert answer["identified"]["modes"][0]["frequency_hz"] == pytest.approx(frequency, rel=0.03)


def test_a_method_that_makes_the_part_worse_says_so_beside_the_decision(tmp_path, capsys):
    sets = ("dynamics.reference_inertia=true", "dynamics.damping_ratio=0.04", "stock.grid_step_um=40")
    words = [part for pair in sets for part in ("--set", pair)]
    main(["compensate", "paper.yaml", "--method", "spline", "--verdict", "0", "--out", str(tmp_path / "out"), *words])
    worse = re.search(r"spline makes the part worse than no compensation \((\d+) um against", capsys.readouterr().out)
    assert 120 < int(worse[1]) < 140  # 131 um by an independent calculation of one mode
