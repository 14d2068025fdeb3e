"""The one error of this folder."""

from __future__ import annotations

from kr270_milling.base.errors import MillingError

__all__ = ["RecordingError"]


class RecordingError(MillingError):
    """A recording that cannot be written or read; offset is the byte where it went wrong, if that is known."""

    def __init__(self, path, reason: str, offset: int | None = None):
        self.path, self.reason, self.offset = str(path), reason, offset
        super().__init__(f"{self.path}: {reason}" + ("" if offset is None else f" (at byte {offset})"))
