"""Damage of a recording, and a whole recording from what can be read of a damaged file."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.files import find_recording, is_rosbag
from kr270_milling.recordings.bag.mcap_file import Attached, Damage
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter, MessageRefused

__all__ = ["Recovered", "findings", "recover"]

MOST = 20  # sentences


@dataclass
class Recovered:
    """Saved and lost content of a file; ``dropped``: one sentence for each damaged place."""

    source: str
    directory: str = ""  # directory of the whole recording; that of the source if nothing had to be written
    whole: bool = False  # the source was complete and without damage
    messages: int = 0
    topics: dict[str, int] = field(default_factory=dict)
    first_log_time: int | None = None
    last_log_time: int | None = None
    attachments: list[str] = field(default_factory=list)
    lost_bytes: int = 0
    lost_messages: int | None = None  # None: the source does not contain the count
    dropped: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)  # findings in the source, also where no message is lost


def recover(source, target=None, progress: Callable[[int, int], None] | None = None) -> Recovered:
    """Write the readable content of ``source``, a file or the directory of a recording, into a new directory.

    target: by default the path of the source with "_recovered". The source is not changed. The target appears when it
    is complete; it must not exist before. A whole source is copied only if a target is given. Raises RecordingError.
    """
    file, place = find_recording(source), Path(os.path.abspath(source))
    if is_rosbag(file):
        raise RecordingError(file, "is not one MCAP file, and only such a file can be recovered")
    name = place.name if place.is_dir() else place.name.partition(".")[0]
    whole, damage = _examine(file)
    if whole and target is None:
        return whole
    target = Path(os.path.abspath(target or place.with_name(f"{name}_recovered")))
    if os.path.lexists(target):
        raise RecordingError(target, "exists already and is not overwritten")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    losses = Losses()
    try:
        with Recording(file, on_damage=losses.add_summary) as salvage, BagWriter(part, target.name) as writer:
            if salvage.profile is None and not (salvage.count or salvage.attachments or salvage.metadata()):
                raise RecordingError(file, "nothing in it can be recovered")
            _copy(salvage, losses, writer, progress)
            lost_messages = _lost_messages(salvage, losses, writer.count)
        with Recording(part) as copy:
            result = _describe(copy)
        os.rename(part, target)
    except OSError as error:
        raise RecordingError(target, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return replace(
        result,
        source=str(file),
        directory=str(target),
        whole=whole is not None and not losses.dropped,
        lost_bytes=losses.bytes,
        lost_messages=lost_messages,
        dropped=losses.dropped,
        damage=damage,
    )


def _examine(file: Path) -> tuple[Recovered | None, list[str]]:
    """The content of a whole recording, or None and its damage."""
    try:
        with Recording(file) as recording:
            damage = findings(recording)
            return None if damage else _describe(recording), damage
    except RecordingError as error:
        return None, [error.reason]


def _describe(recording: Recording) -> Recovered:
    """The content of a whole recording."""
    return Recovered(
        source=str(recording.path),
        directory=os.path.abspath(recording.path.parent),
        whole=True,
        messages=recording.count,
        topics={name: about.count for name, about in recording.topics().items()},
        first_log_time=recording.first_log_time,
        last_log_time=recording.last_log_time,
        attachments=[about.name for about in recording.attachments],
        lost_messages=0,
    )


class Losses:
    """The damage of a file that is recovered."""

    def __init__(self):
        self.dropped: list[str] = []  #: a sentence for each lost place
        self.bytes = 0
        self.complete = True  #: no message was lost

    def add_summary(self, damage: Damage, _: int) -> None:
        """Take a damage of the summary, which costs no message."""
        self.dropped.append(damage.reason)

    def add(self, damage: Damage, size: int) -> None:
        """Take a damage of the data, and the bytes that are lost with it."""
        self.complete = False
        self.bytes += size
        self.dropped.append(f"{size} bytes at byte {damage.offset}: {damage.reason}")

    @contextlib.contextmanager
    def of_attachment(self, about: Attached) -> Iterator[None]:
        """Take the damage of an attachment."""
        try:
            yield
        except RecordingError as error:
            self.bytes += about.end - about.offset
            self.dropped.append(error.reason)


def _lost_messages(source: Recording, losses: Losses, written: int) -> int | None:
    """Return the number of lost messages; None if the source does not state how many messages it had."""
    if source.statistics:
        return max(source.statistics.message_count - written, 0)
    return max(source.count - written, 0) if losses.complete and not source.cut_off else None


def _copy(source: Recording, losses: Losses, writer: BagWriter, progress: Callable[[int, int], None] | None) -> None:
    """Write everything that can be read."""
    for about in source.attachments:
        with losses.of_attachment(about):
            writer.add_attachment(about.name, source.attachment(about.name))
    for name, values in source.metadata().items():
        if name != "rosbag2":  # the writer adds a new one
            writer.add_metadata(name, values)
    numbers = {}  # channel in the source -> channel in the copy
    for number, channel in source.channels.items():
        schema = source.schema_of(channel)
        parsed = (schema.name, schema.encoding, schema.data)
        numbers[number] = writer.add_channel(channel.topic, parsed, channel.message_encoding, channel.metadata)
    refused: Counter[str] = Counter()  # reason -> messages
    for count, message in enumerate(source.messages(on_damage=losses.add)):
        number = numbers[message.channel]
        try:
            writer.write_raw(number, message.data, message.publish_time, message.log_time, message.sequence)
        except MessageRefused as error:
            refused[f"that {error.reason}"] += 1
        if progress and count % 10_000 == 0:
            progress(count, source.count)
    losses.dropped += [f"{count} messages {reason}" for reason, count in refused.items()]
    writer.add_metadata("recovered", {"source": source.path.name, "dropped": "\n".join(losses.dropped) or "nothing"})


def findings(recording: Recording, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """Return a sentence for each damage, at most 20; none for a whole recording. Damage raises no error.

    A recording is whole where ``mcap doctor`` accepts it, also without checksums and counts. The indexes are not
    compared: nothing here reads by them.
    """
    sentences = ["it is cut off: its writer did not finish it"] if recording.cut_off else []
    counts: Counter[int] = Counter()

    def add(damage: Damage, _: int) -> None:
        sentences.append(f"{damage.reason} (at byte {damage.offset})")

    for number, message in enumerate(recording.messages(on_damage=add)):
        counts[message.channel] += 1
        if progress and number % 10_000 == 0:
            progress(number, recording.count)
    sentences += filter(None, (_attachment_damage(recording, about.name) for about in recording.attachments))
    stated = recording.statistics
    if stated and not sentences:
        different = any(counts[channel] != count for channel, count in stated.channel_message_counts.items())
        if different or stated.message_count != counts.total():
            sentences.append("the counts of messages at the end are not those of the messages")
    return sentences[:MOST]


def _attachment_damage(recording: Recording, name: str) -> str:
    """Return what is wrong with an attachment, or an empty text."""
    try:
        recording.attachment(name)
    except RecordingError as error:
        return error.reason
    return ""
