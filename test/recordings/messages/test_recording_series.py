"""Series of numbers out of a recording, bit for bit, and from bytes that are no message."""

from __future__ import annotations

import time

import numpy as np
import pytest
from budget import budget
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_samples import JOINTS, POSE, STORE, TWIST, WRENCH, joints, pose, raw, twist, wrench

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.export import rows
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import series, stamped
from kr270_milling.recordings.bag.writer import BagWriter

RELAXED = settings(max_examples=budget(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def written(directory, type_name, messages, little=True):
    """A recording of one topic "/t" with the given messages, or bytes."""
    with BagWriter(directory) as writer:
        writer.add_topic("/t", type_name)
        for i, message in enumerate(messages):
            if not isinstance(message, bytes):
                message = bytes(STORE.serialize_cdr(message, type_name, little_endian=little))
            writer.write("/t", message, i, log_time=i)
    return directory


@pytest.mark.parametrize("little", [True, False])
@pytest.mark.parametrize(("type_name", "build", "width"), [(POSE, pose, 7), (WRENCH, wrench, 6), (TWIST, twist, 6)])
def test_numbers_come_out_bit_for_bit(tmp_path, type_name, build, width, little):
    values = np.random.default_rng(3).normal(size=(200, width))
    values[5, 2], values[6, 1] = np.nan, -np.inf
    stamps = np.cumsum(np.random.default_rng(4).integers(0, 10**10, 200))
    messages = [build(int(t), v, "base_link") for t, v in zip(stamps, values, strict=True)]
    with Recording(written(tmp_path / "a", type_name, messages, little)) as recording:
        actual = series(recording, "/t")
    np.testing.assert_array_equal(actual.values, values)
    np.testing.assert_array_equal(actual.stamp, stamps)
    assert not actual.values.flags.writeable and not actual.stamp.flags.writeable


@given(st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12), min_size=1, max_size=30))
@RELAXED
def test_frames_of_any_length_do_not_move_the_numbers(tmp_path_factory, frames):
    values = np.arange(7.0 * len(frames)).reshape(-1, 7)
    messages = [pose(i, v, frame) for i, (v, frame) in enumerate(zip(values, frames, strict=True))]
    with Recording(written(tmp_path_factory.mktemp("x") / "a", POSE, messages)) as recording:
        actual = series(recording, "/t")
        assert [frame for _, _, frame, _ in stamped(recording, "/t")] == frames
    np.testing.assert_array_equal(actual.values, values)


def joint_table(directory, messages) -> dict[str, list]:
    """The columns of a topic with joint states."""
    actual: dict[str, list] = {}
    with Recording(written(directory, JOINTS, messages)) as recording:
        for names, cells in rows(recording, "/t"):
            for name, cell in zip(names, cells, strict=True):
                actual.setdefault(name, []).append(cell)
    return actual


def test_joint_states_with_and_without_velocities(tmp_path):
    rng = np.random.default_rng(5)
    position, velocity, effort = rng.normal(size=(3, 100, 6))
    messages = [joints(i, position[i], velocity[i] if i % 2 else (), effort[i] if i > 50 else ()) for i in range(100)]
    actual = joint_table(tmp_path / "a", messages)
    with pytest.raises(RecordingError, match="names 2 joints and gives 3 values of position"):
        joint_table(tmp_path / "b", [joints(0, [1, 2, 3], names=["a", "b"])])
    velocity[::2], effort[:51] = np.nan, np.nan
    assert actual["stamp_ns"] == list(range(100))
    for kind, unit, expected in (("position", "rad", position), ("velocity", "rad_per_s", velocity),
                                 ("effort", "n_m", effort)):  # fmt: skip
        columns = [actual[f"{kind}_joint_{i}_{unit}"] for i in range(1, 7)]
        np.testing.assert_array_equal(np.transpose(columns), expected)


def test_a_topic_without_messages_has_empty_arrays_and_other_topics_are_refused(tmp_path):
    with Recording(written(tmp_path / "a", POSE, [])) as recording:
        actual = series(recording, "/t")
        with pytest.raises(RecordingError):
            series(recording, "/u")
        with pytest.raises(RecordingError):
            list(stamped(recording, "/u"))
    assert len(actual.stamp) == 0 and actual.values.shape == (0, 7)


@given(data=st.binary(max_size=120), kind=st.sampled_from([POSE, WRENCH, TWIST, JOINTS]), cut=st.integers(0, 200))
@RELAXED
def test_bytes_that_are_no_message_are_one_sentence(tmp_path_factory, data, kind, cut):
    good = raw(joints(1, [1, 2, 3])) if kind == JOINTS else raw(pose(1, np.arange(7)))
    with Recording(written(tmp_path_factory.mktemp("x") / "a", kind, [good[:cut] + data])) as recording:
        try:
            list(rows(recording, "/t")) if kind == JOINTS else series(recording, "/t")
        except RecordingError as error:
            assert "\n" not in str(error)


def test_30000_poses_are_read_in_less_than_a_second(tmp_path):
    body = raw(pose(0, np.arange(7)))
    with Recording(written(tmp_path / "a", POSE, [body] * 30_000)) as recording:
        begin = time.process_time()
        actual = series(recording, "/t")
        assert time.process_time() - begin < 1.0
    np.testing.assert_array_equal(actual.values, np.tile(np.arange(7.0), (30_000, 1)))
