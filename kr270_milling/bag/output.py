"""The file of a recording while it is written: a new file inside a directory, which ends at its first error."""

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
    """``name`` if it is the name of a file in a directory and nothing more."""
    if not name or name in (".", "..") or "/" in name or "\0" in name or len(name.encode()) > 200:
        raise RecordingError(path, f"{name[:80]!r} is not a file name")
    return name


class Output:
    """``directory/name.mcap`` by mcap's Writer, and small files beside it; nothing is written outside the directory.

    No buffer of our own: what mcap's writer gave was written to the kernel and survives a SIGKILL. The first error of
    the file system ends the file behind the last whole record, and every later call raises the same RecordingError.
    waiting: messages that were not given yet, and are lost then as well.
    """

    def __init__(self, directory: Path, name: str, chunk_size: int, waiting: Sized):
        self.path = directory / f"{plain_name(directory, name)}.mcap"
        self.error: RecordingError | None = None
        self.count = self.kept = 0  #: messages given, and those of them that are in the file
        self._waiting = waiting
        self._position = 0  # end of the last piece that was written whole; a piece is one or more whole records
        self._file: int | None = self._create()
        # the checksum over the whole data section shows a flipped bit also outside of the chunks
        self.mcap = Writer(cast(IO[bytes], self), chunk_size, CompressionType.ZSTD, enable_data_crcs=True)

    def _create(self) -> int:
        folder = self.path.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if folder.is_symlink():
                raise RecordingError(folder, "is a link, through which no recording is written")
            if os.path.lexists(folder / "metadata.yaml"):
                raise RecordingError(folder, "holds a recording already, which is not overwritten")
            return os.open(self.path, NEW, 0o666)
        except FileExistsError as error:
            raise RecordingError(error.filename, "exists already and is not overwritten") from None
        except OSError as error:
            raise RecordingError(self.path, f"cannot be created: {error.strerror}") from error

    @property
    def is_open(self) -> bool:
        return self._file is not None

    # what mcap's Writer asks of a stream

    def write(self, data) -> int:
        file, view, done = self.check(), memoryview(data), 0
        try:
            while done < len(view):
                done += os.write(file, view[done:])
        except OSError as error:
            lost = self.count - self.kept + len(self._waiting)
            self.error = RecordingError(
                self.path,
                f"writing ended with an error ({error.strerror or error}); {self.kept} messages in {self._position} "
                f"bytes are safe, the last {lost} are lost",
            )
            with suppress(OSError):
                os.ftruncate(file, self._position)
            self._close()
            raise self.error from error
        self._position += done
        if view and view[0] == Opcode.CHUNK:
            self.kept = self.count
        return done

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Nothing waits here."""

    # what the recording asks

    def check(self) -> int:
        """The file; raises where nothing can be written any more."""
        if self._file is None:
            raise self.error or RecordingError(self.path, "the recording is closed")
        return self._file

    def add_message(self, channel: int, log_time: int, data, publish_time: int, sequence: int) -> None:
        self.check()
        self.count += 1
        self.mcap.add_message(channel, log_time, data, publish_time, sequence)

    def close_chunk(self) -> None:
        """Put every message that was given into the file."""
        if self.is_open and self.kept < self.count:
            self.mcap.flush()

    def _close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            with suppress(OSError):
                os.close(file)

    def finish(self, name: str, data: bytes) -> None:
        """End the file, and write a small one under ``name`` beside it, in place of whatever has that name."""
        self.mcap.finish()
        self._close()
        beside = self.path.with_name(name)
        try:
            write_files({beside: (data,)})
        except InputError as error:
            raise RecordingError(beside, error.reason) from error
