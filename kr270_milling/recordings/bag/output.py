"""The file of a recording during writing: a new file in a directory; the first error ends the file."""

from __future__ import annotations

import os
from collections.abc import Sized
from contextlib import suppress
from pathlib import Path
from typing import IO, cast

from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.files import write_files

__all__ = ["Output", "plain_name"]

NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW


def plain_name(path, name: str) -> str:
    """Return ``name`` if it is the name of a file without a directory. Raises RecordingError."""
    if not name or name in (".", "..") or "/" in name or "\0" in name or len(name.encode()) > 200:
        raise RecordingError(path, f"{name[:80]!r} is not a file name")
    return name


class Output:
    """``directory/name.mcap`` for mcap's Writer, and small files in the same directory.

    There is no buffer here: a written chunk is in the kernel and survives a SIGKILL. The first error of the file system
    ends the file after its last whole record, and every later call raises the same RecordingError.
    waiting: messages that are not in the file yet; an error loses them too.
    """

    def __init__(self, directory: Path, name: str, chunk_size: int, waiting: Sized):
        self.path = directory / f"{plain_name(directory, name)}.mcap"
        self.error: RecordingError | None = None
        self.count = self.saved = 0  #: messages given to mcap's Writer, and messages in the file
        self._waiting = waiting
        self._position = 0  # end of the last completed write; each write has one or more whole records
        self._file: int | None = self._create()
        # the checksum of the data section also covers the bytes outside of the chunks
        self.mcap = Writer(cast(IO[bytes], self), chunk_size, CompressionType.ZSTD, enable_data_crcs=True)

    def _create(self) -> int:
        folder = self.path.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if folder.is_symlink():
                raise RecordingError(folder, "is a symbolic link; a recording is not written through links")
            if os.path.lexists(folder / "metadata.yaml"):
                raise RecordingError(folder, "has a recording already, which is not overwritten")
            return os.open(self.path, NEW, 0o666)
        except FileExistsError as error:
            raise RecordingError(error.filename, "exists already and is not overwritten") from None
        except OSError as error:
            raise RecordingError(self.path, f"cannot be created: {error.strerror}") from error

    @property
    def is_open(self) -> bool:
        return self._file is not None

    # the stream of mcap's Writer

    def write(self, data) -> int:
        file, view, done = self.check(), memoryview(data), 0
        try:
            while done < len(view):
                done += os.write(file, view[done:])
        except OSError as error:
            lost = self.count - self.saved + len(self._waiting)
            self.error = RecordingError(
                self.path,
                f"writing ended with an error ({error.strerror or error}); {self.saved} messages in {self._position} "
                f"bytes are safe, the last {lost} are lost",
            )
            with suppress(OSError):
                os.ftruncate(file, self._position)
            self._close()
            raise self.error from error
        self._position += done
        if view and view[0] == Opcode.CHUNK:
            self.saved = self.count
        return done

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    # for the writer of the recording

    def check(self) -> int:
        """Return the file descriptor. Raises RecordingError after an error or after the end."""
        if self._file is None:
            raise self.error or RecordingError(self.path, "the recording is closed")
        return self._file

    def add_message(self, channel: int, log_time: int, data, publish_time: int, sequence: int) -> None:
        self.check()
        self.count += 1
        self.mcap.add_message(channel, log_time, data, publish_time, sequence)

    def close_chunk(self) -> None:
        """Write every message into the file."""
        if self.is_open and self.saved < self.count:
            self.mcap.flush()

    def _close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            with suppress(OSError):
                os.close(file)

    def finish(self, name: str, data: bytes) -> None:
        """End the file, and write a small file ``name`` in the same directory, which replaces a file of that name."""
        self.mcap.finish()
        self._close()
        neighbour = self.path.with_name(name)
        try:
            write_files({neighbour: (data,)})
        except InputError as error:
            raise RecordingError(neighbour, error.reason) from error
