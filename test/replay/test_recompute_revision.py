"""The compensator's part of a recording: what it revised, once more from the recorded wrench and pose."""

from __future__ import annotations

import shutil

import numpy as np
import pass_recording as made
import pytest
from pass_recording import STEPS, flip

from kr270_milling.base.errors import RecordingError
from kr270_milling.replay.compensate import compensate
from kr270_milling.replay.recompute import recompute
from kr270_milling.trajectory.trajectory import Trajectory

pytestmark = made.needs_messages


def test_a_changed_revised_reference_is_found(tmp_path):
    messages = made.changed(made.one_pass(), "reference_trajectory", 1, flip(-1 - 100))
    found = recompute(made.write(tmp_path / "r", messages))
    assert found.first.topic == "/reference_trajectory" and found.first.index == 1
    assert found.first.field.startswith("points[")


@pytest.mark.parametrize("method", ["linear", "spline", "mirror", "learned"])
def test_several_passes_in_one_file_are_told_apart(tmp_path, method):
    found = recompute(made.write(tmp_path / "r", made.one_pass(method, 1, 3), cell=made.cell_text(method)))
    assert found.verdict == "identical", (found.first, found.stops)
    assert found.channels["/wrench"].compared == 3 * STEPS
    assert found.channels["/reference_trajectory"].compared == 4


@pytest.mark.parametrize("method", ["linear", "spline", "mirror"])
def test_a_pass_along_a_revised_reference_needs_no_earlier_pass(tmp_path, method):
    messages = made.one_pass(method, 1, 2)
    start = [i for i, m in enumerate(messages) if m.topic == "reference_trajectory"][1]
    found = recompute(made.write(tmp_path / "r", messages[start:], cell=made.cell_text(method)))
    assert found.verdict == "identical", (found.first, found.stops)
    reference = found.channels["/reference_trajectory"]
    assert (reference.given, reference.compared) == (1, 1)
    assert found.channels["/joint_trajectory"].compared == 2


def later_pass_of_learned(finished: bool | None) -> list:
    """The second pass of "learned" with what its compensator told in /diagnostics before it."""
    messages = list(made.one_pass("learned", 1, 2))
    start = [i for i, m in enumerate(messages) if m.topic == "reference_trajectory"][1]
    if finished is None:
        return messages[start:]
    told = {"method": "learned", "finished": str(finished)}
    return [made.diagnostics("/trajectory_compensator", told), *messages[start:]]


@pytest.mark.parametrize("finished", [False, None])
def test_learned_goes_on_from_all_passes_and_a_file_of_one_does_not_decide_it(tmp_path, finished):
    messages = later_pass_of_learned(finished)
    found = recompute(made.write(tmp_path / "r", messages, cell=made.cell_text("learned")))
    assert found.verdict == "incomplete" and found.first is None
    assert found.channels["/wrench"].compared == STEPS
    assert found.channels["/reference_trajectory"].compared == 0
    assert all("the passes before this one" in s.reason for s in found.stops)


def test_every_pass_of_learned_is_recomputed_with_the_recordings_beside_it(tmp_path):
    """Its revision needs all passes: they lie in one folder, each in a recording of its own, in whatever order."""
    messages, passes = made.one_pass("learned", 1, 3), ["c", "a", "b"]
    starts = [i for i, m in enumerate(messages) if m.topic == "reference_trajectory"]
    for name, start, end in zip(passes, starts, starts[1:], strict=False):
        made.write(tmp_path / name, messages[start : end + 2], cell=made.cell_text("learned"))
    for name in passes:
        found = recompute(tmp_path / name)
        assert found.verdict == "identical", (found.first, found.stops)
        assert found.channels["/reference_trajectory"].compared == 1 + (name == "c")
    shutil.rmtree(tmp_path / "c")
    assert recompute(tmp_path / "b").verdict == "incomplete"


FOREIGN = np.linspace(0, 48_000_000, 7).astype(np.int64)  # [ns], knots; those of the pass end at 60 ms


def with_reference_of_another(method: str, latched: bool) -> list:
    """A pass and, latched before it or in the middle of one that broke off, what another compensator published."""
    target, messages = made.cell_of(method).target(), list(made.one_pass(method))
    other = Trajectory(FOREIGN, target.sample(FOREIGN), target.sample_orientation(FOREIGN))
    before = [] if latched else messages[:200]
    return [*before, made.Message("reference_trajectory", made.reference_data(other), 0), *messages[2:]]


@pytest.mark.parametrize("latched", [True, False])
@pytest.mark.parametrize("method", ["learned", "inverse"])
def test_no_revision_follows_from_a_reference_with_other_knots_than_the_target(tmp_path, method, latched):
    bag = made.write(tmp_path / "r", with_reference_of_another(method, latched), cell=made.cell_text(method))
    found = recompute(bag)
    told = [(stop.stamp_ns, "7 knots in 0.048 s" in stop.reason) for stop in found.stops]
    assert found.verdict != "identical" and (48_000_000, True) in told
    with pytest.raises(RecordingError, match="7 knots in 0.048 s.* at the times of the target's"):
        compensate(bag)


@pytest.mark.parametrize("last_wrench", [True, False])
def test_a_method_that_cannot_revise_a_recorded_pass_says_why(tmp_path, last_wrench):
    messages = with_reference_of_another("linear", latched=True)
    messages = [m for m in messages if last_wrench or (m.topic, m.stamp) != ("wrench", 48_000_000)]
    with pytest.raises(RecordingError, match="at the times of the target's"):
        compensate(made.write(tmp_path / "r", messages), "inverse")


def test_learned_keeps_its_reference_when_it_has_finished(tmp_path):
    messages = later_pass_of_learned(finished=True)
    kept = next(m for m in messages if m.topic == "reference_trajectory").data
    messages = made.changed(messages, "reference_trajectory", 1, lambda data: kept)
    messages = made.changed(messages, "joint_trajectory", 1, lambda data: next(
        m.data for m in messages if m.topic == "joint_trajectory"))  # fmt: skip
    found = recompute(made.write(tmp_path / "r", messages, cell=made.cell_text("learned")))
    assert found.verdict == "identical" and found.channels["/reference_trajectory"].compared == 1


@pytest.mark.parametrize(("version", "verdict"), [("0.1.0", "incomplete"), ("0.2.0", "different")])
def test_what_another_algorithm_of_the_same_name_revised_is_taken_as_it_is(tmp_path, monkeypatch, version, verdict):
    """What "linear" revised stands for what "learned" of version 0.1.0 did: today's makes something else of it."""
    monkeypatch.setattr("kr270_milling.bag.writer.__version__", version)
    found = recompute(made.write(tmp_path / "r", made.one_pass("linear"), cell=made.cell_text("learned")))
    assert found.verdict == verdict and found.channels["/joint_trajectory"].compared == 2
    taken = [stop.reason for stop in found.stops if "another algorithm in version 0.1.0" in stop.reason]
    assert len(taken) == found.channels["/reference_trajectory"].given == (version == "0.1.0")


@pytest.mark.parametrize("method", ["linear", "spline", "mirror"])
def test_the_compensator_makes_of_a_recording_what_was_published(tmp_path, method):
    messages = made.one_pass(method)
    (revised,) = compensate(made.write(tmp_path / "r", messages, cell=made.cell_text(method)))
    published = [m.data for m in messages if m.topic == "reference_trajectory"]
    assert revised.published is True and revised.method == method
    assert made.reference_data(revised.reference) == published[1] != published[0]


def test_another_method_may_be_asked_of_a_recording(tmp_path):
    directory = made.write(tmp_path / "r", made.one_pass("linear"))
    (revised,) = compensate(directory, "spline")
    expected = [m.data for m in made.one_pass("spline") if m.topic == "reference_trajectory"][1]
    assert revised.published is None and made.reference_data(revised.reference) == expected


def test_a_broken_off_pass_gives_no_revision(tmp_path):
    directory = made.write(tmp_path / "r", made.one_pass()[:100])
    with pytest.raises(RecordingError, match="no complete pass"):
        compensate(directory)
