"""The file of a recording during writing: a new file in a directory; the first error ends the file."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import IO, cast

from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from kr270_milling.base.errors import RecordingError

__all__ = ["Output", "plain_name"]


def plain_name(path, name: str) -> str:
    """Return ``name`` if it is the name of a file without a directory. Raises RecordingError."""
    if not name or name in (".", "..") or "/" in name or "\0" in name or len(name.encode()) > 200:
        raise RecordingError(path, f"{name[:80]!r} is not a file name")
    return name


class Output:
    """``directory/name.mcap`` for mcap's Writer.

    There is no buffer here: a written chunk is in the kernel and survives a SIGKILL. The first error of the file system
    ends the file, which stays readable up to its last whole chunk; every later call raises the same RecordingError.
    """

    def __init__(self, directory: Path, name: str, chunk_size: int):
        self.path = directory / f"{plain_name(directory, name)}.mcap"
        self.error: RecordingError | None = None
        self.count = self.saved = 0  #: messages given to mcap's Writer, and messages in the file
        self._file = self._create()
        # the checksum of the data section also covers the bytes outside of the chunks
        self.mcap = Writer(cast(IO[bytes], self), chunk_size, CompressionType.ZSTD, enable_data_crcs=True)

    def _create(self) -> IO[bytes]:
        folder = self.path.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if folder.is_symlink():
                raise RecordingError(folder, "is a symbolic link; a recording is not written through links")
            if os.path.lexists(folder / "metadata.yaml"):
                raise RecordingError(folder, "has a recording already, which is not overwritten")
            return cast(IO[bytes], open(self.path, "xb", buffering=0))
        except FileExistsError as error:
            raise RecordingError(error.filename, "exists already and is not overwritten") from None
        except OSError as error:
            raise RecordingError(self.path, f"cannot be created: {error.strerror}") from error

    @property
    def is_open(self) -> bool:
        return not self._file.closed

    def check(self) -> None:
        """Raise RecordingError after an error or after the end."""
        if not self.is_open:
            raise self.error or RecordingError(self.path, "the recording is closed")

    # the stream of mcap's Writer

    def write(self, data) -> int:
        self.check()
        view, written = memoryview(data), 0
        try:
            while written < len(view):
                written += self._file.write(view[written:])
        except OSError as error:
            lost = self.count - self.saved
            reason = f"writing ended with an error ({error.strerror or error}); {self.saved} messages are safe, "
            self.error = RecordingError(self.path, f"{reason}the last {lost} are lost")
            self.close()
            raise self.error from error
        if view and view[0] == Opcode.CHUNK:
            self.saved = self.count
        return written

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    # for the writer of the recording

    def add_message(self, channel: int, log_time: int, data, publish_time: int, sequence: int) -> None:
        self.check()
        self.count += 1
        self.mcap.add_message(channel, log_time, data, publish_time, sequence)

    def close_chunk(self) -> None:
        """Write every message into the file."""
        if self.is_open and self.saved < self.count:
            self.mcap.flush()

    def close(self) -> None:
        with suppress(OSError):
            self._file.close()
