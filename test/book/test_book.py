"""Verdicts, the committed table, and checks against what [Klimchik2014] prints: Table 2 and section 6."""

import contextlib
import functools
import math
import re
import runpy
from pathlib import Path

import book
import numpy as np
import pytest
from book import check

from kr270_milling import read_cell
from kr270_milling.cell.jobs import compensated, mean_force, simulate
from kr270_milling.cell.models import path_of
from kr270_milling.show.report.tables import TABLE_2

FOLDER = Path(__file__).resolve().parent
PAGE = FOLDER.parents[1] / "kr270_milling/guide/contributing/book.md"


def committed() -> list[list[str]]:
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines[2:]]


@pytest.mark.parametrize("at_most", [False, True])
@pytest.mark.parametrize("got", [1.2, 0.8, math.nan, math.inf, -math.inf])
def test_a_check_beyond_its_tolerance_and_one_that_is_no_number_is_a_test_that_fails(got, at_most, monkeypatch):
    for name, empty in (("NAMES", {}), ("ROWS", [])):
        monkeypatch.setattr(book, name, empty)

    @book.check("one", "nowhere", at_most=at_most)
    def test():
        return 1.0, got, 0.1

    with contextlib.nullcontext() if at_most and got == 0.8 else pytest.raises(AssertionError, match="one"):
        test()


def test_the_committed_table_has_every_check_once_and_all_are_ok():
    for file in FOLDER.parent.rglob("test_*.py"):
        if "from book import check" in file.read_text(encoding="utf-8") and str(file) not in book.NAMES.values():
            runpy.run_path(str(file))
    names = [re.sub(r"\|", r"\\|", name) for name in book.NAMES]
    assert sorted(row[0] for row in committed()) == sorted(names) and len(names) > 60
    assert {row[4] for row in committed()} == {"ok"} and all(row[5] for row in committed())


# --- Table 2 and the frequencies of section 6 of [Klimchik2014] ---
TABLE = "[Klimchik2014], Table 2"
ORIGINAL, LINEAR = TABLE_2["original"], TABLE_2["linear"]


@functools.cache
def _cell():
    return read_cell("paper.yaml")


@functools.cache
def _pass(name: str):
    return simulate(_cell()) if name == "original" else compensated(_cell(), _pass("original"), name)


@check("original pass: {score}", f"identified: a_p and the damping ratio are fitted to {TABLE}", "m",
       cases=("score share", [("static_deviation", 0.01), ("max_deviation", 0.02)]))  # fmt: skip
def test_original(score, share):
    expected, got = getattr(ORIGINAL, score), getattr(_pass("original").scores, score)
    return expected, got, share * expected


@check("{method} pass: {score}", f"{TABLE}: not above the paper; the other methods, of the customer", "m", at_most=True,
       cases=("method score bound", [
           ("linear", "static_deviation", LINEAR.static_deviation), ("linear", "max_deviation", LINEAR.max_deviation),
           ("spline", "max_deviation", 1.1e-6), ("learned", "max_deviation", 0.5e-6)]))  # fmt: skip
def test_compensated(method, score, bound):
    return bound, abs(getattr(_pass(method).scores, score)), 0.0


@check("low frequency", TABLE, "Hz")
def test_low_frequency():
    return ORIGINAL.low_frequency, _pass("original").scores.low_frequency, 0.01 * ORIGINAL.low_frequency


@check("low frequency after compensation / before", f"{TABLE}: the ringing frequency stays")
def test_same_frequency():
    return 1.0, _pass("linear").scores.ringing_frequency / _pass("original").scores.ringing_frequency, 0.01


@check("high frequency of the force", "8000 rpm x 4 teeth = 533.3 Hz (the paper says about 700) [derived]", "Hz")
def test_tooth_passing():
    ran = _pass("original").result
    force = ran.wrench[ran.time > path_of(_cell()).full_engagement, 1]
    spectrum = np.abs(np.fft.rfft((force - force.mean()) * np.hanning(force.size), 16 * force.size))
    peak = np.fft.rfftfreq(16 * force.size, _cell().exchange.period)[np.argmax(spectrum)]
    return 8000 / 60 * 4, peak, 0.5


@check("mean lateral force of the pass", "81 N: 58.1 um over 0.717 um/N [derived]", "N")
def test_lateral_force():
    return 81.0, mean_force(_pass("original").result)[1], 0.5
