"""An open recording: its topics, attachments and metadata, and its messages one by one.

Reading needs memory for one chunk, packed and unpacked, and about 100 MB more, whatever the size of the file.
A definition in a file is not trusted: its size and its arrays are limited.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from mcap.records import Channel, Schema

from kr270_milling.base.errors import InputError, RecordingError, nearest
from kr270_milling.recordings.bag.files import find_recording, is_rosbag
from kr270_milling.recordings.bag.mcap_file import Damage, McapFile, OnDamage, RawMessage
from kr270_milling.recordings.bag.rosbag_file import RosbagFile
from kr270_milling.recordings.messages.definitions import (
    DEFINITION_ERRORS,
    TYPE_NAME,
    jazzy_store,
    members,
    read_message,
)
from kr270_milling.recordings.messages.topics import TOPICS

__all__ = ["RawMessage", "RecordedTopic", "Recording", "make_decoder", "remapping", "store_for"]

OWN = tuple(topic.name for topic in TOPICS if not topic.name.startswith("/"))


#: [bytes] of a message with lists of messages or texts: Python's objects take about twenty times as much
MOST_OBJECTS = 4 * 1024 * 1024


@dataclasses.dataclass(frozen=True)
class RecordedTopic:
    """A topic of a recording; ``schema`` is the message definition."""

    type: str
    count: int
    encoding: str
    schema: str
    schema_encoding: str
    metadata: dict[str, str]


class Recording:
    """An open recording: an MCAP file, or what rosbag2 wrote. Raises RecordingError where it cannot be read.

    ``cut_off``: its writer did not finish the file; the file is read up to its last whole chunk.
    progress: called with (bytes read, bytes in all) where the file has no summary. on_damage: receives each damage and
    the bytes that are lost with it; reading continues after them. By default the first damage raises RecordingError.
    remap: our names -> recorded names, see ``remapping``.
    """

    def __init__(
        self,
        path,
        progress: Callable[[int, int], None] | None = None,
        on_damage: OnDamage | None = None,
        remap: Mapping[str, str] = MappingProxyType({}),
    ):
        self.path = find_recording(path)
        self.remap = remap
        with self._damage_as_error():
            bag = is_rosbag(self.path)
            self._file = RosbagFile(self.path) if bag else McapFile(self.path, progress, on_damage)
        self.size, self.cut_off = self._file.size, self._file.cut_off
        self.profile, self.library = self._file.profile, self._file.library
        self.channels, self.schemas, self.counts = self._file.channels, self._file.schemas, self._file.counts
        self.first_log_time, self.last_log_time = self._file.first, self._file.last
        self.attachments = self._file.attachments
        try:
            self._rename()
        except RecordingError:
            self.close()
            raise
        self._topics = self._list_topics()

    @contextlib.contextmanager
    def _damage_as_error(self) -> Iterator[None]:
        try:
            yield
        except Damage as damage:
            hint = "; recover may save the rest" if damage.offset else ""
            raise RecordingError(self.path, damage.reason + hint, damage.offset) from damage

    def _rename(self) -> None:
        """Give the channels our names of their topics."""
        recorded = {channel.topic for channel in self.channels.values()}
        spaces = namespaces_of(recorded)
        for name in self.remap.values():
            exact = {name} if name.startswith("/") else {f"{space}/{name}" for space in spaces}
            if not exact & recorded:
                listed = ", ".join(sorted(recorded)) or "no topic"
                raise RecordingError(self.path, f"has no topic {name}, but {listed}")
        for channel in self.channels.values():
            channel.topic = own_name(channel.topic, self.remap, spaces)

    def _list_topics(self) -> dict[str, RecordedTopic]:
        topics: dict[str, RecordedTopic] = {}
        texts = {number: schema.data.decode("utf-8", "replace") for number, schema in self.schemas.items()}
        for number, channel in self.channels.items():
            name, schema = channel.topic, self.schema_of(channel)
            text = texts.get(channel.schema_id, "")
            encoding, metadata = channel.message_encoding, channel.metadata
            about = RecordedTopic(schema.name, self.counts[number], encoding, text, schema.encoding, metadata)
            other = topics.get(name)
            if other is not None:  # a topic with two types has the type of the channel with more messages
                chosen = other if other.count > about.count else about
                about = dataclasses.replace(chosen, count=other.count + about.count)
            topics[name] = about
        return topics

    @property
    def count(self) -> int:
        return self.counts.total()

    @property
    def statistics(self):
        """The counts that the summary of an MCAP file states, or None."""
        return getattr(self._file, "statistics", None)

    def topics(self) -> dict[str, RecordedTopic]:
        """Topic name -> type, count and definition, in the order of appearance. Channels of one topic are one topic."""
        return self._topics

    def schema_of(self, channel: Channel) -> Schema:
        return self.schemas.get(channel.schema_id, Schema(id=0, data=b"", encoding="", name=""))

    def metadata(self) -> dict[str, dict[str, str]]:
        """Record name -> entries; of several records with one name the last."""
        return dict(self._file.metadata)

    def attachment(self, name: str) -> bytes:
        """The bytes of an attachment. Raises RecordingError."""
        for about in self.attachments:
            if about.name == name:
                with self._damage_as_error():
                    return self._file.attachment(about)
        raise RecordingError(self.path, f"has no attachment {name!r}")

    def messages(
        self, topics: Collection[str] | None = None, on_damage: OnDamage | None = None
    ) -> Iterator[RawMessage]:
        """All messages, or those of some topics, in the order in which they were written.

        on_damage: receives each damage, and reading continues after the damage. Raises RecordingError.
        """
        names = {n: c.topic for n, c in self.channels.items() if topics is None or c.topic in topics}
        with self._damage_as_error():
            yield from self._file.messages(names, on_damage)

    def decoded(self, topics: Collection[str] | None = None) -> Iterator[tuple[RawMessage, Any]]:
        """Messages with their fields as attributes: slow, but for any type of the "ros2msg" kind."""
        decoders = {}
        for message in self.messages(topics):
            if message.topic not in decoders:
                decoders[message.topic] = self.decoder(message.topic)
            yield message, decoders[message.topic](message.data)

    def decoder(self, topic: str) -> Callable[[bytes], Any]:
        """A function from the bytes of a topic's messages to an object. Raises RecordingError."""
        return make_decoder(self.path, topic, self.topics()[topic])

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_) -> None:
        self.close()


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


def remapping(rules: Iterable[str]) -> dict[str, str]:
    """Return our name -> recorded name of rules such as ``wrench:=force/measured``; raise InputError.

    Names are relative to the namespace of a robot. Where one of the two begins with a slash, both are absolute.
    """
    result = {}
    for rule in rules:
        own, colon, recorded = rule.partition(":=")
        if not (colon and own and recorded.strip("/")):
            raise InputError("--remap", f"{rule!r} is not NAME:=RECORDED, for example wrench:=force/measured")
        name = own.rpartition("/")[2]
        if name not in OWN or (own != name and not own.startswith("/")):
            raise InputError("--remap", f"{own!r} is not one of {', '.join(OWN)}{nearest(name, OWN)}")
        absolute = own.startswith("/") or recorded.startswith("/")
        result["/" + own.lstrip("/") if absolute else own] = "/" + recorded.lstrip("/") if absolute else recorded
    return result


def own_name(topic: str, remap: Mapping[str, str], namespaces: Collection[str]) -> str:
    """Return our name of a recorded topic; a recorded topic that has our name by chance gets the other one.

    A relative name belongs to each of the namespaces of robots.
    """
    for own, recorded in remap.items():
        for space in [""] if recorded.startswith("/") else namespaces:
            names = [f"{space}/{name.lstrip('/')}" for name in (recorded, own)]
            if topic in names:
                return names[topic == names[0]]
    return topic


def namespaces_of(topics: Iterable[str]) -> set[str]:
    """Return the namespaces that may be those of robots: of every topic with one of our names."""
    return {space for space, _, name in (topic.rpartition("/") for topic in topics) if name in OWN}
