"""Message types: rosbags' store of the types of ROS 2 Jazzy, and ``.msg`` files that packages install.

Messages of any type are objects with their fields as attributes: slow, but for every type.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import math
import os
import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from kr270_milling.base.errors import RecordingError

TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Za-z][A-Za-z0-9_]*)")
STAMPS = ("Header", "std_msgs/Header", "std_msgs/msg/Header", "builtin_interfaces/Time", "builtin_interfaces/msg/Time")


@functools.cache
def jazzy_store():
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


@functools.cache
def store_of(type_name: str):
    """The type store that knows an installed type. Raises RecordingError."""
    if not TYPE_NAME.fullmatch(type_name):
        raise RecordingError(type_name, 'this is not the name of a message type like "geometry_msgs/msg/PoseStamped"')
    if type_name not in jazzy_store().fielddefs:
        _register(type_name)
    return jazzy_store()


def _register(type_name: str) -> None:
    """Add a type and the types of its fields to the store, from the files of their packages."""
    from rosbags.typesys import get_types_from_msg

    types, waiting = {}, [type_name]
    while waiting:
        name = waiting.pop()
        if name in types or name in jazzy_store().fielddefs:
            continue
        try:
            types.update(get_types_from_msg(_file(name).read_text(encoding="utf-8"), name))
        except Exception as error:
            raise RecordingError(name, "its definition cannot be used") from error
        waiting += [kind for _, is_message, kind, _ in members(types[name]) if is_message]
    jazzy_store().register(types)


def _file(type_name: str) -> Path:
    """The ``.msg`` file of a type: beside the Python package in a wheel, an overlay or /opt/ros."""
    package, _, name = type_name.split("/")
    spec = importlib.util.find_spec(package)
    roots = [root for place in (spec and spec.submodule_search_locations) or [] for root in Path(place).parents]
    roots += [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    files = [root / "share" / package / "msg" / f"{name}.msg" for root in roots]
    for file in filter(Path.is_file, files):
        return file
    raise RecordingError(type_name, f"there is no {name}.msg; the message package {package} is not installed")


@functools.cache
def definition(type_name: str) -> str:
    """The definition of a type followed by those of all types in it ("ros2msg"). Raises RecordingError."""
    return store_of(type_name).generate_msgdef(type_name, ros_version=2)[0]


@functools.cache
def type_hash(type_name: str) -> str:
    """The RIHS01 hash of a type. Raises RecordingError."""
    return store_of(type_name).hash_rihs01(type_name)


def members(fields) -> Iterator[tuple[str, bool, str, float | None]]:
    """Yield for each field: name, whether it holds messages, type of its items, length of a list (infinite: any)."""
    from rosbags.interfaces import Nodetype

    for name, kind in fields[1]:
        (inner, about), length = kind[1] if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, None)
        length = math.inf if kind[0] == Nodetype.SEQUENCE else length
        yield name, inner == Nodetype.NAME, about if inner == Nodetype.NAME else about[0], length


def starts_with_stamp(text: str) -> bool:
    """Return whether the bytes of a message begin with a time: a Header, or a Time as in Clock, is the first field."""
    for line in text.splitlines():
        words = line.split("#", 1)[0].replace("<=", " ").split()
        if line.startswith("===="):
            return False
        if words and "=" not in "".join(words):
            return words[0] in STAMPS
    return False


def deserialise(type_name: str, data: bytes):
    """A message as an object with its fields as attributes. Raises ValueError for other bytes."""
    return read_message(store_of(type_name), type_name, data)


def read_message(store, type_name: str, data: bytes):
    """Decode a message; raises ValueError. Bytes after the last field are ignored: rmw_fastrtps leaves up to 76."""
    from rosbags.serde import SerdeError

    if len(data) < 4 or data[0] != 0 or data[1] > 1:
        raise ValueError("not plain CDR of version 1")
    about = store.get_msgdef(type_name)
    read = about.deserialize_cdr_le if data[1] else about.deserialize_cdr_be
    try:
        return read(data[4:], 0, about.cls, store)[0]
    except (SerdeError, IndexError, ValueError, struct.error) as error:
        raise ValueError(f"is not a {type_name}: {error}") from None


@dataclasses.dataclass(frozen=True)
class RecordedTopic:
    """A topic of a recording; ``schema`` is the message definition."""

    type: str
    count: int
    encoding: str
    schema: str
    schema_encoding: str
    metadata: dict[str, str]


@functools.lru_cache(maxsize=64)
def store_for(type_name: str, text: str):
    """A type store that knows a type as the text of a recording defines it; an unusable text raises any error."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if not TYPE_NAME.fullmatch(type_name) or len(text) > 256 * 1024:  # characters of a definition
        raise ValueError(f"{type_name[:80]!r} is not defined by {len(text)} characters")
    types = get_types_from_msg(text, type_name)
    if all(jazzy_store().fielddefs.get(name) == fields for name, fields in types.items()):
        return jazzy_store()
    for name, is_message, kind, length in (member for fields in types.values() for member in members(fields)):
        # rosbags generates a line of code for each item of an array of fixed length of texts or messages
        most = 1000 if is_message or kind == "string" else 2**31
        if length not in (None, math.inf) and not 1 <= length <= most:
            raise ValueError(f"{name} is an array of {length} items")
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def make_decoder(path, name: str, topic: RecordedTopic) -> Callable[[bytes], object]:
    """A function from the bytes of a message to an object with the fields as attributes.

    path, name: of the file and the topic, for messages. Both functions raise RecordingError.
    """
    if topic.encoding != "cdr" or topic.schema_encoding != "ros2msg":
        what = f"{topic.encoding or 'an unnamed encoding'} with a {topic.schema_encoding or 'missing'} schema"
        raise RecordingError(path, f"{name} holds {what}, but only cdr with ros2msg can be decoded")
    try:
        store = store_for(topic.type, topic.schema)
        store.get_msgdef(topic.type)
    except Exception as error:
        raise RecordingError(path, f"the definition of {topic.type} cannot be used") from error
    limited = _has_lists(store, topic.type)

    def decode(data: bytes):
        # [bytes] of a message with lists of messages or texts: Python's objects take about twenty times as much
        most_objects = 4 * 1024 * 1024
        if limited and len(data) > most_objects:
            reason = f"a message on {name} has {len(data)} bytes, more than {most_objects} to be decoded"
            raise RecordingError(path, reason)
        try:
            return read_message(store, topic.type, data)
        except (ValueError, MemoryError, RecursionError) as error:
            raise RecordingError(path, f"a message on {name} is not a {topic.type}") from error

    return decode


def _has_lists(store, type_name: str, outer: frozenset = frozenset()) -> bool:
    """Return whether a message may hold a list of messages or texts, itself or in a message within it."""
    for _, is_message, kind, length in members(store.fielddefs[type_name]):
        if length == math.inf and (is_message or kind == "string"):
            return True
        if is_message and kind not in outer and _has_lists(store, kind, outer | {type_name}):
            return True
    return False


def plain(value):
    """A decoded message as dicts, lists and numbers, for JSON."""
    if dataclasses.is_dataclass(value):
        # in rosbags' classes only constants and the name of the type have a default
        names = [field.name for field in dataclasses.fields(value) if field.default is dataclasses.MISSING]
        return {name: plain(getattr(value, name)) for name in names}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list) else value
