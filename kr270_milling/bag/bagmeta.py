"""What rosbag2 wants to know beside the messages: QoS profiles and ``metadata.yaml`` (version 9, as in Jazzy)."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any

import yaml

from kr270_milling.base import parameter_file as config_file
from kr270_milling.base.errors import ConfigError
from kr270_milling.base.units import SECOND

__all__ = ["bag_information", "describe_qos", "qos_text", "read_qos", "yaml_text"]

INFINITE = 2**63 - 1  # [ns], as rosbag2 writes a duration without limit
DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")
#: a topic's profile where the caller states nothing; the order is rosbag2's
DEFAULT_QOS = dict(
    history="keep_last",
    depth=10,
    reliability="reliable",
    durability="volatile",
    deadline=INFINITE,
    lifespan=INFINITE,
    liveliness="automatic",
    liveliness_lease_duration=INFINITE,
    avoid_ros_namespace_conventions=False,
)


def describe_qos(profile) -> dict:
    """One QoS profile as rosbag2 writes it: from a mapping (missing keys take the default, durations are in ns or
    already {sec, nsec}), or from an object with the attributes of rclpy's QoSProfile."""
    if isinstance(profile, Mapping):
        unknown = sorted(set(profile) - set(DEFAULT_QOS))
        if unknown:
            raise KeyError(f"{', '.join(unknown)} is no part of a QoS profile")
        given = {**DEFAULT_QOS, **profile}
    else:
        given = {key: getattr(profile, key) for key in DEFAULT_QOS}
    return {key: _plain(key, given[key]) for key in DEFAULT_QOS}


def _plain(key: str, value):
    if key in DURATIONS and not isinstance(value, Mapping):
        seconds, nanoseconds = divmod(int(getattr(value, "nanoseconds", value)), SECOND)
        return dict(sec=seconds, nsec=nanoseconds)
    return value.name.lower() if hasattr(value, "name") else value


def qos_text(profiles: Iterable) -> str:
    """The channel metadata ``offered_qos_profiles``: a YAML list of profiles."""
    return yaml_text([describe_qos(p) for p in profiles]).strip()


Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _WithoutAnchors(Dumper):
    """Writes what stands twice twice: anchors are legal YAML that other readers need not know."""

    def ignore_aliases(self, data) -> bool:
        return True


def yaml_text(value) -> str:
    return yaml.dump(value, Dumper=_WithoutAnchors, sort_keys=False)


@functools.lru_cache(maxsize=32)
def read_qos(text: str) -> list[dict]:
    """The profiles in a channel's metadata, which stay as they are; none where a foreign text lists no mappings."""
    try:
        profiles = config_file.parse(text[:100_000], "", "offered_qos_profiles")
    except ConfigError:
        return []
    return profiles if isinstance(profiles, list) and all(isinstance(p, dict) for p in profiles) else []


def bag_information(file_name: str, channels: Iterable, start: int, end: int, custom: dict[str, str]) -> dict:
    """The content of ``metadata.yaml`` for one MCAP file; channels: as the writer has them; start, end: first and last
    log time [ns], of which only a file with messages has any."""
    topics = [
        dict(
            topic_metadata=dict(
                name=channel.topic,
                type=channel.type,
                serialization_format=channel.encoding,
                offered_qos_profiles=channel.qos,
                type_description_hash=channel.hash,
            ),
            message_count=channel.count,
        )
        for channel in channels
    ]
    count = sum(topic["message_count"] for topic in topics)
    begins = {"nanoseconds_since_epoch": start if count else INFINITE}
    lasts = {"nanoseconds": end - start if count else 0}
    return dict(
        version=9,
        storage_identifier="mcap",
        duration=lasts,
        starting_time=begins,
        message_count=count,
        topics_with_message_count=topics,
        compression_format="",  # of whole files or messages; the chunks inside have their own
        compression_mode="",
        relative_file_paths=[file_name],
        files=[dict(path=file_name, starting_time=begins, duration=lasts, message_count=count)],
        custom_data=custom,
        ros_distro="jazzy",
    )
