"""Read and write tables of measurements as CSV files: named columns in any order; every error has its line."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import InputError, nearest
from kr270_milling.base.files import read_lines, unended

#: decimal sign -> a number with this sign, perhaps with the other one between groups of three digits
NUMBERS = {
    sign: re.compile(rf"[+-]?(?:[1-9][0-9]{{0,2}}(?:\{group}[0-9]{{3}})+|[0-9]*)(?:\{sign}[0-9]+)?(?:[eE][+-]?[0-9]+)?")
    for sign, group in (".,", ",.")
}


@dataclass(frozen=True, eq=False)
class Table:
    """The columns of a CSV file as texts, without empty rows."""

    path: str
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]  #: line of each row in the file

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def texts(self, name: str) -> list[str]:
        """Return one column as texts."""
        column = self.names.index(name)
        return [row[column] for row in self.rows]

    def number(self, name: str, default: float | None = None) -> np.ndarray:
        """Return one column, (n,), with ``default`` for a missing column or value; raise InputError."""
        if name not in self:
            if default is None:
                raise InputError(self.path, f"has no column {name}", 1)
            return np.full(len(self), default)
        return np.array([self._value(t, name, n, default) for t, n in zip(self.texts(name), self.lines, strict=True)])

    def numbers(self, names, default: float | None = None) -> np.ndarray:
        """Return several columns, (n, columns)."""
        return np.stack([self.number(name, default) for name in names], -1)

    def refuse(self, wrong, reason: str) -> None:
        """Raise InputError with the line of the first row where ``wrong`` (n,) is true."""
        if np.any(wrong):
            raise InputError(self.path, reason, self.lines[int(np.argmax(wrong))])

    def _value(self, text: str, name: str, line: int, default: float | None) -> float:
        if not text:
            if default is None:
                raise InputError(self.path, f"has no value in the column {name}", line)
            return default
        try:
            value = float(text.replace("_", "?"))  # Python reads 1_0 as ten
        except ValueError:
            raise InputError(self.path, f"{text[:20]!r} in the column {name} is no number", line) from None
        if not math.isfinite(value):
            raise InputError(self.path, f"the column {name} is not finite", line)
        return value


def read_table(path, known, required=(), whole: bool = False) -> Table:
    """Read a CSV file with a header line; lines that begin with # are comments. Raises InputError.

    known: allowed names of columns; required: names that must be present; whole: the last line must end with a newline.
    """
    lines = read_lines(path)
    rows = _cells(lines, path)
    last = [row[-1] for _, row in rows[-2:] if len(row) == len(rows[0][1])]  # cut off in its last cell, if anywhere
    if whole and (reason := unended(lines)) and not (len(last) == 2 and last[0] == last[1]):
        raise InputError(path, reason, len(lines))
    if not rows:
        raise InputError(path, "holds no table: the first line names the columns", 1)
    line, names = rows[0]
    for name in names:
        if name not in known:
            hint = nearest(name, known, f"; known here: {', '.join(known)}")
            raise InputError(path, f"{name[:40]!r} is not a known column{hint}", line)
        if names.count(name) > 1:
            raise InputError(path, f"the column {name} occurs twice", line)
    for name in required:
        if name not in names:
            raise InputError(path, f"has no column {name}", line)
    for number, row in rows[1:]:
        if len(row) != len(names):
            hint = "; with decimal commas, separate the columns by ;" if len(row) == 2 * len(names) else ""
            raise InputError(path, f"has {len(row)} values where the header has {len(names)}{hint}", number)
    if len(rows) < 2:
        raise InputError(path, "has no row below its header", line)
    return Table(str(path), names, tuple(row for _, row in rows[1:]), tuple(number for number, _ in rows[1:]))


def _cells(lines: list[str], path) -> list[tuple[int, tuple[str, ...]]]:
    """Return the rows that contain a value, with their line numbers.

    A spreadsheet may separate columns by semicolons or tabs, write 1,5 for 1.5, and begin with sep=;.
    """
    header = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    # the first line of a table that a spreadsheet wrote
    if stated := re.fullmatch(r'"?sep=(.)"?\s*', header, re.I):
        separator, lines = stated[1], [line if line is not header else "" for line in lines]
    else:
        separator = "," if "," in header else next((sign for sign in ";\t" if sign in header), ",")
    reader = csv.reader(lines, delimiter=separator)
    try:
        rows = [(number, tuple(map(str.strip, row))) for number, row in enumerate(reader, 1)]
    except csv.Error as error:
        raise InputError(path, f"is no CSV text ({error})", reader.line_num or 1) from None
    rows = [(number, row) for number, row in rows if any(row) and not row[0].startswith("#")]
    return rows if separator == "," else _with_points(rows, separator == ";", path)


def _with_points(rows: list[tuple[int, tuple[str, ...]]], semicolons: bool, path) -> list[tuple[int, tuple[str, ...]]]:
    """Return rows with decimal points alone, whose numbers may have decimal commas and groups of digits.

    1.500 may be 1.5 or 1500: all numbers together show which. Semicolons separate what has decimal commas.
    """
    signs, doubtful = set(NUMBERS), []  # decimal signs that all numbers so far allow, and numbers that allow both
    marked = re.compile(r"[0-9][.,]|[.,][0-9]")
    for number, row in rows:
        for cell in filter(marked.search, row):
            fits = {sign for sign, pattern in NUMBERS.items() if pattern.fullmatch(cell)} or signs
            if not signs & fits:
                raise InputError(path, f"{cell[:20]!r} has another decimal sign than the rows above", number)
            signs &= fits
            doubtful += [(number, cell)] if fits == set(NUMBERS) else []
    if len(signs) > 1 and semicolons and any("," in cell for _, cell in doubtful):
        signs = {","}
    if len(signs) > 1 and doubtful:
        number, cell = doubtful[0]
        reason = f"{cell[:20]!r} may have three decimals or be thousands; write it without the sign"
        raise InputError(path, reason, number)
    sign = min(signs, key=".,".index)
    plain = str.maketrans(sign, ".", "," if sign == "." else ".")
    return [
        (number, tuple(cell.translate(plain) if NUMBERS[sign].fullmatch(cell) else cell for cell in row))
        for number, row in rows
    ]


def write_table(path, names, rows, notes=()) -> None:
    """Write notes as lines with #, the header, then rows of numbers and texts."""
    with open(path, "w", encoding="utf-8", newline="") as stream:
        stream.writelines(f"# {note}\n" for note in notes)
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(rows)
