"""Messages of any type as objects, by mcap-ros2-support: the slow way that knows every definition."""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Callable
from typing import NamedTuple

from kr270_milling.bag.errors import RecordingError

__all__ = ["Topic", "make_decoder", "plain"]

#: what mcap-ros2-support raises for bytes that are not a message of the schema, or for a schema that is none
DECODE_ERRORS = (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, MemoryError,
                 RecursionError, NotImplementedError, NameError, struct.error)  # fmt: skip


class Topic(NamedTuple):
    """A topic of a recording; ``schema`` is the message definition."""

    type: str
    count: int
    encoding: str
    schema: str
    schema_encoding: str
    metadata: dict[str, str]


def make_decoder(path, topic: str, about: Topic) -> Callable[[bytes], object]:
    """A function from a message's bytes to an object with the fields as attributes; ``path`` is for the errors."""
    from mcap.exceptions import McapError
    from mcap.records import Schema
    from mcap_ros2._vendor.rosidl_adapter.parser import InvalidSpecification
    from mcap_ros2.decoder import DecoderFactory

    errors = (*DECODE_ERRORS, McapError, InvalidSpecification)
    if about.encoding != "cdr" or about.schema_encoding != "ros2msg":
        what = f"{about.encoding or 'an unnamed encoding'} with a {about.schema_encoding or 'missing'} schema"
        raise RecordingError(path, f"{topic} holds {what}, but only cdr with ros2msg can be decoded")
    schema = Schema(id=1, name=about.type, encoding=about.schema_encoding, data=about.schema.encode())
    try:
        with contextlib.redirect_stderr(io.StringIO()):  # its parser prints what it raises
            decode = DecoderFactory().decoder_for(about.encoding, schema)
    except errors as error:
        raise RecordingError(path, f"the definition of {about.type} cannot be used") from error

    def guarded(data: bytes):
        try:
            return decode(data)
        except errors as error:
            raise RecordingError(path, f"a message on {topic} is not a {about.type}") from error

    return guarded


def plain(value):
    """A decoded message as dicts, lists and numbers, for JSON."""
    slots = getattr(value, "__slots__", None)
    if slots is not None:
        return {name: plain(getattr(value, name)) for name in slots}
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if isinstance(value, (list, tuple)) or hasattr(value, "tolist"):
        return [plain(item) for item in value]
    return value
