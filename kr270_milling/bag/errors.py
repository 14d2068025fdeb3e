"""The errors of this folder: a message that is refused, and a recording that cannot be used."""

from kr270_milling.base.errors import RecordingError

__all__ = ["MessageRefused", "RecordingError"]


class MessageRefused(RecordingError):
    """One message that cannot be recorded; the file is unharmed and takes the next one."""
