"""The one error of this folder."""

from kr270_milling.base.errors import RecordingError

__all__ = ["RecordingError"]
