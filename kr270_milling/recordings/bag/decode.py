"""Messages decoded with the definitions in a recording: objects with their fields as attributes.

This way is slow and knows every type. A definition in a file is not trusted: its size and its arrays are limited.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.messages.definitions import (
    DEFINITION_ERRORS,
    TYPE_NAME,
    jazzy_store,
    members,
    read_message,
)

__all__ = ["RecordedTopic", "make_decoder", "store_for"]

#: [bytes] of a message with lists of messages or texts: Python's objects take about twenty times as much
MOST_OBJECTS = 4 * 1024 * 1024


@dataclass(frozen=True)
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
    """A type store that knows a type as the text of a recording defines it.

    Raises ValueError for an unusable text, and the errors in DEFINITION_ERRORS.
    """
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    if not TYPE_NAME.fullmatch(type_name) or len(text) > 256 * 1024:  # characters of a definition
        raise ValueError(f"{type_name[:80]!r} is not defined by {len(text)} characters")
    try:
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
    except TypesysError as error:
        raise ValueError(str(error)[:200]) from None
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
    except DEFINITION_ERRORS as error:
        raise RecordingError(path, f"the definition of {topic.type} cannot be used") from error
    limited = _has_lists(store, topic.type)

    def decode(data: bytes):
        if limited and len(data) > MOST_OBJECTS:
            reason = f"a message on {name} has {len(data)} bytes, more than {MOST_OBJECTS} to be decoded"
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
