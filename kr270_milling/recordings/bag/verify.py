"""Damage of a recording: every checksum, and the counts of messages that its summary states."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.mcap_file import Damage
from kr270_milling.recordings.bag.reader import Recording

__all__ = ["findings"]

MOST = 20  # sentences


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
