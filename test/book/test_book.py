"""How verdicts are given, and that the committed table is what the checks say."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import book
import pytest

FOLDER = Path(__file__).resolve().parent


def verdict(expected, got, tolerance, at_most=False):
    return book.Row("one", expected, got, tolerance, "m", at_most, "nowhere").verdict


def committed() -> list[list[str]]:
    lines = [line for line in (FOLDER / "README.md").read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines[2:]]


def test_a_number_out_of_its_tolerance_on_either_side_fails():
    assert verdict(1.0, 1.05, 0.1) == verdict(1.0, 0.95, 0.1) == "ok"
    assert verdict(1.0, 1.2, 0.1) == verdict(1.0, 0.8, 0.1) == "FAILED"


def test_a_bound_may_be_undercut_and_not_exceeded():
    assert verdict(1.0, -5.0, 0.0, True) == verdict(1.0, 1.0, 0.0, True) == "ok"
    assert verdict(1.0, 1.01, 0.0, True) == "FAILED"


@pytest.mark.parametrize("at_most", [True, False])
@pytest.mark.parametrize("got", [float("nan"), float("inf"), float("-inf")])
def test_what_is_not_a_number_fails(got, at_most):
    assert verdict(1.0, got, 0.1, at_most) == "FAILED"


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
