"""Files of a recording: find them, open them, unpack a file that was compressed as a whole."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from pathlib import Path
from typing import IO

import zstandard

from kr270_milling.base.errors import ConfigError, RecordingError
from kr270_milling.base.parameter_file import parse

__all__ = ["find_recording", "is_rosbag", "open_to_read"]

NAMED = 8  # recordings that an error message names
BLOCK = 1024 * 1024  # [bytes]


def find_recording(path) -> Path:
    """Return the file of a recording, or its directory where rosbag2 wrote several files, a database or compressed
    messages. Raises RecordingError."""
    path = Path(path)
    if not path.is_dir() or _needs_rosbags(path):
        return path
    for kind in ("*.mcap", "*.mcap.zstd", "*.db3"):
        files = sorted(path.glob(kind))
        if len(files) == 1:
            return files[0]
        several = [str(file) for file in files] or sorted({str(file.parent) for file in path.glob(f"*/{kind}")})
        if several:
            more = f" and {len(several) - NAMED} more" if len(several) > NAMED else ""
            reason = f"is no recording; name one of those in it: {', '.join(several[:NAMED])}{more}"
            raise RecordingError(path, reason)
    raise RecordingError(path, "holds no recording (.mcap, .mcap.zstd or .db3)")


def is_rosbag(path: Path) -> bool:
    """Return whether rosbags reads a recording, and not mcap."""
    return path.is_dir() or path.suffix == ".db3"


def _needs_rosbags(directory: Path) -> bool:
    """Return whether ``metadata.yaml`` names several files, a database or compressed messages."""
    try:
        with open_to_read(directory / "metadata.yaml") as stream:
            text = stream.read(16 * 1024 * 1024).decode("utf-8", "replace")  # 16 MB
        about = parse(text, directory / "metadata.yaml", "")["rosbag2_bagfile_information"]
        files, mode = about["relative_file_paths"], str(about.get("compression_mode")).lower()
        return (
            (len(files) > 1 and directory.joinpath(Path(files[0]).name).is_file())
            or mode == "message"
            or (about["storage_identifier"] == "sqlite3")
        )
    except (RecordingError, ConfigError, LookupError, TypeError, AttributeError):
        return False


def open_to_read(path: Path) -> IO[bytes]:
    """Open a regular file; a file that ends in .zstd is unpacked into a temporary one. Raises RecordingError."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # opening a pipe must not block
    except (OSError, ValueError) as error:
        raise RecordingError(path, f"cannot be read: {getattr(error, 'strerror', error)}") from error
    stream = os.fdopen(file, "rb")
    if not stat.S_ISREG(os.fstat(file).st_mode):
        stream.close()
        raise RecordingError(path, "is not a file")
    return _unpacked(path, stream) if path.suffix in (".zstd", ".zst") else stream


def _unpacked(path: Path, packed: IO[bytes]) -> IO[bytes]:
    """Unpack a file as far as the disk has room. Raises RecordingError."""
    stream = tempfile.TemporaryFile()  # noqa: SIM115 - the caller closes the recording
    try:
        with packed, zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as content:
            while block := content.read(BLOCK):
                if shutil.disk_usage(tempfile.gettempdir()).free < 2**30:  # a GB remains on the disk
                    raise RecordingError(path, f"cannot be unpacked: {tempfile.gettempdir()} has no room for it")
                stream.write(block)
        stream.seek(0)
    except (zstandard.ZstdError, OSError, RecordingError) as error:
        stream.close()
        if isinstance(error, RecordingError):
            raise
        reason = f"cannot be unpacked ({error}); zstd -d {path.name} may save a part of it"
        raise RecordingError(path, reason) from error
    return stream
