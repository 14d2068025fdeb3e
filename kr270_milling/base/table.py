"""Tables of measurements as CSV files: named columns in any order, numbers and texts, every fault with its line."""

from __future__ import annotations

import csv
import difflib
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError

__all__ = ["Table", "read_table", "write_table"]

MOST_BYTES = 64 * 1024 * 1024  # some 500,000 rows


@dataclass(frozen=True, eq=False)
class Table:
    """A file's columns as texts; rows without any value are left out."""

    path: str
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]  #: of each row in the file

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def texts(self, name: str) -> list[str]:
        """One column."""
        column = self.names.index(name)
        return [row[column] for row in self.rows]

    def number(self, name: str, default: float | None = None) -> np.ndarray:
        """One column, (n,), ``default`` where the column or the value is missing; raises InputError."""
        if name not in self:
            if default is None:
                raise InputError(self.path, f"has no column {name}", 1)
            return np.full(len(self), default)
        return np.array([self._value(t, name, n, default) for t, n in zip(self.texts(name), self.lines, strict=True)])

    def numbers(self, names, default: float | None = None) -> np.ndarray:
        """Several columns, (n, columns)."""
        return np.stack([self.number(name, default) for name in names], -1)

    def _value(self, text: str, name: str, line: int, default: float | None) -> float:
        if not text:
            if default is None:
                raise InputError(self.path, f"has no value in the column {name}", line)
            return default
        try:
            value = float(text)
        except ValueError:
            raise InputError(self.path, f"{text[:20]!r} in the column {name} is no number", line) from None
        if not math.isfinite(value):
            raise InputError(self.path, f"the column {name} is not finite", line)
        return value


def read_table(path, known, required=()) -> Table:
    """A CSV file with a header line; lines that begin with # are notes. Raises InputError.

    known: names that a column may have; required: those that must be there.
    """
    rows = _cells(path)
    if not rows:
        raise InputError(path, "holds no table: the first line names the columns", 1)
    line, names = rows[0]
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"; did you mean {near[0]}?" if near else f"; known here: {', '.join(known)}"
            raise InputError(path, f"{name[:40]!r} is not a known column{hint}", line)
        if names.count(name) > 1:
            raise InputError(path, f"the column {name} stands twice", line)
    for name in required:
        if name not in names:
            raise InputError(path, f"has no column {name}", line)
    for number, row in rows[1:]:
        if len(row) != len(names):
            raise InputError(path, f"has {len(row)} values where the header has {len(names)}", number)
    if len(rows) < 2:
        raise InputError(path, "has no row below its header", line)
    return Table(str(path), names, tuple(row for _, row in rows[1:]), tuple(number for number, _ in rows[1:]))


def _cells(path) -> list[tuple[int, tuple[str, ...]]]:
    try:
        if not Path(path).is_file():  # a directory, a pipe, a device
            raise InputError(path, "is no file" if Path(path).exists() else "is no such file")
        if Path(path).stat().st_size > MOST_BYTES:
            raise InputError(path, f"has more than {MOST_BYTES} bytes, so it is no table of measurements")
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        if isinstance(error, UnicodeDecodeError):
            raise InputError(path, "is not UTF-8 text") from None
        raise InputError(path, f"cannot be read ({getattr(error, 'strerror', None) or error})") from None
    found = []
    try:
        for number, row in enumerate(csv.reader(text.splitlines()), 1):
            cells = tuple(cell.strip() for cell in row)
            if any(cells) and not cells[0].startswith("#"):
                found.append((number, cells))
    except csv.Error as error:
        raise InputError(path, f"is no CSV text ({error})") from None
    return found


def write_table(path, names, rows, notes=()) -> None:
    """Notes as lines with #, the header, then rows of numbers and texts."""
    with open(path, "w", encoding="utf-8", newline="") as stream:
        stream.writelines(f"# {note}\n" for note in notes)
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(rows)
