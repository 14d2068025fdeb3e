"""What message types consist of: rosbags' store of the types of ROS 2 Jazzy, and definitions that come with a file.

A type that Jazzy's store lacks is read from the ``.msg`` files that its package installs. Messages of any type are
objects with their fields as attributes: the slow way that knows every type.
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

__all__ = ["Topic", "definition", "deserialise", "make_decoder", "plain", "starts_with_stamp", "store_for", "store_of",
           "type_hash"]  # fmt: skip

TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Za-z][A-Za-z0-9_]*)")
MOST_TEXT = 256 * 1024  # [characters] of a definition in a file; its parser takes 0.7 s for them
MOST_ITEMS = 1000  # of an array of fixed length of texts or messages: rosbags writes a line of code for each
PARSE, DECODE = 300.0, 0.15  # [us] of work a line of a definition, a byte of a message with lists in it
#: [bytes] of a message with lists of messages or texts in it: as Python's objects they take some twenty times as much
MOST_OBJECTS = 4 * 1024 * 1024
STAMPS = ("Header", "std_msgs/Header", "std_msgs/msg/Header", "builtin_interfaces/Time", "builtin_interfaces/msg/Time")
#: what rosbags raises for a text that is no definition; SyntaxError and NameError come out of the code that it makes
DEFINITION_ERRORS = (ValueError, TypeError, KeyError, AssertionError, AttributeError, RecursionError, SyntaxError,
                     NameError, OverflowError, MemoryError)  # fmt: skip


@functools.cache
def _jazzy():
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


@functools.cache
def store_of(type_name: str):
    """The type store that knows an installed type. Raises RecordingError."""
    if not TYPE_NAME.fullmatch(type_name):
        raise RecordingError(type_name, 'this is not the name of a message type like "geometry_msgs/msg/PoseStamped"')
    if type_name not in _jazzy().fielddefs:
        _register(type_name)
    return _jazzy()


def _register(type_name: str) -> None:
    """Teach the store a type, and those that it is made of, from the files of their packages."""
    from rosbags.typesys import TypesysError, get_types_from_msg

    found, waiting = {}, [type_name]
    while waiting:
        name = waiting.pop()
        if name in found or name in _jazzy().fielddefs:
            continue
        try:
            found.update(get_types_from_msg(_file(name).read_text(encoding="utf-8"), name))
        except (TypesysError, *DEFINITION_ERRORS) as error:
            raise RecordingError(name, "its definition cannot be used") from error
        waiting += [kind for _, is_message, kind, _ in _members(found[name]) if is_message]
    _jazzy().register(found)


def _file(type_name: str) -> Path:
    """The ``.msg`` file of a type: beside the Python package in a wheel, an overlay or /opt/ros."""
    match = TYPE_NAME.fullmatch(type_name)
    if not match:
        raise RecordingError(type_name, "this is not the name of a message type")
    package, name = match.groups()
    spec = importlib.util.find_spec(package)
    roots = [root for place in (spec and spec.submodule_search_locations) or [] for root in Path(place).parents]
    roots += [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    files = [root / "share" / package / "msg" / f"{name}.msg" for root in roots]
    for file in filter(Path.is_file, files):
        return file
    raise RecordingError(type_name, f"no {name}.msg was found; the message package {package} is not installed")


@functools.cache
def definition(type_name: str) -> str:
    """The definition of a type followed by those of all types in it ("ros2msg"). Raises RecordingError."""
    return store_of(type_name).generate_msgdef(type_name, ros_version=2)[0]


@functools.cache
def type_hash(type_name: str) -> str:
    """The RIHS01 hash of a type. Raises RecordingError."""
    return store_of(type_name).hash_rihs01(type_name)


def _members(fields) -> Iterator[tuple[str, bool, str, float | None]]:
    """Name, whether it is of messages, what it is of, and for a list its length (infinite: any), of every field."""
    from rosbags.interfaces import Nodetype

    for name, kind in fields[1]:
        (inner, about), length = kind[1] if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, None)
        length = math.inf if kind[0] == Nodetype.SEQUENCE else length
        yield name, inner == Nodetype.NAME, about if inner == Nodetype.NAME else about[0], length


def starts_with_stamp(text: str) -> bool:
    """Whether the bytes of a message begin with a time: a Header, or a Time as in Clock, is the first field."""
    for line in text.splitlines():
        words = line.split("#", 1)[0].replace("<=", " ").split()
        if line.startswith("===="):
            return False
        if words and "=" not in "".join(words):
            return words[0] in STAMPS
    return False


# types as a file defines them


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic of a recording; ``schema`` is the message definition."""

    type: str
    count: int
    encoding: str
    schema: str
    schema_encoding: str
    metadata: dict[str, str]


@functools.lru_cache(maxsize=64)
def store_for(type_name: str, text: str):
    """A type store that knows a type as the text of a recording defines it, which is not trusted.

    Raises ValueError where the text cannot be used, and what DEFINITION_ERRORS lists.
    """
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    if not TYPE_NAME.fullmatch(type_name) or len(text) > MOST_TEXT:
        raise ValueError(f"{type_name[:80]!r} is not defined by {len(text)} characters")
    try:
        found = get_types_from_msg(text, type_name)
        if all(_jazzy().fielddefs.get(name) == fields for name, fields in found.items()):
            return _jazzy()
        for name, is_message, kind, length in (member for fields in found.values() for member in _members(fields)):
            most = MOST_ITEMS if is_message or kind == "string" else 2**31
            if length not in (None, math.inf) and not 1 <= length <= most:
                raise ValueError(f"{name} is an array of {length} items")
        store = get_typestore(Stores.EMPTY)
        store.register(found)
    except TypesysError as error:
        raise ValueError(str(error)[:200]) from None
    return store


def make_decoder(recording, topic: str) -> Callable[[bytes], object]:
    """A function from the bytes of a topic's messages to an object with the fields as attributes.

    It and this raise RecordingError where they cannot. The work of both is counted by ``recording.spend``.
    """
    path, about = recording.path, recording.topics()[topic]
    if about.encoding != "cdr" or about.schema_encoding != "ros2msg":
        what = f"{about.encoding or 'an unnamed encoding'} with a {about.schema_encoding or 'missing'} schema"
        raise RecordingError(path, f"{topic} holds {what}, but only cdr with ros2msg can be decoded")
    recording.spend(PARSE * (about.schema.count("\n") + len(about.schema) / 100))
    try:
        store = store_for(about.type, about.schema)
        store.get_msgdef(about.type)
    except DEFINITION_ERRORS as error:
        raise RecordingError(path, f"the definition of {about.type} cannot be used") from error
    listing = _has_lists(store, about.type)

    def decode(data: bytes):
        if listing and len(data) > MOST_OBJECTS:
            reason = f"a message on {topic} has {len(data)} bytes, more than {MOST_OBJECTS} to be decoded"
            raise RecordingError(path, reason)
        recording.spend(DECODE * len(data) * listing)
        try:
            return _read(store, about.type, data)
        except (ValueError, MemoryError, RecursionError) as error:
            raise RecordingError(path, f"a message on {topic} is not a {about.type}") from error

    return decode


def _has_lists(store, type_name: str, seen: frozenset = frozenset()) -> bool:
    """Whether a message may hold a list of messages or texts, itself or in a message within it."""
    for _, is_message, kind, length in _members(store.fielddefs[type_name]):
        if length == math.inf and (is_message or kind == "string"):
            return True
        if is_message and kind not in seen and _has_lists(store, kind, seen | {type_name}):
            return True
    return False


def deserialise(type_name: str, data: bytes):
    """A message as an object with its fields as attributes. Raises ValueError where the bytes are no such message."""
    return _read(store_of(type_name), type_name, data)


def _read(store, type_name: str, data: bytes):
    """Bytes behind the last field are let pass: rmw_fastrtps leaves up to 76 there, more than rosbags' own check."""
    from rosbags.serde import SerdeError

    if len(data) < 4 or data[0] != 0 or data[1] > 1:
        raise ValueError("not plain CDR of version 1")
    about = store.get_msgdef(type_name)
    read = about.deserialize_cdr_le if data[1] else about.deserialize_cdr_be
    try:
        return read(data[4:], 0, about.cls, store)[0]
    except (SerdeError, IndexError, ValueError, struct.error) as error:
        raise ValueError(f"is not a {type_name}: {error}") from None


def plain(value):
    """A decoded message as dicts, lists and numbers, for JSON."""
    if dataclasses.is_dataclass(value):
        # rosbags' classes have a default for constants and the name of the type alone
        names = [field.name for field in dataclasses.fields(value) if field.default is dataclasses.MISSING]
        return {name: plain(getattr(value, name)) for name in names}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list) else value
