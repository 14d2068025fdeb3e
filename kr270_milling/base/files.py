"""Write output files and directories completely or not at all; read text files."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import shutil
import uuid
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from kr270_milling.base.errors import InputError

FULL = (errno.ENOSPC, errno.EDQUOT)


def write_failure(error: OSError, place) -> str:
    """Return the reason why a place cannot be written, with the size of a full disk or with a remedy."""
    if error.errno in FULL:
        there = next(folder for folder in Path(place).absolute().parents if folder.is_dir())
        size = shutil.disk_usage(there)
        return f"{error.strerror}: {size.free / 1e6:.1f} MB of {size.total / 1e9:.1f} GB are free"
    closed = (errno.EACCES, errno.EPERM, errno.EROFS)
    return f"{error.strerror}{'; choose another folder with --out' * (error.errno in closed)}"


@contextlib.contextmanager
def staged(directory) -> Iterator[tuple[Path, Callable[[str | Path], Path]]]:
    """Write into a temporary directory whose files move to ``directory`` when the block ends without an error.

    Yields the temporary directory and a function that returns the final path of a file. After an error ``directory``
    is unchanged. Files of the same names are replaced. A symbolic link inside ``directory`` is refused, so that no file
    is written elsewhere. Raises InputError if the directory cannot be created, or if another run writes into it.
    """
    final, new, handle = Path(directory), False, -1
    # inside the directory, which may be a mount point: files cannot move between file systems
    draft = final / f".{final.name}.{uuid.uuid4().hex}.part"
    try:  # from the first folder on: Ctrl-C may come at any place
        try:
            if final.exists() and not final.is_dir():
                raise InputError(final, "is a file, but must be a directory to write into")
            new = not final.exists()
            draft.mkdir(parents=True)
            handle = os.open(final, os.O_RDONLY)
        except OSError as error:
            raise InputError(final, f"cannot be written into ({write_failure(error, final)})") from None
        _lock(handle, final, draft)
        yield draft, lambda path: final / Path(path).relative_to(draft)
        _move(draft, final)
    except OSError as error:
        if error.errno not in FULL:
            raise
        raise InputError(final, f"cannot be written into ({write_failure(error, final)})") from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        if new:
            with contextlib.suppress(OSError):  # not empty: files were written
                final.rmdir()
        if handle >= 0:
            os.close(handle)


def _lock(handle: int, directory: Path, draft: Path) -> None:
    """Lock a directory for this run; the system unlocks it when the process ends, in whatever way.

    Drafts other than ``draft`` are removed: no run writes them.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        reason = "another run writes into it: wait for its end, or choose another directory"
        raise InputError(directory, reason) from None
    except OSError:  # a file system without locks
        return
    for left in directory.glob(f".{directory.name}.*.part"):  # of a run that was killed
        if left != draft:
            shutil.rmtree(left, ignore_errors=True)


def _move(draft: Path, final: Path) -> None:
    files = [path for path in sorted(draft.rglob("*")) if path.is_file()]
    places = {path: final / path.relative_to(draft) for path in files}
    for place in places.values():
        for parent in place.parents:
            if parent == final:
                break
            if parent.is_symlink() or (parent.exists() and not parent.is_dir()):
                raise InputError(parent, "must be a directory to write into, not a link or a file")
        if place.is_dir() and not place.is_symlink():
            raise InputError(place, "is a directory where a file is to be written")
    try:
        for path, place in places.items():
            place.parent.mkdir(parents=True, exist_ok=True)
            path.replace(place)
    except OSError as error:
        raise InputError(final, f"cannot be written into ({write_failure(error, final)})") from None


def write_files(contents: dict[Path, Iterable], newline: str = "\n") -> None:
    """Write several files from pieces of text or of bytes; raise InputError.

    Either all files appear under their names and replace existing files, or none does. A power cut may leave some.
    Missing folders are made.
    """
    parts = {Path(path): Path(path).with_name(f".{Path(path).name}.{os.getpid()}.part") for path in contents}
    try:
        for path, pieces in contents.items():
            part = parts[Path(path)]
            part.parent.mkdir(parents=True, exist_ok=True)
            part.unlink(missing_ok=True)
            _write(part, iter(pieces), newline)
        for path, part in parts.items():
            part.replace(path)
    except OSError as error:
        drafts = {str(part): path for path, part in parts.items()}
        place = drafts.get(error.filename) or error.filename or next(iter(contents), "output")
        raise InputError(place, f"cannot be written ({write_failure(error, place)})") from None
    finally:
        for part in parts.values():
            with contextlib.suppress(OSError):  # a folder that is missing or no folder
                part.unlink()


def _write(path: Path, pieces: Iterator, newline: str) -> None:
    first = next(pieces, "")
    text = isinstance(first, str)
    # a file name inside the text may contain bytes that are not UTF-8
    options: dict = dict(encoding="utf-8", errors="backslashreplace", newline=newline) if text else {}
    with open(path, "x" if text else "xb", **options) as stream:
        stream.write(first)
        stream.writelines(pieces)


def fresh_directory(out) -> Path:
    """Return ``out``, or a new ``out/run_N`` where ``out`` contains recordings: recordings are never overwritten."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    if not any(out.glob("*.mcap")) and not any(out.glob("*/*.mcap")) and not (out / "cell.yaml").exists():
        return out
    for number in range(2, 100_000):
        try:
            (out / f"run_{number}").mkdir()
        except FileExistsError:
            continue
        return out / f"run_{number}"
    raise FileExistsError(f"{out}: contains too many runs")


MOST_BYTES = 1 << 30  # the file is read at once; a block of a tool path has some 30 bytes


def read_lines(path) -> list[str]:
    """Return the lines of a text file; the last item is "" if the file ends with a newline.

    Raises InputError with the line of the first character that is not text.
    """
    try:
        if not Path(path).is_file():  # a directory, a pipe, a device
            kind = "a directory, not a file" if Path(path).is_dir() else "no file"
            raise InputError(path, f"is {kind if Path(path).exists() else 'no such file'}")
        if Path(path).stat().st_size > MOST_BYTES:
            raise InputError(path, f"has more than {MOST_BYTES} bytes; cut the path in pieces")
        data = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if not data.strip():
        raise InputError(path, "the file is empty", 1)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(path, "the file is UTF-16 text; save it as UTF-8 or ASCII", 1)
    null = data.find(b"\0")
    if null >= 0:
        before = data[:null].replace(b"\r\n", b"\n")
        line = before.count(b"\n") + before.count(b"\r") + 1
        raise InputError(path, "holds a zero byte, so it is no text file", line)
    text = data.decode(encoding_of(data)).removeprefix("\ufeff")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    sizes = list(map(len, lines))
    longest = 4096  # characters; controls take 80 to 512
    if max(sizes) > longest:
        line = next(n for n, size in enumerate(sizes, 1) if size > longest)
        raise InputError(path, f"the line has {sizes[line - 1]} characters, more than {longest}", line)
    return lines


def encoding_of(data: bytes) -> str:
    """Return UTF-8, or Latin-1 for a text that is not UTF-8, as posts write the comment (Müller)."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def unended(lines: list[str]) -> str:
    """Return the reason why a file without a final newline is refused; "" for a complete file.

    Such a file may be cut off in the middle of its last number, unless its last line repeats an earlier one.
    """
    reason = "the file ends in the middle of a line, so it may be cut off; if it is whole, end its last line"
    block_number = re.compile(r"\AN[ \t]*[0-9]+", re.I)
    last, *earlier = (block_number.sub("", line.strip()).strip() for line in lines[::-1])
    longer = {line for line in earlier if line.startswith(last)} if last else {last}
    return "" if longer == {last} else reason


def short(text: str) -> str:
    """Return the beginning of a text from a file, for an error message."""
    return text if len(text) <= 20 else text[:20] + "..."
