"""Stamps, texts and trajectories out of serialised bytes, in both byte orders and from damaged ones."""

from __future__ import annotations

import itertools
import struct
import time

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_samples import JOINTS, PATH, POSE, STORE, TOPICS, joints, path, pose, raw, sample

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.export import rows
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.cdr import Cursor, stamp_of
from kr270_milling.recordings.messages.trajectory import read_trajectory

TIMES = st.integers(0, 2**31 * 10**9 - 1)


@given(TIMES, st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20), st.booleans())
def test_stamp_is_read_from_the_bytes_in_both_byte_orders(stamp, frame, little):
    data = STORE.serialize_cdr(pose(stamp, np.zeros(7), frame), POSE, little_endian=little)
    assert stamp_of(bytes(data)) == stamp


def test_every_stamped_topic_of_the_table_gives_its_stamp_and_other_bytes_give_none():
    for topic in TOPICS.keys() - {"/robot_description"}:
        assert stamp_of(raw(sample(topic, 4321))) == 4321 * 500_000, topic
    data = raw(pose(5, np.zeros(7)))
    assert stamp_of(data, schema_has_header=False) is None
    assert stamp_of(data[:11]) is None
    assert stamp_of(b"") is None
    assert stamp_of(b"\0\x01\0\0" + b"\xff" * 8) is None  # second -1
    assert stamp_of(b"\0\x01\0\0" + b"\0\0\0\0" + b"\xff" * 4) is None  # 4.29 s of nanoseconds
    assert stamp_of(b"\0\x07" + data[2:]) is None  # version 2 of CDR


def test_cursor_reads_strings_and_numbers_at_their_alignment():
    message = joints(7, [1.5, 2.5], names=["a", "bcd"])
    for little in (True, False):
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


def random_path(points: int, bodies: int = 1, speeds: bool = True, seed: int = 1):
    rng = np.random.default_rng(seed)
    arrays = [rng.normal(size=(points, bodies, width)) for width in (3, 4, 6)]
    times = np.cumsum(rng.integers(1, 10**9, points))
    names = tuple(f"tool{i}" for i in range(bodies))
    return path(77, times.tolist(), *arrays[:2], arrays[2] if speeds else None, names), times, arrays


@pytest.mark.parametrize("bodies", [1, 2, 3])
@pytest.mark.parametrize("points", [0, 1, 2, 200])
def test_every_number_of_a_trajectory_comes_out(points, bodies):
    for speeds, little in itertools.product((True, False), repeat=2):
        message, times, (position, quaternion, velocity) = random_path(points, bodies, speeds)
        actual = read_trajectory(bytes(STORE.serialize_cdr(message, PATH, little_endian=little)))
        np.testing.assert_array_equal(actual.time, times)
        np.testing.assert_array_equal(actual.position, position)
        np.testing.assert_array_equal(actual.quaternion, quaternion)
        np.testing.assert_array_equal(actual.velocity, velocity if speeds else np.full_like(velocity, np.nan))
        assert np.isnan(actual.acceleration).all()
        names = tuple(f"tool{i}" for i in range(bodies))
        assert (actual.stamp, actual.frame_id, actual.names) == (77, "workpiece", names)


@given(st.lists(st.booleans(), min_size=1, max_size=60))
def test_points_with_and_without_velocities_may_mix(with_speed):
    message, times, (position, _, velocity) = random_path(len(with_speed))
    for i, speed in enumerate(with_speed):
        if not speed:
            message.points[i].velocities.clear()
            velocity[i] = np.nan
    actual = read_trajectory(raw(message))
    np.testing.assert_array_equal(actual.time, times)
    np.testing.assert_array_equal(actual.position, position)
    np.testing.assert_array_equal(actual.velocity, velocity)


def test_200000_points_take_less_than_a_second():
    """The bytes are laid out here point by point: 128 bytes each from the second on."""
    count = 200_000
    point = struct.pack("<I7dI4x6dIiI", 1, *range(7), 1, *range(6), 0, 3, 4)
    assert len(point) == 4 + 56 + 4 + 4 + 48 + 4 + 8
    head = struct.pack("<4BiII1s3xII5s3xI", 0, 1, 0, 0, 0, 0, 1, b"\0", 1, 5, b"tool\0", count)
    assert (len(head) - 4) % 8 == 4  # so that the first transform needs no padding either
    data = head + count * point
    begin = time.process_time()
    actual = read_trajectory(data)
    assert time.process_time() - begin < 1.0
    assert actual.time.tolist() == [3_000_000_004] * count
    np.testing.assert_array_equal(actual.velocity[:, 0], np.tile(np.arange(6.0), (count, 1)))


@given(st.integers(0, 400), st.binary(max_size=30))
@settings(max_examples=budget(300))
def test_a_damaged_message_is_refused_or_read_within_its_bytes(cut, tail):
    data = raw(random_path(3)[0])
    try:
        actual = read_trajectory(data[:cut] + tail)
    except ValueError:
        return
    assert 20 * len(actual.time) <= len(data[:cut] + tail)


def test_a_message_made_to_change_its_layout_all_the_time_costs_no_more_than_its_size():
    message, times, _ = random_path(6000)
    for point in message.points[::2]:
        point.velocities.clear()
    data = raw(message)
    begin = time.process_time()
    assert read_trajectory(data).time.tolist() == times.tolist()
    assert time.process_time() - begin < 2.0


def test_trajectories_of_a_recording_are_tables_up_to_one_that_is_none(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/reference_trajectory", PATH)
        for points in (2, 5):
            writer.write("/reference_trajectory", raw(random_path(points)[0]), 0)
        writer.write("/reference_trajectory", raw(pose(100, np.zeros(7))), 0)
    with Recording(tmp_path / "a") as recording:
        actual = rows(recording, "/reference_trajectory")
        assert [next(actual)[1][0] for _ in range(7)] == [0, 0, 1, 1, 1, 1, 1]  # number of the message
        with pytest.raises(RecordingError, match="is not a trajectory_msgs"):
            next(actual)


def test_points_without_content_for_many_bodies_are_refused_before_room_is_made_for_them():
    """56 kB that would ask for 1 GB of NaN."""
    names, points = 4000, 1800
    head = struct.pack("<4BiII1s3xI", 0, 1, 0, 0, 0, 0, 1, b"\0", names) + struct.pack("<I1s3x", 1, b"\0") * names
    data = head + struct.pack("<I", points) + struct.pack("<IIIiI", 0, 0, 0, 0, 0) * points
    assert len(data) < 70_000
    with pytest.raises(ValueError, match="leave out most of the 4000 bodies"):
        read_trajectory(data)
