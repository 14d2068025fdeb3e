"""Names that come from users and from files, checked before ROS sees them, which answers with exceptions of its own."""

from __future__ import annotations

import importlib
import importlib.util
import re
from pathlib import Path

from rclpy.exceptions import NameValidationException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.validate_namespace import validate_namespace

from kr270_milling.base.errors import InputError, MillingError

__all__ = ["NameRefused", "full_namespace", "message_class", "plain_topic", "resolved_topic"]

TYPE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/msg/([A-Za-z][A-Za-z0-9_]*)")
TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


class NameRefused(MillingError):
    """A topic or a message type that cannot be used here."""


def message_class(type_name: str) -> type:
    """The class of a message type such as geometry_msgs/msg/Pose. Raises NameRefused.

    The name may come from a foreign file: nothing is imported that is not a package of messages.
    """
    parts = TYPE.fullmatch(type_name)
    if parts is None:
        raise NameRefused(f"{type_name!r} is not the name of a message type, such as std_msgs/msg/String")
    package, name = parts.groups()
    found = importlib.util.find_spec(package)  # of a package at the top this imports nothing
    places = (found.submodule_search_locations if found is not None else None) or []
    if not any(Path(place, "msg", "__init__.py").is_file() for place in places):
        raise NameRefused(f"the message package {package} is not installed")
    kind = getattr(importlib.import_module(f"{package}.msg"), name, None)
    if kind is None or not hasattr(kind, "SLOT_TYPES"):
        raise NameRefused(f"the message package {package} has no {name}")
    return kind


def plain_topic(topic: str) -> str:
    """A topic as a file names it, without anything to be substituted. Raises NameRefused."""
    if TOPIC.fullmatch(topic) is None or len(topic) > 200:
        raise NameRefused("this is not the name of a topic")
    return topic


def resolved_topic(node, name: str, where: str) -> str:
    """The full name of a topic that a user gave. Raises InputError, which tells where."""
    try:
        return node.resolve_topic_name(name)
    except (rclpy_implementation.RCLError, NameValidationException, ValueError, TypeError):
        what = "must be the name of a topic: letters, digits and '_', in parts between '/' that begin with no digit"
        raise InputError(where, f"{name!r} {what}") from None


def full_namespace(name: str, where: str) -> str:
    """A namespace that a user gave, with its first slash. Raises InputError, which tells where."""
    full = "/" + name.removeprefix("/")
    try:
        validate_namespace(full)
    except (NameValidationException, ValueError, TypeError):
        what = "must be a ROS namespace: letters, digits and '_', in parts between '/' that begin with no digit"
        raise InputError(where, f"{name!r} {what}") from None
    return full
