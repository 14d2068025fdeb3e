from __future__ import annotations

import time
from types import SimpleNamespace

import pytest
import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from kr270_milling.recordings.bag.bagmeta import DEFAULT_QOS, describe_qos, qos_text, read_qos

FOREVER = QosTime(9223372036, 854775807)


def latched() -> Qos:
    return Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, FOREVER, FOREVER,
               QosLiveliness.AUTOMATIC, FOREVER, False)  # fmt: skip


def test_a_profile_reads_back_in_rosbags():
    text = qos_text([{"depth": 1, "durability": "transient_local"}])
    assert parse_qos(text) == [latched()]


def test_a_profile_is_written_as_rosbags_writes_it():
    assert [describe_qos({"depth": 1, "durability": "transient_local"})] == dump_qos_v9([latched()])


def test_a_profile_object_of_rclpy_is_described():
    qos = pytest.importorskip("rclpy.qos", reason="rclpy is not installed")
    profile = qos.QoSProfile(depth=7, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
    found = describe_qos(profile)
    assert (found["history"], found["depth"], found["durability"]) == ("keep_last", 7, "transient_local")
    assert list(found) == list(DEFAULT_QOS)
    assert found["deadline"] == dict(sec=0, nsec=0)
    assert yaml.safe_load(qos_text([profile])) == [found]


def test_a_misspelt_policy_is_refused():
    with pytest.raises(KeyError, match="durabilty"):
        describe_qos({"durabilty": "volatile"})


def test_durations_are_given_in_nanoseconds_or_as_they_stand():
    assert describe_qos({"deadline": 1_500_000_000})["deadline"] == dict(sec=1, nsec=500_000_000)
    assert describe_qos({"deadline": dict(sec=2, nsec=3)})["deadline"] == dict(sec=2, nsec=3)
    lease = SimpleNamespace(nanoseconds=4)
    assert describe_qos({"liveliness_lease_duration": lease})["liveliness_lease_duration"] == dict(sec=0, nsec=4)


@pytest.mark.parametrize("text", ["", "3", "[1, 2]", "a: b", "{", "!!python/object:os.system x", "[" * 5000])
def test_foreign_text_in_place_of_profiles_is_no_profile(text):
    assert read_qos(text) == []


def test_merged_keys_that_double_with_every_line_are_no_profile_and_take_no_time():
    lines = ["- &a0 {a: b}", *(f"- &a{i + 1} {{<<: [*a{i}, *a{i}]}}" for i in range(24))]
    begin = time.process_time()
    assert read_qos("\n".join(lines)) == []
    assert time.process_time() - begin < 1.0


def test_what_rosbag2_of_other_versions_writes_is_read():
    deadline = "deadline:\n    sec: 9223372036\n    nsec: 854775807"
    older = f"- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  {deadline}"
    assert read_qos(older)[0]["deadline"] == dict(sec=9223372036, nsec=854775807)
