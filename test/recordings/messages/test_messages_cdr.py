"""Serialised bytes, in both byte orders and damaged: stamps, series, trajectories, and definitions of types."""

import importlib.util
import itertools
import json
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from budget import budget
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import get_types_from_msg
from samples import recording_samples as made
from samples.recording_samples import JOINTS, PATH, POSE, STORE, TWIST, WRENCH, joints, pose, raw

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.export import rows
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages import definitions
from kr270_milling.recordings.messages.cdr import read_trajectory, stamp_of
from kr270_milling.recordings.messages.definitions import (
    RecordedTopic,
    definition,
    make_decoder,
    plain,
    starts_with_stamp,
    store_for,
    store_of,
    type_hash,
)
from kr270_milling.recordings.passes import series


def test_every_stamped_topic_of_the_table_gives_its_stamp_and_other_bytes_give_none():
    for topic in made.TOPICS.keys() - {"/robot_description"}:
        assert stamp_of(raw(made.sample(topic, 4321))) == 4321 * 500_000, topic
    for stamp, little in itertools.product((0, 1, 999_999_999, 10**9, 2**31 * 10**9 - 1), (True, False)):
        assert stamp_of(bytes(STORE.serialize_cdr(pose(stamp, np.zeros(7)), POSE, little_endian=little))) == stamp
    data = raw(pose(5, np.zeros(7)))
    assert stamp_of(data, schema_has_header=False) is None
    seconds, nanoseconds = b"\xff" * 8, bytes(4) + b"\xff" * 4  # second -1, 4.29 s of nanoseconds
    version_2 = b"\0\x07" + data[2:]
    for wrong in (data[:11], b"", b"\0\x01\0\0" + seconds, b"\0\x01\0\0" + nanoseconds, version_2):
        assert stamp_of(wrong) is None


# --- trajectories ---


def random_path(points: int, bodies: int = 1, speeds: bool = True):
    rng = np.random.default_rng(1)
    arrays = [rng.normal(size=(points, bodies, width)) for width in (3, 4, 6)]
    times = np.cumsum(rng.integers(1, 10**9, points))
    names = tuple(f"tool{i}" for i in range(bodies))
    return made.path(77, times.tolist(), *arrays[:2], arrays[2] if speeds else None, names), times, arrays


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


@given(st.integers(0, 400), st.binary(max_size=30))
@settings(max_examples=budget(300))
def test_a_damaged_trajectory_is_refused_or_read_within_its_bytes(cut, tail):
    data = raw(random_path(3)[0])[:cut] + tail
    try:
        actual = read_trajectory(data)
    except ValueError:
        return
    assert 20 * len(actual.time) <= len(data)


def test_points_with_and_without_velocities_may_mix_and_cost_no_more_than_their_size():
    message, times, (position, _, velocity) = random_path(6000)
    for i in np.flatnonzero(np.random.default_rng(2).random(6000) < 0.5):
        message.points[i].velocities.clear()
        velocity[i] = np.nan
    data = raw(message)
    begin = time.process_time()
    actual = read_trajectory(data)
    assert time.process_time() - begin < 2.0
    np.testing.assert_array_equal(actual.time, times)
    np.testing.assert_array_equal(actual.position, position)
    np.testing.assert_array_equal(actual.velocity, velocity)


def test_points_without_content_for_many_bodies_are_refused_before_room_is_made_for_them():
    """56 kB that would ask for 1 GB of NaN."""
    names, points = 4000, 1800
    head = struct.pack("<4BiII1s3xI", 0, 1, 0, 0, 0, 0, 1, b"\0", names) + struct.pack("<I1s3x", 1, b"\0") * names
    data = head + struct.pack("<I", points) + struct.pack("<IIIiI", 0, 0, 0, 0, 0) * points
    with pytest.raises(ValueError, match="leave out most of the 4000 bodies"):
        read_trajectory(data)


# --- series and tables of a recording ---


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
@pytest.mark.parametrize(
    ("kind", "build", "width"), [(POSE, pose, 7), (WRENCH, made.wrench, 6), (TWIST, made.twist, 6)]
)
def test_numbers_come_out_bit_for_bit_behind_frames_of_any_length(tmp_path, kind, build, width, little):
    values = np.random.default_rng(3).normal(size=(200, width))
    values[5, 2], values[6, 1] = np.nan, -np.inf
    stamps = np.cumsum(np.random.default_rng(4).integers(0, 10**10, 200))
    frames = ["base_link"] * 100 + ["ä" * (i % 13) + "b" * (i % 2) for i in range(100)]
    messages = [build(int(t), v, frame) for t, v, frame in zip(stamps, values, frames, strict=True)]
    with Recording(written(tmp_path / "a", kind, messages, little)) as recording:
        actual = series(recording, "/t")
        assert [frame for _, (_, _, frame, *_) in rows(recording, "/t")] == frames
    np.testing.assert_array_equal(actual.values, values)
    np.testing.assert_array_equal(actual.stamp, stamps)
    assert not actual.values.flags.writeable and not actual.stamp.flags.writeable


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
    assert len(actual.stamp) == 0 and actual.values.shape == (0, 7)
    longer = written(tmp_path / "b", WRENCH, [raw(pose(1, np.arange(7)))])
    with Recording(longer) as recording, pytest.raises(RecordingError, match="longer than its type"):
        series(recording, "/t")


@given(data=st.binary(max_size=120), kind=st.sampled_from([POSE, WRENCH, TWIST, JOINTS, PATH]), cut=st.integers(0, 200))
@settings(max_examples=budget(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_bytes_that_are_no_message_are_one_sentence(tmp_path_factory, data, kind, cut):
    good = raw(joints(1, [1, 2, 3])) if kind == JOINTS else raw(pose(1, np.arange(7)))
    with Recording(written(tmp_path_factory.mktemp("x") / "a", kind, [good[:cut] + data])) as recording:
        try:
            list(rows(recording, "/t")) if kind in (JOINTS, PATH) else series(recording, "/t")
        except RecordingError as error:
            assert "\n" not in str(error)


# --- definitions, against installed message packages and the parser of mcap-ros2-support ---


KINDS = sorted(set(made.TOPICS.values()))


def installed(name: str, ending: str) -> Path:
    """A type's file as its ROS package installs it."""
    package, _, short = name.split("/")
    spec = importlib.util.find_spec(package)
    if spec is None:
        pytest.skip("the message definitions of ROS are not installed")
    for root in Path(spec.submodule_search_locations[0]).parents:
        if (root / "share" / package / "msg" / (short + ending)).is_file():
            return root / "share" / package / "msg" / (short + ending)
    pytest.skip(f"no {short}{ending} is installed")


@pytest.mark.parametrize("name", KINDS)
def test_definition_and_hash_are_those_of_the_installed_package(name):
    text = installed(name, ".msg").read_text()
    assert get_types_from_msg(definition(name), name)[name][1] == get_types_from_msg(text, name)[name][1]
    hashes = json.loads(installed(name, ".json").read_text())["type_hashes"]
    assert type_hash(name) == next(entry["hash_string"] for entry in hashes if entry["type_name"] == name)
    assert starts_with_stamp(definition(name)) is (name != "std_msgs/msg/String")


def test_the_definition_is_enough_for_mcap_ros2_to_decode_a_message():
    for topic, kind in made.TOPICS.items():
        decoded = generate_dynamic(kind, definition(kind))[kind](raw(made.sample(topic, 2)))
        assert hasattr(decoded, next(iter(made.sample(topic, 2).__dataclass_fields__)))


def test_a_type_that_the_store_lacks_is_read_from_the_files_of_its_package(tmp_path, monkeypatch):
    folder = tmp_path / "share" / "shop_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Order.msg").write_text("std_msgs/Header header\nItem[] items # all\nint32 MOST=3\n")
    (folder / "Item.msg").write_text("string<=10 name\nfloat64[3] size\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    text = definition("shop_msgs/msg/Order")
    assert "MSG: shop_msgs/Item\nstring<=10 name\nfloat64[3] size\n" in text and "int32 MOST=3" in text
    assert type_hash("shop_msgs/msg/Order").startswith("RIHS01_") and starts_with_stamp(text)
    about = RecordedTopic("shop_msgs/msg/Order", 1, "cdr", text, "ros2msg", {})
    data = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0\0\0\0\1\0\0\0\2\0\0\0a\0" + bytes(6 + 24)
    assert plain(make_decoder("f", "/t", about)(data))["items"] == [{"name": "a", "size": [0.0, 0.0, 0.0]}]
    definitions.definition.cache_clear()


def test_a_name_without_definition_is_one_sentence():
    for name in ("geometry_msgs/PoseStamped", "../msg/Secret", "geometry_msgs/msg/../../x", "no_msgs/msg/Thing", ""):
        with pytest.raises(RecordingError) as error:
            definition(name)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("text, stamped", [
    ("# first\nint32 A=3\nHeader header\n", True), ("string<=10 name\nHeader header\n", False), ("", False),
    ("builtin_interfaces/Time[2] times\n", False), ("std_msgs/Header header # of all\n", True),
    ("int32 A=1\n" + "=" * 80 + "\nMSG: a/B\nHeader header\n", False),
])  # fmt: skip
def test_a_stamp_is_the_first_field_alone(text, stamped):
    assert starts_with_stamp(text) is stamped


@pytest.mark.parametrize("name, text", [
    ("a/msg/B", "a/C[1000000000] items\n" + "=" * 80 + "\nMSG: a/C\nuint8 x\n"),
    ("a/msg/B", "string[100000] items\n"), ("a/msg/B", "uint8[0] items\n"), ("a/msg/B", "uint8[-1] items\n"),
    ("a/msg/B", "B again\n"), ("a/msg/B", "B[] again\n"), ("a/msg/B", "Missing x\n"), ("a/msg/B", "float64 X=1e999\n"),
    ("a/msg/B", "float64 x\nfloat64 x\n"), ("a/msg/B", "no definition at all"), ("a/msg/1B", "int8 x\n"),
    ("__import__('os')", "int8 x\n"), ("a/msg/B", "x" * 300_000),
])  # fmt: skip
def test_a_definition_that_cannot_be_used_is_one_sentence(name, text):
    with pytest.raises(RecordingError, match="cannot be used|is not a"):
        make_decoder("f", "/t", RecordedTopic(name, 1, "cdr", text, "ros2msg", {}))(b"\0\1\0\0" + bytes(64))


def test_a_known_definition_is_that_of_the_store_and_another_one_its_own():
    name = "geometry_msgs/msg/Point"
    assert store_for(name, definition(name)) is store_of(name)
    assert store_for(name, "float32 x\n") is not store_of(name)
