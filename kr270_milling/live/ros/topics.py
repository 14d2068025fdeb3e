"""The table of topics as ROS needs it: ``topics.TOOL_POSE`` has message class, name and quality of service."""

from __future__ import annotations

from typing import NamedTuple

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from kr270_milling.live.ros.names import message_class
from kr270_milling.recordings.messages.topics import TOPICS

__all__ = ["BY_NAME", "EVERY", "LATCHED", "LOOP", "RosTopic"]

#: the loop of one exchange: lockstep, one message in flight; the publisher's history is so long that a recorder which
#: was stopped for two seconds can still request the messages that it missed
LOOP = QoSProfile(depth=20_000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
#: a subscriber that must lose nothing: it takes no message that it has no room for, so that the publisher, which keeps
#: the message in its history, sends it again. If a subscriber is half as quick and stops for 3 s, 30,000 of 30,000
#: poses arrive where the publisher waits for ``wait_for_all_acked`` every 1000, 25,451 where it does not
EVERY = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
#: late subscribers receive the last message
LATCHED = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class RosTopic(NamedTuple):
    """Unpacks into the arguments of ``create_publisher``."""

    type: type
    name: str
    qos: QoSProfile


#: name without slash -> topic
BY_NAME = {t.key: RosTopic(message_class(t.type), t.name, LATCHED if t.latched else LOOP) for t in TOPICS}


def __getattr__(name: str) -> RosTopic:
    """Return a topic by its name in capitals."""
    try:
        return BY_NAME[name.lower()]
    except KeyError:
        raise AttributeError(f"the table of topics has no {name.lower()}") from None
