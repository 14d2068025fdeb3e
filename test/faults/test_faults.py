import contextlib
import os
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from faults import soak, trials
from faults.__main__ import main
from faults.faults import ENDS, FAULTS, GOES_ON, Message
from faults.trials import Recorded, Row, Trial, judge_recording, judge_words
from kr270_milling.live.ros.node import NOT_COMPLETE

KILLED = "composed: robot and cut, SIGKILL"  #: of two processes, a graph of four takes twice as long


def test_fault_is_reported_by_name_and_no_process_remains(ros_environment, monkeypatch, capsys):
    # the table of a quiet machine has the delays; a busy machine may stop the graph for a while before the fault
    monkeypatch.setattr(trials, "NAMED_WITHIN", 60.0)
    monkeypatch.setattr(trials, "CLOSE", trials.BEHIND)
    assert main(["--only", KILLED, "--repeats", "1"]) == 0
    *_, row = capsys.readouterr().out.splitlines()
    name, repeats, detected, *rest = row.strip("| ").split(" | ")
    assert (name, repeats) == (KILLED, "1") and float(detected) >= 0.0
    design = "the run ends with a sentence; the recording is closed"
    assert rest == ["1 of 1", design, "0", "complete up to the fault, no hole"]


def test_reaction_and_recording_other_than_the_designed_ones_fail_the_row():
    """A killed cut where the design is that the pass continues, and a name that no message contains."""
    killed = next(fault for fault in FAULTS if fault.name == "cutting_process, SIGKILL")
    messages = [Message(11.0, "cutting_process: was ended by SIGKILL")]
    right, wrong = (Trial(reaction=ENDS) for _ in range(2))
    judge_words(right, killed, messages, 10.0)
    assert right.problems == [] and right.detected_s == 1.0
    judge_words(wrong, replace(killed, process="recorder", reaction=GOES_ON), messages, 10.0)
    assert [problem.partition(":")[0] for problem in wrong.problems] == ["not named; messages", "run ends"]
    lacking = Trial(reaction=GOES_ON, recording=Recorded(False, True, 0, 7, 0.0, False, True))
    judge_recording(lacking, [Message(11.0, f"recorder: {NOT_COMPLETE}")], "")
    assert lacking.problems == [] and Row(killed, (lacking,)).cells()[-1].endswith("lost and counted: 7")
    judge_recording(lacking, messages, "")
    assert lacking.problems == ["the recording lacks messages, and no message reports it"]


def own_process(cell, out, composed):
    """In place of a graph: this process, whose passes are nothing."""

    def run_pass(name: str) -> tuple:
        (out / name).write_text("")
        return (out,)

    children = {"recorder": SimpleNamespace(name="recorder", pid=os.getpid())}
    return contextlib.nullcontext(SimpleNamespace(children=children, run_pass=run_pass))


def test_soak_measures_every_process(monkeypatch, tmp_path):
    monkeypatch.setattr(soak, "Graph", own_process)
    rows = soak.run_soak(2, tmp_path)
    assert [row.name for row in rows] == ["recorder", "runner"]
    for row in rows:
        assert len(row.cells()) == len(soak.COLUMNS) and len(row.samples) == 2
        _, memory, threads, files = row.samples[-1]
        assert memory > 10 and threads >= 1 and files > 3
    rows[0].samples = [(i, 80 + 0.6 * i, 5, 10 + i // 40) for i in range(50)]
    assert rows[0].problems == ["memory grew by 14.4 MB, more than 5", "files grew from 10 to 11"]
