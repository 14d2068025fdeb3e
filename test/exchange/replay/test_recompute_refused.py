"""A recompute refuses what the live nodes refused, and continues."""

from __future__ import annotations

import dataclasses

import numpy as np
import pass_recording as made
import pytest
from pass_recording import STEPS

from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.exchange.replay.compensate import compensate_recording
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.recordings.messages.codec import to_bytes

pytestmark = made.needs_messages
AT = 30_000_000  # [ns]
ONE, DOWN = np.ones(3), np.array([1.0, 0.0, 0.0, 0.0])
REFUSED = {
    "wrench of NaN": ("wrench", WrenchSample(AT, "workpiece", np.full(6, np.nan))),
    "wrench in another frame": ("wrench", WrenchSample(AT, "base_link", np.ones(6))),
    "infinite wrench of another time": ("wrench", WrenchSample(7 * AT, "workpiece", np.full(6, np.inf))),
    "pose of NaN": ("tool_pose", PoseSample(AT, "workpiece", np.full(3, np.nan), DOWN)),
    "pose in another frame": ("tool_pose", PoseSample(AT, "flange", ONE, DOWN)),
    "pose of before": ("tool_pose", PoseSample(AT - 10_000_000, "workpiece", ONE, DOWN)),
}


def disturbed(topic: str, data: bytes) -> list:
    """A pass with a foreign message in its middle."""
    messages = list(made.one_pass())
    at = next(i for i, m in enumerate(messages) if m.topic == topic and m.stamp == AT)
    messages.insert(at, made.Message(topic, data, AT))
    return messages


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("job", ["recompute", "compensate"])
def test_one_message_that_the_live_nodes_refused_does_not_spoil_a_recording(tmp_path, name, job):
    topic, sample = REFUSED[name]
    directory = made.write(tmp_path / "r", disturbed(topic, to_bytes(sample)))
    if job == "compensate":
        assert compensate_recording(directory)[0].published is True
        return
    result = recompute(directory)
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels[f"/{topic}"].refused == 1
    assert result.channels["/wrench"].compared == result.channels["/deflection"].compared == STEPS


@pytest.mark.parametrize("place", [0, 150])
def test_a_reference_in_another_frame_does_not_spoil_a_recording_at_any_place(tmp_path, place):
    messages = list(made.one_pass())
    foreign = dataclasses.replace(made.cell_of().target(), frame="base_link")
    messages.insert(place, made.Message("reference_trajectory", to_bytes(foreign), 0))
    result = recompute(made.write(tmp_path / "r", messages))
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels["/reference_trajectory"].refused == 1
    assert result.channels["/wrench"].compared == STEPS


@pytest.mark.parametrize("topic", ["wrench", "tool_pose"])
def test_bytes_that_are_no_message_are_refused_alike(tmp_path, topic):
    result = recompute(made.write(tmp_path / "r", disturbed(topic, b"\0\1\0\0" + bytes(10))))
    assert result.verdict == "identical" and result.channels[f"/{topic}"].refused == 1


def test_a_wrench_that_is_spoiled_where_it_was_recorded_is_no_refused_one(tmp_path):
    """The live robot continued with it, so the recording differs from the sent message, or lacks the message."""
    messages = made.changed(made.one_pass(), "wrench", 60, lambda _: to_bytes(REFUSED["wrench of NaN"][1]))
    assert recompute(made.write(tmp_path / "r", messages)).verdict != "identical"
