"""Damage of a recording, and a whole recording from what can be read of a damaged file."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.files import find_recording, is_rosbag
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter, MessageRefused


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

    def describe(self, recording: Recording) -> None:
        """Take the content of a whole recording."""
        self.messages = recording.count
        self.topics = {name: about.count for name, about in recording.topics().items()}
        self.first_log_time, self.last_log_time = recording.first_log_time, recording.last_log_time
        self.attachments = [about.name for about in recording.attachments]


def recover(source, target=None, progress: Callable[[int, int], None] | None = None) -> Recovered:
    """Write the readable content of ``source``, a file or the directory of a recording, into a new directory.

    target: by default the path of the source with "_recovered". The source is not changed. The target appears when it
    is complete; it must not exist before. A whole source is copied only if a target is given. Raises RecordingError.
    """
    file, place = find_recording(source), Path(os.path.abspath(source))
    if is_rosbag(file):
        raise RecordingError(file, "is not one MCAP file, and only such a file can be recovered")
    name = place.name if place.is_dir() else place.name.partition(".")[0]
    result = Recovered(str(file), os.path.abspath(file.parent))
    try:
        with Recording(file) as recording:
            result.damage = findings(recording)
            result.describe(recording)
    except RecordingError as error:
        result.damage = [error.reason]
    result.whole = not result.damage
    if result.whole and target is None:
        result.lost_messages = 0
        return result
    target = Path(os.path.abspath(target or place.with_name(f"{name}_recovered")))
    if os.path.lexists(target):
        raise RecordingError(target, "exists already and is not overwritten")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        summary: list[str] = []  # damage that costs no message
        with (
            Recording(file, on_damage=lambda reason, *_: summary.append(reason)) as salvage,
            BagWriter(part, target.name) as writer,
        ):
            if salvage.profile is None and not (salvage.count or salvage.attachments or salvage.metadata()):
                raise RecordingError(file, "nothing in it can be recovered")
            result.dropped += summary
            _copy(salvage, result, writer, progress)
        with Recording(part) as copy:
            result.describe(copy)
        os.rename(part, target)
    except OSError as error:
        raise RecordingError(target, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    result.directory, result.whole = str(target), result.whole and not result.dropped
    return result


def _copy(source: Recording, result: Recovered, writer: BagWriter, progress: Callable | None) -> None:
    """Write everything that can be read, and count what is lost."""
    for about in source.attachments:
        if reason := _attachment_damage(source, about.name):
            result.lost_bytes += about.length
            result.dropped.append(reason)
        else:
            writer.add_attachment(about.name, source.attachment(about.name))
    for name, values in source.metadata().items():
        if name != "rosbag2":  # the writer adds a new one
            writer.add_metadata(name, values)
    numbers = {}  # channel in the source -> channel in the copy
    for number, channel in source.channels.items():
        schema = source.schema_of(channel)
        parsed = (schema.name, schema.encoding, schema.data)
        numbers[number] = writer.add_channel(channel.topic, parsed, channel.message_encoding, channel.metadata)

    def lose(reason: str, offset: int, size: int) -> None:
        result.lost_bytes += size
        result.dropped.append(f"{size} bytes at byte {offset}: {reason}")

    refused: Counter[str] = Counter()  # reason -> messages
    before = len(result.dropped)
    for count, message in enumerate(source.messages(on_damage=lose)):
        number = numbers[message.channel]
        try:
            writer.write_raw(number, message.data, message.publish_time, message.log_time, message.sequence)
        except MessageRefused as error:
            refused[f"that {error.reason}"] += 1
        if progress and count % 10_000 == 0:
            progress(count, source.count)
    complete = len(result.dropped) == before and not source.cut_off
    if source.statistics or complete:
        stated = source.statistics.message_count if source.statistics else source.count
        result.lost_messages = max(stated - writer.count, 0)
    result.dropped += [f"{count} messages {reason}" for reason, count in refused.items()]
    writer.add_metadata("recovered", {"source": source.path.name, "dropped": "\n".join(result.dropped) or "nothing"})


def findings(recording: Recording, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """Return a sentence for each damage, at most 20; none for a whole recording. Damage raises no error.

    A recording is whole where ``mcap doctor`` accepts it, also without checksums and counts. The indexes are not
    compared: nothing here reads by them.
    """
    sentences = ["it is cut off: its writer did not finish it"] if recording.cut_off else []
    counts: Counter[int] = Counter()

    def add(reason: str, offset: int, size: int) -> None:
        sentences.append(f"{reason} (at byte {offset})")

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
    return sentences[:20]


def _attachment_damage(recording: Recording, name: str) -> str:
    """Return what is wrong with an attachment, or an empty text."""
    try:
        recording.attachment(name)
    except RecordingError as error:
        return error.reason
    return ""
