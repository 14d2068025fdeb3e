"""Definitions, against the files that the message packages install and against mcap-ros2-support's own parser."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest
from mcap_ros2._dynamic import generate_dynamic
from recording_samples import TOPICS, raw, sample
from rosbags.typesys import get_types_from_msg

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.decode import RecordedTopic, make_decoder, store_for
from kr270_milling.recordings.messages import definitions
from kr270_milling.recordings.messages.definitions import definition, plain, starts_with_stamp, store_of, type_hash

KINDS = sorted(set(TOPICS.values()))


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
    for topic, kind in TOPICS.items():
        decoded = generate_dynamic(kind, definition(kind))[kind](raw(sample(topic, 2)))
        assert hasattr(decoded, next(iter(sample(topic, 2).__dataclass_fields__)))


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
