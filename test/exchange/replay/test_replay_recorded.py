"""A pass out of its recording, for scores and reports."""

from __future__ import annotations

import dataclasses
import struct
import time

import pass_recording as made
import pytest

from kr270_milling.base.errors import RecordingError
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.messages.codec import to_bytes

pytestmark = made.needs_messages
EXCHANGE = ("tool_pose", "wrench", "deflection")


def later(message: made.Message, stamp: int) -> made.Message:
    head = struct.pack("<iI", stamp // 10**9, stamp % 10**9)
    return dataclasses.replace(message, data=message.data[:4] + head + message.data[12:], stamp=stamp)


def test_what_is_stamped_behind_the_end_of_the_reference_is_no_part_of_the_pass(tmp_path):
    """A hole of 2e9 s would be some 1e14 micro-steps of the tool."""
    messages = list(made.one_pass())
    last = {m.topic: m for m in messages}
    far = [later(last[topic], 2 * 10**9 * 10**9) for topic in EXCHANGE]
    plain = pass_from_recording(made.write(tmp_path / "plain", messages))  # and compile
    begin = time.process_time()
    result = pass_from_recording(made.write(tmp_path / "far", [*messages, *far]))
    assert time.process_time() - begin < 5.0
    assert repr(result.scored.row() | {"name": "plain"}) == repr(plain.scored.row()) and result.complete  # with NaN
    assert result.messages_lost == plain.messages_lost == 0


def test_a_recording_with_its_end_and_a_hole_before_is_not_complete(tmp_path):
    messages = made.changed(made.one_pass(), "wrench", 40, lambda data: None)
    result = pass_from_recording(made.write(tmp_path / "r", messages))
    assert result.messages_lost == result.lost_to_end == 1 and not result.complete


def test_a_reference_of_an_implausible_duration_is_refused(tmp_path):
    reference = Trajectory([0, 2 * 10**18], [[0, 0, 0], [1e-3, 0, 0]], [[1, 0, 0, 0]] * 2)
    messages = [made.Message("reference_trajectory", to_bytes(reference), 0), *made.one_pass()[made.LATCHED_FIRST :]]
    with pytest.raises(RecordingError, match="its reference trajectory takes 2e"):
        pass_from_recording(made.write(tmp_path / "r", messages))


def test_one_of_two_robots_is_chosen_by_its_namespace(tmp_path):
    bag = made.write(tmp_path / "r", made.one_pass(), namespaces=("/left", "/right"))
    with pytest.raises(RecordingError, match="name a namespace"):
        pass_from_recording(bag)
    for name in ("left", "/right", "right/"):
        assert pass_from_recording(bag, namespace=name).complete
