"""Read text files; an unreadable file gives an error with its line number."""

from __future__ import annotations

import re
from pathlib import Path

from kr270_milling.base.errors import InputError

MOST_BYTES = 1 << 30  # the file is read at once; a block of a tool path has some 30 bytes


def read_lines(path) -> list[str]:
    """Return the lines of a text file; the last item is "" if the file ends with a newline.

    Raises InputError with the line of the first character that is not text.
    """
    try:
        if not Path(path).is_file():  # a directory, a pipe, a device
            raise InputError(path, "is no file" if Path(path).exists() else "is no such file")
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
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


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
