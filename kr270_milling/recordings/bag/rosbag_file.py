"""A recording that rosbag2 wrote as a database, as several files or with compressed messages, read by rosbags."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from mcap.records import Channel, Schema

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.bagmeta import yaml_text
from kr270_milling.recordings.bag.mcap_file import LATEST, Attached, Damage, OnDamage, RawMessage
from kr270_milling.recordings.messages.definitions import definition

__all__ = ["RosbagFile"]


class RosbagFile:
    """The content of a recording, with the attributes of an ``McapFile``. Raises Damage."""

    cut_off = False
    profile = "ros2"
    attachments: tuple[Attached, ...] = ()  # rosbag2 has none

    def __init__(self, path: Path):
        from rosbags.rosbag2 import Reader

        self._faults = _faults()
        try:
            self._reader = Reader(path)
            self._reader.open()
        except self._faults as error:
            raise Damage(f"cannot be read: {error}", 0) from error
        self._connections = list(self._reader.connections)
        files = [path] if path.is_file() else [file for file in path.iterdir() if file.is_file()]
        self.size = sum(file.stat().st_size for file in files)
        self.library = f"rosbag2 {self._reader.ros_distro or ''}".strip()
        self.counts = Counter({c.id: c.msgcount for c in self._connections})
        self.schemas = {c.id: Schema(c.id, *_schema(c)) for c in self._connections}
        self.channels = {c.id: Channel(c.id, c.topic, "cdr", _about(c), c.id) for c in self._connections}
        custom = self._reader.storage.metadata.custom or {}
        self.metadata = {"custom_data": {str(key): str(value) for key, value in custom.items()}} if custom else {}
        count = self._reader.message_count
        self.first = self._reader.start_time if count else None
        self.last = self._reader.end_time - 1 if count else None

    def close(self) -> None:
        self._reader.close()

    def attachment(self, about: Attached) -> bytes:
        raise Damage(f"has no attachment {about.name!r}", 0)

    def messages(self, names: Mapping[int, str], on_damage: OnDamage | None = None) -> Iterator[RawMessage]:
        """Yield the messages on some channels in the order of their times in each file. Raises Damage."""
        chosen = [c for c in self._connections if c.id in names]
        try:
            for c, time, data in self._reader.messages(chosen) if chosen else ():
                if not 0 <= time < LATEST:
                    raise ValueError(f"a time of {time} ns is not between 1970 and 2262")
                yield RawMessage(names[c.id], time, time, bytes(data), c.id)
        except self._faults as error:
            damage = Damage(f"cannot be read to its end: {error}", 0)
            if on_damage is None:
                raise damage from error
            on_damage(damage, 0)


def _faults() -> tuple[type[BaseException], ...]:
    """Return the errors of rosbags and of the libraries that rosbags uses, for a damaged recording."""
    import apsw
    from rosbags.rosbag2 import ReaderError, reader

    # code that meets a field of another type in a damaged file, SQLite, the decompressors
    code = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError, struct.error)
    system = (OSError, RuntimeError, EOFError, MemoryError)
    return (*code, *system, ReaderError, apsw.Error, reader.zstd.ZstdError)


def _schema(connection) -> tuple[bytes, str, str]:
    """Return data, encoding and name of a type; a database of an old version has no definitions."""
    text, kind = connection.msgdef.data, connection.msgdef.format.name
    if kind == "NONE":
        try:
            text, kind = definition(connection.msgtype), "MSG"
        except RecordingError:
            text = ""
    encoding = {"MSG": "ros2msg", "IDL": "ros2idl"}.get(kind, "")
    return text.encode(), encoding, connection.msgtype


def _about(connection) -> dict[str, str]:
    """Return the metadata of a channel as rosbag2 writes them into an MCAP file."""
    from rosbags.rosbag2.metadata import dump_qos_v9

    profiles = yaml_text(dump_qos_v9(connection.ext.offered_qos_profiles)).strip()
    return {"offered_qos_profiles": profiles, "topic_type_hash": connection.digest}
