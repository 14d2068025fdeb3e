"""Messages of any type as objects, by the definition that their recording holds: the slow way that knows every type."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.codec import read_message
from kr270_milling.messages.definitions import DEFINITION_ERRORS, has_lists, store_for

__all__ = ["Topic", "make_decoder", "plain"]

PARSE, DECODE = 300.0, 0.15  # [us] of work a line of a definition, a byte of a message with lists in it
#: [bytes] of a message with lists of messages or texts in it: as Python's objects they take some twenty times as much
MOST_OBJECTS = 4 * 1024 * 1024


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic of a recording; ``schema`` is the message definition."""

    type: str
    count: int
    encoding: str
    schema: str
    schema_encoding: str
    metadata: dict[str, str]


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
    listing = has_lists(store, about.type)

    def decode(data: bytes):
        if listing and len(data) > MOST_OBJECTS:
            reason = f"a message on {topic} has {len(data)} bytes, more than {MOST_OBJECTS} to be decoded"
            raise RecordingError(path, reason)
        recording.spend(DECODE * len(data) * listing)
        try:
            return read_message(store, about.type, data)
        except (ValueError, MemoryError, RecursionError) as error:
            raise RecordingError(path, f"a message on {topic} is not a {about.type}") from error

    return decode


def plain(value):
    """A decoded message as dicts, lists and numbers, for JSON."""
    if dataclasses.is_dataclass(value):
        # rosbags' classes have a default for constants and the name of the type alone
        names = [field.name for field in dataclasses.fields(value) if field.default is dataclasses.MISSING]
        return {name: plain(getattr(value, name)) for name in names}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list) else value
