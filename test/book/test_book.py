"""How verdicts are given, and that the committed table is what the checks say."""

from __future__ import annotations

import math
import re
import runpy
from pathlib import Path

import book
import pytest

FOLDER = Path(__file__).resolve().parent


def committed() -> list[list[str]]:
    lines = [line for line in (FOLDER / "README.md").read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines[2:]]


@pytest.mark.parametrize(("got", "at_most", "verdict"), [
    (1.05, False, "ok"), (0.95, False, "ok"), (1.2, False, "FAILED"), (0.8, False, "FAILED"),
    (-5.0, True, "ok"), (1.05, True, "ok"), (1.2, True, "FAILED"),
    *((value, at_most, "FAILED") for value in (math.nan, math.inf, -math.inf) for at_most in (True, False)),
])  # fmt: skip
def test_a_number_beyond_its_tolerance_and_what_is_not_a_number_fails(got, at_most, verdict):
    assert book.Row("one", 1.0, got, 0.1, "m", at_most, "nowhere").verdict == verdict


def test_a_check_that_fails_is_a_test_that_fails():
    names, rows = dict(book.NAMES), list(book.ROWS)

    @book.check("one wrong", "nowhere")
    def test():
        return 1.0, 2.0, 0.5

    with pytest.raises(AssertionError, match="one wrong"):
        test()
    book.NAMES.clear(), book.NAMES.update(names)
    book.ROWS[:] = rows


def test_the_committed_table_has_every_check_once_and_all_are_ok():
    for file in FOLDER.parent.rglob("test_*.py"):
        if "from book import check" in file.read_text(encoding="utf-8") and str(file) not in book.NAMES.values():
            runpy.run_path(str(file))
    names = [re.sub(r"\|", r"\\|", name) for name in book.NAMES]
    assert sorted(row[0] for row in committed()) == sorted(names) and len(names) > 60
    assert {row[4] for row in committed()} == {"ok"} and all(row[5] for row in committed())
