"""rosbag2's description of a recording: QoS profiles and ``metadata.yaml`` (version 9, as in Jazzy)."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable, Mapping

import yaml

from kr270_milling.base import parameter_file as config_file
from kr270_milling.base.errors import ConfigError
from kr270_milling.base.units import SECOND

__all__ = ["all_latched", "bag_information", "describe_qos", "qos_text", "read_qos", "yaml_text"]

INFINITE = 2**63 - 1  # [ns]; rosbag2's duration without limit
#: the default profile of a topic; the order is rosbag2's
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
    """Return one QoS profile in the form of rosbag2.

    profile: an object with the attributes of rclpy's QoSProfile, or a mapping; its missing keys take the default, its
    durations are in ns or {sec, nsec}.
    """
    if isinstance(profile, Mapping):
        unknown = sorted(set(profile) - set(DEFAULT_QOS))
        if unknown:
            raise KeyError(f"{', '.join(unknown)} is not part of a QoS profile")
        values = {**DEFAULT_QOS, **profile}
    else:
        values = {key: getattr(profile, key) for key in DEFAULT_QOS}
    return {key: _plain(key, values[key]) for key in DEFAULT_QOS}


def _plain(key: str, value):
    if key in ("deadline", "lifespan", "liveliness_lease_duration") and not isinstance(value, Mapping):
        seconds, nanoseconds = divmod(int(getattr(value, "nanoseconds", value)), SECOND)
        return dict(sec=seconds, nsec=nanoseconds)
    return value.name.lower() if hasattr(value, "name") else value


def qos_text(profiles: Iterable) -> str:
    """Return the channel metadata ``offered_qos_profiles``: a YAML list of profiles."""
    return yaml_text([describe_qos(p) for p in profiles]).strip()


def yaml_text(value) -> str:
    """Return YAML without anchors, which are legal but which other readers may not know."""
    repeated = json.loads(json.dumps(value))  # equal parts are separate objects
    return yaml.dump(repeated, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), sort_keys=False)


def all_latched(profiles: list[dict]) -> bool:
    """Return whether every profile of a topic is that of a latched publisher."""
    # rosbag2 writes words since Jazzy and the numbers of the middleware before
    return bool(profiles) and all(profile.get("durability") in ("transient_local", 1) for profile in profiles)


@functools.lru_cache(maxsize=32)
def read_qos(text: str) -> list[dict]:
    """Return the profiles in the metadata of a channel, unchanged; an empty list for a text that lists no mappings."""
    try:
        profiles = config_file.parse(text[:100_000], "", "offered_qos_profiles")
    except ConfigError:
        return []
    return profiles if isinstance(profiles, list) and all(isinstance(p, dict) for p in profiles) else []


def bag_information(file_name: str, channels: Iterable, start: int, end: int, custom: dict[str, str]) -> dict:
    """Return the content of ``metadata.yaml`` for one MCAP file.

    channels: the writer's WrittenChannel objects. start, end: first and last log time [ns]; 0 without messages.
    """
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
    starting = {"nanoseconds_since_epoch": start if count else INFINITE}
    duration = {"nanoseconds": end - start if count else 0}
    return dict(
        version=9,
        storage_identifier="mcap",
        duration=duration,
        starting_time=starting,
        message_count=count,
        topics_with_message_count=topics,
        compression_format="",  # of whole files or messages; chunks are compressed separately
        compression_mode="",
        relative_file_paths=[file_name],
        files=[dict(path=file_name, starting_time=starting, duration=duration, message_count=count)],
        custom_data=custom,
        ros_distro="jazzy",
    )
