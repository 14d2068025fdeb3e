"""The status of a node for programs, one latched topic a node, and whether a pass may start by these statuses."""

from __future__ import annotations

import fnmatch
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from rclpy.node import Node

from kr270_milling.base.errors import MessageError
from kr270_milling.live.ros import topics
from kr270_milling.recordings.messages.topics import COMPENSATOR, CUT, RECORDER, ROBOT

__all__ = ["Status", "is_recorded", "subscribe_status", "unmatched"]

ONLY_BY_NAME = ("/rosout", "/parameter_events")
STATUSES = tuple(f"/{node}/status" for node in (ROBOT, CUT, COMPENSATOR, RECORDER))


@dataclass(frozen=True)
class Status:
    """What a node publishes as JSON on ``~/status`` five times a second and at every change."""

    pid: int
    level: int  #: as in diagnostic_msgs/DiagnosticStatus
    message: str
    error: str = ""  #: last message of the level ERROR: a status may replace the one before on its way
    listeners: dict[str, int] = field(default_factory=dict)  #: matched subscribers of each topic that it publishes
    sources: dict[str, int] = field(default_factory=dict)  #: matched publishers of each topic that it subscribes to
    stamps_ns: dict[str, int] = field(default_factory=dict)  #: last stamp of each topic that it publishes, or records
    values: dict[str, Any] = field(default_factory=dict)

    def to_msg(self):
        """Return the status as a message."""
        return topics.STATUS.type(data=json.dumps(asdict(self)))

    @classmethod
    def from_msg(cls, msg) -> Status:
        """Return the status of a message. Raises MessageError where the text is no status."""
        try:
            return cls(**json.loads(msg.data))
        except (ValueError, TypeError):
            raise MessageError(f"status: {msg.data[:60]!r} is not the status of a node") from None


def subscribe_status(node: Node, name: str, callback):
    """Subscribe to the status of the node ``name``, relative to the namespace of ``node``."""
    topic = topics.STATUS
    return node.create_subscription(topic.type, topic.name.replace("~", name), callback, topic.qos)


def is_recorded(topic: str, patterns: Sequence[str]) -> bool:
    """Return whether a recorder with these patterns (none: every topic) records a topic."""
    if topic in patterns or topic.endswith(STATUSES):
        return topic in patterns
    return any(fnmatch.fnmatchcase(topic, p) for p in patterns) if patterns else topic not in ONLY_BY_NAME


def unmatched(statuses: Mapping[str, Status]) -> str:
    """Return what the nodes of a pass lack, in a few words; empty when the pass may start.

    Every subscriber and every publisher of a topic have discovered each other, a recorder has all topics, and all nodes
    have the same reference. statuses: by node.
    """
    for publisher, status in statuses.items():
        for topic, count in status.listeners.items():
            wanted = [node for node in statuses if node != publisher and _reads(statuses[node], topic)]
            for node in wanted:
                if not statuses[node].sources.get(topic):
                    return f"{node} has not discovered a publisher of {topic}"
            if count < len(wanted):
                return f"{publisher} has not discovered every subscriber of {topic}"
    for key in ("reference", "recording"):
        values = {node: status.values[key] for node, status in statuses.items() if key in status.values}
        if len(set(values.values())) > 1:
            return f"not every node has the {key}: {values}"
    return ""


def _reads(status: Status, topic: str) -> bool:
    """Return whether a node subscribes to a topic; ``records`` are the patterns of a recorder with an open file."""
    patterns, left_out = status.values.get("records"), status.values.get("left_out", ())
    return topic in status.sources or (patterns is not None and topic not in left_out and is_recorded(topic, patterns))
