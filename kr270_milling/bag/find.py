"""Which file a recording is in."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.base.errors import RecordingError

__all__ = ["find_file"]


def find_file(path) -> Path:
    """The MCAP file itself, or the one in a recording's directory."""
    path = Path(path)
    if not path.is_dir():
        return path
    files = sorted(path.glob("*.mcap"))
    if len(files) != 1:
        raise RecordingError(path, f"holds {len(files)} MCAP files where a recording has one")
    return files[0]
