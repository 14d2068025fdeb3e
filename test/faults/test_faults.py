from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from faults import soak, trials
from faults.__main__ import main
from faults.faults import ENDS, FAULTS, GOES_ON, Message
from faults.soak import Growth
from faults.trials import Recorded, Row, Trial, is_alive, judge_recording, judge_words
from kr270_milling.live.graph.graph import NOT_COMPLETE


def test_fault_is_reported_by_name_and_no_process_remains(ros_environment, monkeypatch, capsys):
    monkeypatch.setattr(trials, "NAMED_WITHIN", 60.0)  # the table of a quiet machine has the delay of the report
    assert main(["--only", "cutting_process, SIGKILL", "--repeats", "1"]) == 0
    *_, row = capsys.readouterr().out.splitlines()
    name, repeats, detected, *rest = row.strip("| ").split(" | ")
    assert (name, repeats) == ("cutting_process, SIGKILL", "1") and float(detected) >= 0.0
    design = "the run ends with a sentence; the recording is closed"
    assert rest == ["1 of 1", design, "0", "complete up to the fault, no hole"]
    assert main(["--only", "earthquake"]) == 2
    errors = capsys.readouterr().err
    assert "'earthquake'" in errors and "disk full" in errors


def test_reaction_other_than_the_designed_one_fails_the_row():
    """A killed cut where the design is that the pass continues, and a name that no message contains."""
    killed = next(fault for fault in FAULTS if fault.name == "cutting_process, SIGKILL")
    messages = [Message(11.0, "cutting_process: was ended by SIGKILL")]
    graph = SimpleNamespace(messages=messages, struck_at=10.0)
    right, wrong = (Trial(0.5, reaction=ENDS) for _ in range(2))
    judge_words(right, killed, graph)
    assert right.problems == [] and right.detected_s == 1.0
    judge_words(wrong, replace(killed, process="recorder", reaction=GOES_ON), graph)
    assert any("not named" in problem for problem in wrong.problems)
    assert any("run ends: cutting_process: was ended by SIGKILL" in problem for problem in wrong.problems)


def test_tail_that_a_recorder_lost_is_counted_and_a_tail_that_is_not_reported_fails_the_row(monkeypatch):
    stopped = next(fault for fault in FAULTS if fault.name.startswith("recorder, SIGSTOP"))
    recorded = Recorded(False, True, 0, 7, 0.0, False, True, "")
    monkeypatch.setattr(trials, "read_back", lambda *_: recorded)
    warned = [Message(11.0, f"recorder: {NOT_COMPLETE}")]
    for messages, problems in ((warned, 0), ([], 1)):
        done = Trial(0.5, reaction=GOES_ON)
        graph = SimpleNamespace(messages=messages, struck_wall_ns=0, recording=None)
        judge_recording(done, stopped, graph, None, False)
        assert len(done.problems) == problems
        assert Row(stopped, (done,)).cells()[-1] == "1 not whole, lost and counted: 7"


class OwnProcess:
    """A graph whose passes are nothing, in this process."""

    def __init__(self, cell, out, composed):
        self.out = out
        self.children = {"recorder": SimpleNamespace(name="recorder", pid=os.getpid())}

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None: ...

    def run_pass(self, name: str):
        (self.out / name).write_text("")
        return SimpleNamespace(recording=self.out)


def test_soak_measures_every_process_and_loses_nothing(ros_environment, monkeypatch, tmp_path):
    monkeypatch.setattr(soak, "Graph", OwnProcess)
    rows = soak.run_soak(2, 0.6, tmp_path, lambda done, total: None)
    assert [row.name for row in rows] == ["recorder", "runner", "recorder (one long recording)"]
    for row in rows:
        assert row.lost == 0 and len(row.cells()) == len(soak.COLUMNS) and len(row.samples) >= 2
        _, memory, threads, files = row.samples[-1]
        assert memory > 10 and threads >= 1 and files > 3


def test_growth_is_measured_by_its_slope_and_its_handles():
    row = Growth("leaky", "pass", [(i, 80 + 0.2 * i, 5, 10) for i in range(50)])
    assert row.problems == [] and row.growth == pytest.approx(0.2 * 24)
    row.samples = [(i, 80 + 0.6 * i, 5, 10 + i // 40) for i in range(50)]
    assert row.problems == ["memory grew by 14.4 MB, more than 5", "files grew from 10 to 11"]


def test_orphan_is_a_process_that_has_not_ended_also_a_stopped_one():
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    process.send_signal(signal.SIGSTOP)
    assert is_alive(process.pid)
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert not is_alive(process.pid)  # waits only to be reaped
    process.wait()
    assert not is_alive(process.pid)
