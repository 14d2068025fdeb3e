from __future__ import annotations

import pytest
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import get_types_from_msg
from test_recording_samples import STORE, TOPICS, raw, sample

from kr270_milling.bag.errors import RecordingError
from kr270_milling.messages.schemas import Field, fields, schema_text, starts_with_stamp, type_hash

KINDS = sorted(set(TOPICS.values()))


def definitions(name: str) -> dict:
    """What rosbags knows of a type and all that it needs, from its own copy of the definitions."""
    text, _ = STORE.generate_msgdef(name, ros_version=2)
    return get_types_from_msg(text, name)


@pytest.mark.parametrize("name", KINDS)
def test_schema_text_means_the_same_to_rosbags_as_its_own_definition(name):
    assert get_types_from_msg(schema_text(name), name) == definitions(name)


@pytest.mark.parametrize("name", KINDS)
def test_type_hash_is_the_one_that_rosbags_computes_from_the_structure(name):
    assert type_hash(name) == STORE.hash_rihs01(name)


@pytest.mark.parametrize("topic", sorted(TOPICS))
def test_schema_text_is_enough_for_mcap_ros2_to_decode_a_message(topic):
    kind = TOPICS[topic]
    decoded = generate_dynamic(kind, schema_text(kind))[kind](raw(sample(topic, 2)))
    first = next(iter(sample(topic, 2).__dataclass_fields__))
    assert hasattr(decoded, first)


def test_separators_are_80_signs_and_every_dependency_stands_once():
    text = schema_text("geometry_msgs/msg/PoseStamped")
    heads = [line for line in text.splitlines() if line.startswith("MSG: ")]
    needed = "std_msgs/Header builtin_interfaces/Time geometry_msgs/Pose geometry_msgs/Point geometry_msgs/Quaternion"
    assert sorted(heads) == sorted(f"MSG: {name}" for name in needed.split())
    assert text.count("=" * 80 + "\n") == len(heads)


def test_types_outside_of_the_topic_table_are_found_too():
    assert "MSG: lifecycle_msgs/State" in schema_text("lifecycle_msgs/msg/TransitionEvent")


@pytest.mark.parametrize(
    "name", ["geometry_msgs/PoseStamped", "../msg/Secret", "geometry_msgs/msg/../../x", "no_such_msgs/msg/Thing", ""]
)
def test_a_name_without_definition_is_one_sentence(name):
    with pytest.raises(RecordingError) as error:
        schema_text(name)
    assert "\n" not in str(error.value)


def test_fields_skip_constants_comments_and_keep_bounds():
    text = "# first\nint32 A=3\nstring<=10[<=5] names # why\nPose[3] poses\nfloat64 x 1.5\nHeader header\nuint8 B = 7\n"
    assert fields(text, "geometry_msgs") == (
        Field("names", "string", "<=10[<=5]"),
        Field("poses", "geometry_msgs/msg/Pose", "[3]"),
        Field("x", "float64", ""),
        Field("header", "std_msgs/msg/Header", ""),
    )


def test_only_a_string_topic_of_the_table_has_no_stamp():
    assert [k for k in KINDS if not starts_with_stamp(k, schema_text(k))] == ["std_msgs/msg/String"]
