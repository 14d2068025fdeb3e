from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_samples import JOINTS, POSE, STORE, TOPICS, joints, pose, raw, sample

from kr270_milling.recordings.messages.cdr import Cursor, stamp_of

TIMES = st.integers(0, 2**31 * 10**9 - 1)


@given(TIMES, st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20), st.booleans())
def test_stamp_is_read_from_the_bytes_in_both_byte_orders(stamp, frame, little):
    data = STORE.serialize_cdr(pose(stamp, np.zeros(7), frame), POSE, little_endian=little)
    assert stamp_of(bytes(data)) == stamp


@pytest.mark.parametrize("topic", [t for t in TOPICS if t != "/robot_description"])
def test_every_stamped_topic_of_the_table_gives_its_stamp(topic):
    assert stamp_of(raw(sample(topic, 4321))) == 4321 * 500_000


def test_no_stamp_where_there_is_none():
    data = raw(pose(5, np.zeros(7)))
    assert stamp_of(data, schema_has_header=False) is None
    assert stamp_of(data[:11]) is None
    assert stamp_of(b"") is None
    assert stamp_of(b"\0\x01\0\0" + b"\xff" * 8) is None  # second -1
    assert stamp_of(b"\0\x01\0\0" + b"\0\0\0\0" + b"\xff" * 4) is None  # 4.29 s of nanoseconds
    assert stamp_of(b"\0\x07" + data[2:]) is None  # version 2 of CDR


@pytest.mark.parametrize("little", [True, False])
def test_cursor_finds_strings_and_numbers_at_their_alignment(little):
    message = joints(7, [1.5, 2.5], names=["a", "bcd"])
    data = bytes(STORE.serialize_cdr(message, JOINTS, little_endian=little))
    cursor = Cursor(data)
    assert (cursor.number("i"), cursor.number("I"), cursor.string(), cursor.strings()) == (0, 7, "", ("a", "bcd"))
    assert [cursor.number("I"), cursor.number("d"), cursor.number("d")] == [2, 1.5, 2.5]
    assert [cursor.number("I"), cursor.number("I"), cursor.offset] == [0, 0, len(data)]


@given(st.binary(max_size=60))
def test_cursor_refuses_bytes_that_end_too_early_and_never_reads_beyond(data):
    try:
        cursor = Cursor(data)
        cursor.number("i"), cursor.number("I"), cursor.string(), cursor.strings(), cursor.number("d")
    except ValueError:
        return
    assert cursor.offset <= len(data)
