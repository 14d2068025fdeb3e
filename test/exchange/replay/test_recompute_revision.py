"""The compensator's part of a recording: what it revised, once more from the passes that its state names."""

from __future__ import annotations

import dataclasses
import shutil

import numpy as np
import pass_recording as made
import pytest
from pass_recording import STEPS, files_of, flip, one_pass, recomputed

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.samples import PoseSample
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.cell_file import cell_text
from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.cell.plant import Plant
from kr270_milling.exchange.replay.compensate import compensate_recording
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.messages.codec import from_bytes, to_bytes

pytestmark = made.needs_messages
BODY = 12  # offset behind the stamp of a reference, which is the start of the next pass
NAMES = ("c", "a", "b")  # in another order than that of the alphabet


def folder_of(directory, method: str = "learned"):
    """One recording a pass, as ``run`` makes them."""
    for name, messages in zip(NAMES, files_of(method, NAMES), strict=True):
        made.write(directory / name, messages, cell=made.cell_text(method))
    return directory


def with_state(messages, index: int, **changes) -> list:
    """The messages with other fields in one state of the compensator."""

    def change(data: bytes) -> bytes:
        state = from_bytes(made.STATE, data)
        learned = state.learned
        if "last" in changes:
            learned = (*learned[:-1], learned[-1]._replace(**changes["last"]))
        others = {key: value for key, value in changes.items() if key != "last"}
        return to_bytes(dataclasses.replace(state, learned=learned, **others))

    return made.changed(messages, "compensator_state", index, change)


def test_of_a_changed_wrench_and_what_follows_from_it_the_wrench_is_named(tmp_path):
    messages = made.changed(one_pass("mirror"), "wrench", 60, flip(made.force_offset(1) + 6))
    result = recomputed(tmp_path / "r", messages, cell=made.cell_text("mirror"))
    assert (result.first.topic, result.first.index) == ("/wrench", 60)
    assert result.channels["/compensator_state"].differing == result.channels["/reference_trajectory"].differing == 1


@pytest.mark.parametrize("method", ["spline", "learned"])
def test_several_passes_in_one_file_are_distinguished(tmp_path, method):
    result = recomputed(tmp_path / "r", one_pass(method, 1, 3), cell=made.cell_text(method))
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels["/wrench"].compared == 3 * STEPS
    assert result.channels["/reference_trajectory"].compared == result.channels["/compensator_state"].compared == 4


@pytest.mark.parametrize("method", ["linear", "mirror", "learned"])
def test_every_pass_is_recomputed_with_the_recordings_that_its_state_names(tmp_path, method):
    folder_of(tmp_path, method)
    for name in NAMES:
        result = recompute(tmp_path / name)
        assert result.verdict == "identical", (result.first, result.stops)
        assert result.channels["/reference_trajectory"].compared == 2
        assert [revised.published for revised in compensate_recording(tmp_path / name)] == [True]


def test_recordings_in_one_directory_are_named_by_their_files_and_a_missing_one_is_named(tmp_path):
    folder_of(tmp_path / "run")
    for name in NAMES:
        shutil.copy(tmp_path / "run" / name / f"{name}.mcap", tmp_path / f"{name}.mcap")
    assert recompute(tmp_path / "b.mcap").verdict == "identical"
    for lost in ("c", "a"):
        shutil.move(tmp_path / "run" / lost, tmp_path / "away")
        result = recompute(tmp_path / "run" / "b")
        assert result.verdict == "incomplete" and result.first is None
        assert f"{lost}/{lost}.mcap is missing" in str(result.stops[0]) and len(result.stops) == 1
        assert result.channels["/wrench"].compared == STEPS
        assert result.channels["/reference_trajectory"].given == result.channels["/compensator_state"].given == 2
        with pytest.raises(RecordingError, match=f"{lost}/{lost}.mcap is missing"):
            compensate_recording(tmp_path / "run" / "b")
        shutil.move(tmp_path / "away", tmp_path / "run" / lost)


def test_another_pass_in_the_place_of_a_named_one_is_no_substitute_and_another_place_is_not_opened(tmp_path):
    folder_of(tmp_path)
    shutil.rmtree(tmp_path / "a")
    made.write(tmp_path / "a", files_of("linear", ("a",))[0][:-200], cell=made.cell_text("learned"))
    result = recompute(tmp_path / "b")
    assert result.verdict == "incomplete" and "does not hold the pass" in str(result.stops[0])
    # a state makes us open recordings beside this one alone
    for name in ("", "..", "../c.mcap", "/etc/passwd", "c/\n.mcap", "x" * 3000, "c"):
        shutil.rmtree(tmp_path / "a")
        messages = with_state(files_of("learned", NAMES)[1], 0, last={"recording": name})
        result = recomputed(tmp_path / "a", messages, cell=made.cell_text("learned"))
        assert result.verdict == "incomplete" and result.first is None, name


def test_a_method_that_is_chosen_between_two_passes_starts_from_the_named_pass(tmp_path):
    """As ``run`` does: the reference of ``spline`` follows from the original pass, not from that of ``linear``."""
    compensator, files = made.CompensatorProtocol(made.cell_of()), {}
    latched = made.messages(compensator.begin(made.cell_of().target()))
    for name, method in (("original", None), ("linear", "linear"), ("spline", "spline")):
        if method is not None:
            latched = made.messages(compensator.choose(method))
        files[name] = [*latched, *made.pass_along(compensator, f"{name}/{name}.mcap")]
        made.write(tmp_path / name, files[name])
    state = next(m.data for m in files["spline"] if m.topic == "compensator_state")
    assert [one.recording for one in from_bytes(made.STATE, state).learned] == ["original/original.mcap"]
    for name in files:
        assert recompute(tmp_path / name).verdict == "identical", name
    together = [message for messages in files.values() for message in messages]  # one recorder, one file
    result = recompute(made.write(tmp_path / "all", together))
    assert result.verdict == "identical" and result.channels["/compensator_state"].compared == 6


def test_a_revision_without_the_last_wrench_is_recomputed_without_it(tmp_path):
    """The live node gave the last wrench up; the recorder has it."""
    cell, whole = made.cell_of("mirror"), list(one_pass("mirror"))
    last = max(i for i, m in enumerate(whole) if m.topic == "wrench")
    compensator = made.CompensatorProtocol(cell)
    compensator.begin(cell.target())
    compensator.recording = "r/r.mcap"
    for message in whole[:last]:
        if message.topic in ("tool_pose", "wrench"):
            sample = from_bytes(made.TYPES[message.topic], message.data)
            (compensator.pose if isinstance(sample, PoseSample) else compensator.wrench)(sample)
    revised = made.messages(compensator.finish())
    result = recompute(made.write(tmp_path / "r", [*whole[: -len(revised)], *revised], cell=made.cell_text("mirror")))
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels["/compensator_state"].compared == 2


@pytest.mark.parametrize(("index", "changes", "verdict", "sentence"), [
    (1, {"finished": True}, "different", "values[2].value"),
    (1, {"reference": "00000000"}, "different", "values[4].value"),
    (1, {"last": {"fingerprint": "00" * 32}}, "different", "values[6].value"),
    (1, {"method": "spline"}, "different", ""),
    (1, {"last": {"poses": STEPS - 3}}, "incomplete", f"received {STEPS - 3} poses"),  # the compensator missed some
    (0, {"target": "00000000"}, "incomplete", "the target trajectory 00000000"),
])  # fmt: skip
def test_a_state_that_the_recording_does_not_lead_to_is_a_difference_and_one_of_other_messages_is_reported(
    tmp_path, index, changes, verdict, sentence
):
    result = recomputed(tmp_path / "r", with_state(one_pass(), index, **changes))
    assert result.verdict == verdict
    if verdict == "incomplete":
        assert sentence in str(result.stops[0])
    elif sentence:
        assert result.first.topic == "/compensator_state" and result.first.field.startswith(sentence)


def test_references_without_states_are_taken_as_recorded(tmp_path):
    result = recomputed(tmp_path / "r", [m for m in one_pass() if m.topic != "compensator_state"])
    assert result.verdict == "incomplete" and "without its compensator_state" in str(result.stops[0])
    assert result.channels["/reference_trajectory"].given == 2
    assert compensate_recording(tmp_path / "r")[0].published is True  # the cell states the method


def foreign(method: str) -> made.Message:
    """A reference of another compensator, with other knots than the pass, which end before its end."""
    knots = np.linspace(0, 48_000_000, 7).astype(np.int64)  # [ns]
    target = made.cell_of(method).target()
    reference = Trajectory(knots, target.sample(knots), target.sample_orientation(knots))
    return made.Message("reference_trajectory", to_bytes(reference), 0)


@pytest.mark.parametrize("place", [0, 200])
def test_a_reference_of_another_compensator_is_not_called_identical(tmp_path, place):
    messages = list(one_pass("inverse"))
    messages.insert(place, foreign("inverse"))
    assert recomputed(tmp_path / "r", messages, cell=made.cell_text("inverse")).verdict != "identical"


def test_a_pass_that_a_method_cannot_revise_is_refused_with_the_reason(tmp_path):
    stateless = [m for m in files_of("learned", NAMES)[1] if m.topic != "compensator_state"]
    other = [foreign("linear"), *(m for m in one_pass() if m.topic in ("tool_pose", "wrench"))]
    for messages, cell, method, sentence in (
        (stateless, "learned", None, "learned needs the passes before this one"),
        (other, "linear", "inverse", "at the times of the target's"), (one_pass()[:100], "mirror", None, "no complete"),
    ):  # fmt: skip
        with pytest.raises(RecordingError, match=sentence):
            compensate_recording(made.write(tmp_path / cell, messages, cell=made.cell_text(cell)), method)


def test_a_recording_is_revised_by_its_own_or_by_another_method(tmp_path):
    directory = made.write(tmp_path / "r", one_pass("linear"))
    for method, published in (("linear", True), ("spline", None)):
        (revised,) = compensate_recording(directory, method)
        _, expected = (m.data for m in one_pass(method) if m.topic == "reference_trajectory")
        assert revised.published is published and revised.method == method
        assert to_bytes(revised.reference)[BODY:] == expected[BODY:]


# --- Recordings of passes in which another cell cut than the one that planned: both are attached, all is recomputed ---


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


def test_the_passes_are_those_of_the_plain_loop_and_identical_when_recomputed_with_their_random_numbers(
    plant, tmp_path
):
    """One recording a pass, as ``run --plant`` makes them."""
    cell = made.cell_of("learned")
    runs, by = Plant(cell, plant), compensator(cell, cell.target(), "learned")
    for number, (name, messages) in enumerate(zip(PASSES, files_of("learned", PASSES, plant), strict=True)):
        of_pass = plant.replace(imperfections=plant.imperfections.replace(first_pass=number))
        attached = {"cell.yaml": made.cell_text("learned"), "plant.yaml": cell_text(of_pass)}
        replayed = recomputed(tmp_path / name, messages, attachments=attached)
        assert replayed.verdict == "identical", (replayed.first, replayed.stops)
        assert replayed.channels["/tool_pose"].compared == made.STEPS
        assert replayed.channels["/reference_trajectory"].compared == 2
        ran = simulate(cell, by.reference, name, plant=runs)
        recorded = pass_from_recording(tmp_path / name).scored
        assert np.array_equal(recorded.result.tool, ran.result.tool)
        assert np.array_equal(recorded.result.deflection, ran.result.deflection)
        assert recorded.scores == ran.scores
        by.revise(record_of(cell, ran))
    other = {"cell.yaml": made.cell_text("learned"), "plant.yaml": cell_text(plant)}
    later = plant.replace(imperfections=plant.imperfections.replace(first_pass=1))
    (messages,) = files_of("learned", ("r",), later)
    assert recomputed(tmp_path / "r", messages, attachments=other).verdict == "different"


def test_a_run_attaches_the_plant_with_the_number_of_the_pass(plant, tmp_path):
    pytest.importorskip("rclpy")
    from kr270_milling.live.graph.processes import recording_parameters

    (tmp_path / "log").mkdir()
    attached = recording_parameters(made.cell_of("learned"), tmp_path, "learned_2", plant)["attach"]
    assert attached == [str(tmp_path / "cell.yaml"), str(tmp_path / "log" / "learned_2" / "plant.yaml")]
