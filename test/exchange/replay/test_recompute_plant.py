"""Recordings of passes in which another cell cut than the one that planned: both are attached, all is recomputed."""

from __future__ import annotations

import numpy as np
import pass_recording as made
import pytest

from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.cell.plant import Plant
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.live.graph.processes import cell_text

pytestmark = made.needs_messages
PASSES = ("original", "learned_1", "learned_2")


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    """A softer arm with backlash, no friction and scatter, and a tracker with noise."""
    cell = made.cell_of("learned")
    arm = cell.arm.replace(joint_compliance=1.1 * cell.arm.joint_compliance, friction_torque=np.zeros(6))
    imperfections = cell.imperfections.replace(pose_noise=2e-6, repeatability=60e-6, backlash=np.full(6, 1e-5), seed=3)
    file = tmp_path_factory.mktemp("cell") / "plant.yaml"
    file.write_text(cell_text(Plant(cell, cell.replace(arm=arm), imperfections).cell))
    return read_cell(file)


@pytest.fixture(scope="module")
def recordings(plant, tmp_path_factory):
    """One recording a pass, as ``run --plant`` makes them."""
    folder = tmp_path_factory.mktemp("plant")
    for number, (name, messages) in enumerate(zip(PASSES, made.files_of("learned", PASSES, plant), strict=True)):
        of_pass = plant.replace(imperfections=plant.imperfections.replace(first_pass=number))
        attached = {"cell.yaml": made.cell_text("learned"), "plant.yaml": cell_text(of_pass)}
        made.write(folder / name, messages, attachments=attached)
    return folder


@pytest.mark.parametrize("name", PASSES)
def test_every_pass_is_identical_when_recomputed(recordings, name):
    replayed = recompute(recordings / name)
    assert replayed.verdict == "identical", (replayed.first, replayed.stops)
    assert replayed.channels["/tool_pose"].compared == made.STEPS
    assert replayed.channels["/reference_trajectory"].compared == 2


def test_the_passes_are_those_of_the_plain_loop(recordings, plant):
    cell = made.cell_of("learned")
    runs, by = Plant(cell, plant), compensator(cell, cell.target(), "learned")
    for name in PASSES:
        ran = simulate(cell, by.reference, name, plant=runs)
        recorded = pass_from_recording(recordings / name).scored
        assert np.array_equal(recorded.result.tool, ran.result.tool)
        assert np.array_equal(recorded.result.deflection, ran.result.deflection)
        assert recorded.scores == ran.scores
        by.revise(record_of(cell, ran))


def test_the_random_numbers_of_another_pass_are_a_difference(recordings, plant, tmp_path):
    attached = {"cell.yaml": made.cell_text("learned"), "plant.yaml": cell_text(plant)}
    later = plant.replace(imperfections=plant.imperfections.replace(first_pass=1))
    (messages,) = made.files_of("learned", ("r",), later)
    assert recompute(made.write(tmp_path / "r", messages, attachments=attached)).verdict == "different"


def test_a_run_attaches_the_plant_with_the_number_of_the_pass(plant, tmp_path):
    pytest.importorskip("rclpy")
    from kr270_milling.live.graph.processes import recording_parameters

    (tmp_path / "log").mkdir()
    attached = recording_parameters(made.cell_of("learned"), tmp_path, "learned_2", plant)["attach"]
    assert attached == [str(tmp_path / "cell.yaml"), str(tmp_path / "log" / "learned_2" / "plant.yaml")]
