"""An interrupted compensation leaves no half-written program and continues from its last finished pass."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest
from small_part import assignments

from kr270_milling.cell import jobs
from kr270_milling.cli import main

DETAIL = "cutting.detail=engagement"


def words(folder, out, *more: str) -> list[str]:
    pairs = [part for pair in [*assignments(folder), DETAIL] for part in ("--set", pair)]
    return ["compensate", "paper.yaml", "--method", "learned", "--no-verdict", "--out", str(out), *pairs, *more]


@pytest.fixture(autouse=True)
def without_report(monkeypatch):
    def page(directory, *_, **__):
        (directory / "report.html").write_text("figures left out")
        return directory / "report.html"

    monkeypatch.setattr("kr270_milling.show.report.write_report", page)


@pytest.fixture
def passes(monkeypatch) -> list[int]:
    """Grows by one with each simulated pass."""
    count, run = [], jobs.run_pass
    monkeypatch.setattr(jobs, "run_pass", lambda *args: (count.append(1), run(*args))[1])
    return count


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGKILL])
def test_a_killed_run_continues_where_it_stopped_and_ends_the_same(tmp_path, passes, capsys, stop):
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert main(words(tmp_path, whole)) == 0
    all_passes = len(passes)
    run = subprocess.Popen([sys.executable, "-m", "kr270_milling.cli", *words(tmp_path, out)])
    first = out / "unfinished" / "pass_1.bin"
    until = time.monotonic() + 300.0
    while not first.is_file() and run.poll() is None and time.monotonic() < until:
        time.sleep(0.005)
    run.send_signal(stop)
    assert run.wait(60.0) == (130 if stop == signal.SIGINT else -stop)
    assert [path.name for path in out.iterdir() if not path.name.startswith(".")] == ["unfinished"]
    saved = len(list(first.parent.glob("pass_*.bin")))
    passes.clear()
    assert main(words(tmp_path, out, "--resume")) == 0
    assert len(passes) <= all_passes - saved + 1  # the best pass may run once more, for its series
    assert (out / "reference_learned.csv").read_bytes() == (whole / "reference_learned.csv").read_bytes()
    assert not first.parent.exists()
    first.parent.mkdir()
    first.write_bytes(b"half")
    assert main(words(tmp_path, out, "--resume")) == 2
    assert "pass_1.bin: is no finished pass; run without --resume" in capsys.readouterr().err
