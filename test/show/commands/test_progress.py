"""How far a command is, and tables that squeeze nothing."""

from __future__ import annotations

import io
import re
import sys
import time

import pytest

from kr270_milling.base.column import TextTable
from kr270_milling.show.commands import progress as module
from kr270_milling.show.commands.console import print_table, shown_path
from kr270_milling.show.commands.progress import Progress, progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_count_that_starts_over_is_the_next_pass():
    shown = Progress("learned", most=6)
    for _ in range(3):
        for done in (200, 400):
            shown(done, 400)
    assert shown.label == "learned, pass 3 of at most 6"
    assert shown.state == "0 s so far"  # what follows the last count is not counted


def test_without_a_count_the_time_so_far_is_shown_and_with_a_count_the_time_left(monkeypatch):
    now = [10.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    shown = Progress("report")
    now[0] += 4.0
    assert shown.state == "4 s so far"
    shown(25, 100)
    assert shown.state == "25 %, 12 s left"  # a quarter in 4 s
    shown.say("files")
    assert (shown.label, shown.state) == ("files", "0 s so far")


def test_a_resumed_study_counts_its_pace_from_its_last_end(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    shown = Progress("sweep", unit="chunks", rate="passes", each=8)
    now[0] = 2.0
    shown(51, 100)  # 50 were there before
    assert shown.state == "51 of 100 chunks, 4 passes a second, 98 s left"


def test_off_a_terminal_a_line_comes_every_few_seconds_and_none_of_what_is_quick(capsys, monkeypatch):
    monkeypatch.setattr(module, "LINE_PERIOD", 0.05)
    with progress("milling") as report:
        report(50, 100)
        end = time.monotonic() + 20.0
        shown = ""
        while shown.count("\n") < 2 and time.monotonic() < end:
            time.sleep(0.01)
            shown += capsys.readouterr().err
    assert all(re.fullmatch(r"milling: 50 %, \d+ s left", line) for line in shown.splitlines()) and shown
    monkeypatch.setattr(module, "LINE_PERIOD", 60.0)
    with progress("milling") as report:
        report(1, 100)
    assert capsys.readouterr().err == ""


def test_on_a_terminal_there_is_a_bar_that_vanishes(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr(module, "LOOK_PERIOD", 0.01)
    monkeypatch.setenv("TERM", "xterm")
    with progress("original") as report:
        report(30, 100)
        end = time.monotonic() + 20.0
        while "original: 30 %" not in sys.stderr.getvalue() and time.monotonic() < end:
            time.sleep(0.01)
    assert "original: 30 %" in sys.stderr.getvalue()


@pytest.mark.parametrize("width", ["20", "200"])
def test_no_name_and_no_number_of_a_table_is_squeezed(monkeypatch, width):
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setenv("COLUMNS", width)
    names = ["pass", "largest deviation [um]", "recording"]
    print_table(TextTable("Deviation", names, [["a_long_name_of_a_pass", "12.34", "x" * 60]]))
    shown = sys.stdout.getvalue()
    assert all(word in shown for word in ("a_long_name_of_a_pass", "12.34", "x" * 60, "largest deviation [um]"))
    assert ("│" in shown) == (width == "200") and "…" not in shown


def test_paths_are_shown_from_the_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert shown_path(tmp_path / "out" / "linear") == "out/linear"
    assert shown_path("/elsewhere/out") == "/elsewhere/out" and shown_path("out") == "out"
