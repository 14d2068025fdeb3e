"""The table of topics as ROS needs it: ``topics.TOOL_POSE`` has message class, name and quality of service.

Names from users and files are checked before ROS gets them, so that the error is a sentence of this package.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import re
from pathlib import Path
from typing import NamedTuple

from rclpy.exceptions import NameValidationException
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_topic_name import validate_topic_name

from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.recordings.messages.topics import TOPICS


@functools.cache
def message_class(type_name: str) -> type:
    """Return the class of a message type such as geometry_msgs/msg/Pose. Raises MillingError.

    The name may come from a foreign file: only packages of messages are imported.
    """
    parts = re.fullmatch(r"([A-Za-z][A-Za-z0-9_]*)/msg/([A-Za-z][A-Za-z0-9_]*)", type_name)
    if parts is None:
        raise MillingError(f"{type_name!r} is not the name of a message type, such as std_msgs/msg/String")
    package, name = parts.groups()
    spec = importlib.util.find_spec(package)  # imports nothing for a top-level package
    places = (spec.submodule_search_locations if spec is not None else None) or []
    if not any(Path(place, "msg", "__init__.py").is_file() for place in places):
        raise MillingError(f"the message package {package} is not installed")
    kind = getattr(importlib.import_module(f"{package}.msg"), name, None)
    if kind is None or not hasattr(kind, "SLOT_TYPES"):
        raise MillingError(f"the message package {package} has no {name}")
    return kind


def resolved_topic(node, name: str, where: str) -> str:
    """Return the full name of a topic from a user. Raises InputError; where: the place of the name."""
    try:
        validate_topic_name(name)
        return node.resolve_topic_name(name)
    except (NameValidationException, RuntimeError, ValueError, TypeError):
        what = "must be the name of a topic: letters, digits and '_', in parts between '/' that begin with no digit"
        raise InputError(where, f"{name!r} {what}") from None


def full_namespace(name: str, where: str) -> str:
    """Return a namespace from a user with its first slash. Raises InputError; where: the place of the name."""
    full = "/" + name.removeprefix("/")
    try:
        validate_namespace(full)
    except (NameValidationException, ValueError, TypeError):
        what = "must be a ROS namespace: letters, digits and '_', in parts between '/' that begin with no digit"
        raise InputError(where, f"{name!r} {what}") from None
    return full


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
