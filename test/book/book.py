"""The verification book: a check is a test that also is a row of the table in ``guide/contributing/book.md``.

A check is in the file of its subject. ``python -m pytest --book`` runs the checks alone and prints the table.
"""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass

import pytest
from budget import LONG

__all__ = ["COLUMNS", "NAMES", "ROWS", "Row", "check", "markdown"]

COLUMNS = ("check", "expected", "got", "tolerance", "verdict", "source of the expected value")
NAMES: dict[str, str] = {}  #: of every check that has been imported: the file
ROWS: list[Row] = []  #: of every check that has run in this process


@dataclass(frozen=True)
class Row:
    """What a check expects, why, and what came out."""

    name: str
    expected: float
    got: float
    tolerance: float
    unit: str  #: of the three numbers; empty: a ratio or a count
    at_most: bool  #: got may be anything up to expected + tolerance
    source: str  #: where the expected value comes from

    @property
    def verdict(self) -> str:
        """ok or FAILED; a number that is not finite fails."""
        error = self.got - self.expected if self.at_most else abs(self.got - self.expected)
        return "ok" if error <= self.tolerance and math.isfinite(self.got) else "FAILED"

    @property
    def cells(self) -> tuple[str, ...]:
        """As text, in the order of COLUMNS, with so many digits that the verdict shows."""
        unit = f" {self.unit}" if self.unit else ""
        bound = "<= " if self.at_most else ""
        numbers = (f"{bound}{self.expected:.5g}{unit}", f"{self.got:.5g}", f"{self.tolerance:.2g}")
        return (self.name, *numbers, self.verdict, self.source)


def check(
    name: str, source: str, unit: str = "", at_most: bool = False, cases: tuple[str, Iterable] = ("", ()), long: int = 0
):
    """Decorator: makes a test of a function that returns (expected, got, tolerance).

    cases: names and values as for ``pytest.mark.parametrize``; ``name`` is then a format of them. long: so many of the
    last cases run in a long run and for the table only.
    """
    arguments, values = cases[0].split(), list(cases[1])
    names = [name.format(**dict(zip(arguments, row, strict=True))) for row in values] or [name]

    def decorate(function):
        file = function.__code__.co_filename
        if any(NAMES.setdefault(one, file) != file for one in names):
            raise ValueError(f"{names} are checks of two files")

        @pytest.mark.book
        @functools.wraps(function)
        def test(**given):
            row = Row(name.format(**given), *map(float, function(**given)), unit, at_most, source)
            ROWS.append(row)
            assert row.verdict == "ok", row

        short = values if LONG or "--book" in sys.argv else values[: len(values) - long]
        return pytest.mark.parametrize(arguments, short)(test) if values else test

    return decorate


def markdown(rows: Iterable[Row]) -> str:
    lines = [COLUMNS, ["---"] * len(COLUMNS), *(row.cells for row in rows)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
