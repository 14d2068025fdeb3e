"""Bytes of a message that are no field of it, but are compared."""

from __future__ import annotations

import pass_recording as made
import pytest

from kr270_milling.exchange.replay.recompute import recompute

pytestmark = made.needs_messages
INDEX = 40  # of the wrench that is changed
TERMINATOR = 4 + 8 + 4 + len("workpiece")  # behind encapsulation, stamp, length and text of frame_id


def first_difference(directory, offset: int, bit: int):
    """Where one bit of a wrench is flipped; the wrench itself is the first difference, and the only one."""
    messages = made.changed(made.one_pass(), "wrench", INDEX, made.flip(offset, bit))
    result = recompute(made.write(directory, messages))
    assert result.verdict == "different" and result.channels["/wrench"].differing == 1
    assert (result.first.topic, result.first.index, result.first.stamp_ns) == ("/wrench", INDEX, INDEX * 500_000)
    return result.first


@pytest.mark.parametrize("bit", [0, 1, 7])
@pytest.mark.parametrize("offset", [2, 3])
def test_a_flipped_bit_in_the_options_of_the_encapsulation_is_named(tmp_path, offset, bit):
    first = first_difference(tmp_path / "r", offset, bit)
    assert first.field == "options of the encapsulation" and first.recomputed == b"\0\0"
    assert first.recorded == made.flip(offset - 2, bit)(b"\0\0")


@pytest.mark.parametrize("bit", [0, 1, 7])
def test_a_frame_whose_terminator_is_not_nul_is_named(tmp_path, bit):
    first = first_difference(tmp_path / "r", TERMINATOR, bit)
    assert first.field == "the message" and "string terminator" in first.recorded
