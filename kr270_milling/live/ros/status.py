"""The status of a node for programs: one latched topic a node."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

from rclpy.node import Node

from kr270_milling.base.errors import MessageError
from kr270_milling.live.ros import topics

__all__ = ["Status", "subscribe_status"]


@dataclass(frozen=True)
class Status:
    """What a node publishes as JSON on ``~/status`` five times a second and at every change."""

    pid: int
    level: int  #: as in diagnostic_msgs/DiagnosticStatus
    message: str
    error: str = ""  #: last message of the level ERROR: a status may replace the one before on its way
    listeners: dict[str, int] = field(default_factory=dict)  #: matched subscribers of each topic that it publishes
    sources: dict[str, int] = field(default_factory=dict)  #: matched publishers of each topic that it subscribes to
    stamps_ns: dict[str, int] = field(default_factory=dict)  #: last stamp of topics that it publishes, reads or records
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
