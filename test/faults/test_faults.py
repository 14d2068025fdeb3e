from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from faults import soak, trial
from faults.__main__ import main
from faults.aftermath import is_alive
from faults.disturbed import Message
from faults.faults import ENDS, FAULTS, GOES_ON
from faults.rows import run_faults
from faults.soak import Growth
from faults.trial import Trial, judge_words
from kr270_milling.live.graph import graph
from kr270_milling.live.graph.graph import QUIET, Graph
from kr270_milling.live.graph.processes import Child, RunError
from kr270_milling.live.ros import node
from kr270_milling.live.ros.node import LOST
from kr270_milling.recordings.messages.topics import CUT, RECORDER


def test_fault_is_reported_by_name_and_no_process_remains(ros_environment, tmp_path, monkeypatch):
    monkeypatch.setattr(trial, "NAMED_WITHIN", 60.0)  # the table of a quiet machine has the delay of the report
    killed = next(fault for fault in FAULTS if fault.name == "cutting_process, SIGKILL")
    row = run_faults([killed], 1, 1, tmp_path, lambda done, total: None)[0]
    (done,) = row.trials
    assert row.problems == [] and done.detected_s >= 0.0 and "cutting_process" in done.sentence
    assert done.orphans == 0 and done.recording.same and done.recording.messages > 0


def test_reaction_other_than_the_designed_one_fails_the_row():
    """A killed cut where the design is that the pass continues, and a name that no message contains."""
    killed = next(fault for fault in FAULTS if fault.name == "cutting_process, SIGKILL")
    messages = [Message(11.0, "cutting_process: was ended by SIGKILL")]
    graph = SimpleNamespace(messages=messages, struck_at=10.0)
    right, wrong = (Trial(killed.name, 0.5, reaction=ENDS) for _ in range(2))
    judge_words(right, killed, graph)
    assert right.problems == [] and right.detected_s == 1.0
    judge_words(wrong, replace(killed, process="recorder", reaction=GOES_ON), graph)
    assert any("not named" in problem for problem in wrong.problems)
    assert any("run ends: cutting_process: was ended by SIGKILL" in problem for problem in wrong.problems)


FORGETFUL = """#!{python}
import sys, time
from kr270_milling.live.nodes import recording_session, start
take, polls, forgotten = recording_session.poll, [], []
def poll(subscriptions):  # the first poll after a stop
    polls.append(time.monotonic())
    if polls[-1] - polls[-2:][0] > 1.5:
        forgotten.append(True)
    taken = take(subscriptions)
    return [] if forgotten else taken
recording_session.poll = poll
sys.argv = sys.argv[3:]  # after "-m kr270_milling.live.nodes"
raise SystemExit(start.start("recorder"))
"""


def test_tail_that_a_recorder_lost_is_reported_and_counted(ros_environment, tmp_path, monkeypatch):
    """A recorder that receives nothing after a stop, as after its partners have removed it."""
    program = tmp_path / "forgetful"
    program.write_text(FORGETFUL.format(python=sys.executable))
    program.chmod(0o755)

    def child(nodes, *arguments):
        with pytest.MonkeyPatch.context() as only:
            if nodes == (RECORDER,):
                only.setattr(sys, "executable", str(program))
            return Child(nodes, *arguments)

    monkeypatch.setattr(graph, "Child", child)
    monkeypatch.setattr(graph, "LOST", 30.0)
    monkeypatch.setattr(graph, "CATCH_UP", 0.5)
    monkeypatch.setattr(trial, "NAMED_WITHIN", 60.0)
    stopped = next(fault for fault in FAULTS if fault.name.startswith("recorder, SIGSTOP"))
    row = run_faults([stopped], 1, 1, tmp_path, lambda done, total: None)[0]
    (done,) = row.trials
    assert row.problems == []
    assert done.reaction == GOES_ON and not done.recording.complete and done.lost > 0
    assert f"1 not whole, lost and counted: {done.lost}" in row.cells()


def test_soak_measures_every_process_and_loses_nothing(ros_environment, short_cell, monkeypatch, tmp_path):
    monkeypatch.setattr(soak, "fault_cell", lambda: short_cell)
    rows = soak.run_soak(2, 1.8, tmp_path, lambda done, total: None)
    assert len(rows) == 4 and all(row.lost == 0 and len(row.cells()) == len(soak.COLUMNS) for row in rows)
    for row in rows:
        assert row.samples[-1].memory_mb > 10 and row.samples[-1].threads >= 1 and row.samples[-1].files > 3


def test_unknown_fault_is_refused_in_a_sentence(ros_environment, capsys):
    assert main(["--only", "earthquake"]) == 2
    errors = capsys.readouterr().err
    assert "'earthquake'" in errors and "disk full" in errors


def test_growth_is_measured_by_its_slope_and_its_handles():
    row = Growth("leaky", "pass")
    for i in range(50):
        row.look(i, os.getpid())
    assert row.problems == []
    row.samples = [
        replace(s, memory_mb=s.memory_mb + 0.2 * i, files=s.files + i // 40) for i, s in enumerate(row.samples)
    ]
    assert row.growth == pytest.approx(0.2 * 24, abs=0.5)
    assert row.problems == [f"files grew from {row.samples[25].files} to {row.samples[-1].files}"]
    row.samples = [replace(s, memory_mb=3 * s.memory_mb, files=9) for s in row.samples]
    assert len(row.problems) == 1 and "memory grew by 14" in row.problems[0]


class Quiet:
    """A process that has not ended."""

    alive = True


def test_silent_node_is_reported_once_and_then_ends_the_run(short_cell, tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(node, "time", SimpleNamespace(monotonic=lambda: now[0]))
    silence, running = node.Silence(), Graph(short_cell, tmp_path)
    running.driver = SimpleNamespace(error=None, silences={CUT: silence})
    running.children = {CUT: Quiet()}
    sentences: list[str] = []
    running.warn = sentences.append

    def wait(seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            now[0] += 0.1
            running.check()

    wait(9.0)  # not in mid-pass: a long computation
    now[0] += 10.0
    running._in_pass = True
    wait(QUIET)  # this process itself was stopped
    assert not sentences
    wait(QUIET)
    silence.end()
    wait(2 * QUIET)
    assert sentences == [f"{CUT}: has not reported for 1 s; waiting"] * 2
    with pytest.raises(RunError, match="cutting_process: has not reported for 4 s"):
        wait(LOST)


def test_recorder_that_hangs_while_it_closes_its_file_is_ended_with_the_graph(short_cell, tmp_path):
    class Hanging:
        name, pid = "recorder", 0
        process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, start_new_session=True)
        alive = property(lambda self: self.process.poll() is None)

        def signal(self, number: int) -> None:
            self.process.send_signal(number)

    hanging = Hanging()
    hanging.signal(signal.SIGSTOP)
    graph = Graph(short_cell, tmp_path)
    graph.children = {RECORDER: hanging}
    graph.stop()
    assert not hanging.alive
    hanging.process.stdin.close()


def test_orphan_is_a_process_that_has_not_ended_also_a_stopped_one():
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    process.send_signal(signal.SIGSTOP)
    assert is_alive(process.pid)
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert not is_alive(process.pid)  # waits only to be reaped
    process.wait()
    assert not is_alive(process.pid)
