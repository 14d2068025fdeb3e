"""A new file inside a directory, written straight to the kernel, which never leaves that directory."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from kr270_milling.base.errors import RecordingError

__all__ = ["Sink", "plain_name", "open_directory", "write_new"]


def plain_name(path, name: str) -> str:
    """``name`` if it is the name of a file in a directory and nothing more."""
    if not name or name in (".", "..") or "/" in name or "\0" in name or len(name.encode()) > 200:
        raise RecordingError(path, f"{name[:80]!r} is not a file name")
    return name


def open_directory(path: Path) -> int:
    """A handle of a directory that is made if it is missing; a symbolic link in its place is refused."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            path.mkdir()
        return os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError as error:
        raise RecordingError(path, f"no recording can be written into this directory: {error.strerror}") from error


def write_new(directory: int, path: Path, name: str, data: bytes) -> None:
    """Write a small file at once under its name, replacing whatever has that name, a link included."""
    part = f".{name}.part"
    try:
        with suppress(FileNotFoundError):
            os.unlink(part, dir_fd=directory)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        with os.fdopen(os.open(part, flags, 0o666, dir_fd=directory), "wb") as stream:
            stream.write(data)
        os.replace(part, name, src_dir_fd=directory, dst_dir_fd=directory)
    except OSError as error:
        with suppress(OSError):
            os.unlink(part, dir_fd=directory)
        raise RecordingError(path / name, f"cannot be written: {error.strerror}") from error


class Sink:
    """What mcap's Writer writes to. No buffer of our own: what was written survives a SIGKILL.

    ``position`` is the end of the last piece that was written whole; every piece is one or more whole records.
    """

    def __init__(self, directory: int, path: Path):
        self.path, self.position, self.chunks = path, 0, 0
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        try:
            self._file = os.open(path.name, flags, 0o666, dir_fd=directory)
        except FileExistsError:
            raise RecordingError(path, "exists already and is not overwritten") from None
        except OSError as error:
            raise RecordingError(path, f"cannot be created: {error.strerror}") from error

    def write(self, data) -> int:
        view, done = memoryview(data), 0
        while done < len(view):
            done += os.write(self._file, view[done:])
        self.position += done
        self.chunks += bool(done) and view[0] == 0x06
        return done

    def tell(self) -> int:
        return self.position

    def flush(self) -> None:
        """Nothing waits here."""

    def close(self, keep: int | None = None) -> None:
        """Close the file, cut to its first ``keep`` bytes if given."""
        file, self._file = self._file, None
        if file is None:
            return
        with suppress(OSError):
            if keep is not None:
                os.ftruncate(file, keep)
        os.close(file)
