from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sample_messages import pose_msg

pytest.importorskip("rclpy")

from faults import soak, trial
from faults.__main__ import main
from faults.aftermath import is_alive
from faults.disturbed import Message
from faults.domain import choose_domain
from faults.faults import ENDS, FAULTS, GOES_ON
from faults.footprint import footprint, slope
from faults.rows import run_faults
from faults.soak import Growth
from faults.trial import Trial, judge_words
from kr270_milling.live.graph import graph, watchdog
from kr270_milling.live.graph.graph import Graph
from kr270_milling.live.graph.processes import Child, RunError
from kr270_milling.live.graph.watchdog import LOST, QUIET, RECORDER, Watchdog


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
    monkeypatch.setattr(watchdog, "LOST", 30.0)
    monkeypatch.setattr(graph, "CATCH_UP", 0.5)
    monkeypatch.setattr(trial, "NAMED_WITHIN", 60.0)
    stopped = next(fault for fault in FAULTS if fault.name.startswith("recorder, SIGSTOP"))
    row = run_faults([stopped], 1, 1, tmp_path, lambda done, total: None)[0]
    (done,) = row.trials
    assert row.problems == []
    assert done.reaction == GOES_ON and not done.recording.complete and done.lost > 0
    assert f"1 not whole, lost and counted: {done.lost}" in row.cells()


def test_soak_measures_every_process_and_loses_nothing(ros_environment, short_cell, monkeypatch, capsys):
    monkeypatch.setattr(soak, "fault_cell", lambda: short_cell)
    main(["--json", "--soak", "--passes", "2", "--minutes", "0.03"])
    out, errors = capsys.readouterr()
    assert out, errors
    rows = {row["name"]: row for row in json.loads(out)["rows"]}
    assert len(rows) == 4 and all(row["lost"] == 0 for row in rows.values())
    for row in rows.values():
        assert row["settled"]["memory_mb"] > 10 and row["last"]["threads"] >= 1 and row["last"]["files"] > 3


def test_unknown_fault_is_refused_in_a_sentence(ros_environment, capsys):
    assert main(["--json", "--only", "earthquake"]) == 2
    errors = capsys.readouterr().err
    assert "'earthquake'" in errors and "disk full" in errors
    assert f"ROS domain {ros_environment['ROS_DOMAIN_ID']}" in errors


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


def test_slope_is_that_of_a_line():
    times = np.linspace(3.0, 90.0, 31)
    assert slope(times, 7.0 - 0.25 * times) == pytest.approx(-0.25, rel=1e-12)


def test_footprint_counts_open_files():
    before = footprint(os.getpid())
    with open(os.devnull), open(os.devnull):
        assert footprint(os.getpid()).files == before.files + 2
    assert footprint(os.getpid()).threads == before.threads


def test_process_that_only_waits_to_be_reaped_is_no_orphan():
    process = subprocess.Popen([sys.executable, "-c", ""])
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert not is_alive(process.pid) and is_alive(os.getpid())
    process.wait()
    assert not is_alive(process.pid)


def test_domain_of_the_user_has_priority_and_else_a_free_one_is_reported(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert "42" in choose_domain()
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert "free" in choose_domain() and 0 < int(os.environ["ROS_DOMAIN_ID"]) <= 101


def test_timers_of_a_node_run_while_its_clock_does_not_move(world):
    from kr270_milling.live.ros.node import ReportingNode

    node = world.add(ReportingNode, "-p", "use_sim_time:=true", name="still")
    reports = world.diagnostics(world.partner())
    start = node.get_clock().now().nanoseconds
    world.until(lambda: "/still" in reports.last, 3.0)
    assert node.get_clock().now().nanoseconds == start == 0


def silent_for(seconds: float) -> SimpleNamespace:
    """A driver whose nodes have all been silent for this time."""
    return SimpleNamespace(silence=lambda node, now: seconds, stuck=False)


def test_silent_node_is_reported_once_and_then_ends_the_run():
    sentences: list[str] = []
    dog = Watchdog(set(), sentences.append)
    for _ in range(3):
        dog.check_silence(silent_for(QUIET + 0.1), {"cutting_process"}, time.monotonic())
    assert len(sentences) == 1 and "cutting_process" in sentences[0]
    with pytest.raises(RunError, match="cutting_process: has not reported"):
        dog.check_silence(silent_for(LOST + 0.1), {"cutting_process"}, time.monotonic())


def test_node_that_is_excused_may_be_silent():
    Watchdog({"cutting_process"}, pytest.fail).check_silence(silent_for(9.0), {"cutting_process"}, time.monotonic())


def test_runner_that_was_delayed_itself_reads_the_reports_first():
    dog = Watchdog(set(), pytest.fail)
    later = time.monotonic() + 10.0  # it scored a long pass, or was stopped by Ctrl-Z
    dog.check_silence(silent_for(10.0), {"cutting_process"}, later)


def test_second_robot_in_mid_pass_is_reported_by_the_cut(world, short_cell, tmp_path):
    import ros_messages as messages

    from kr270_milling.live.nodes.cutting_process import CuttingProcess
    from kr270_milling.live.ros import topics

    cut = world.add(CuttingProcess, cell=short_cell, directory=tmp_path)
    robot = world.partner("robot")
    reports = world.diagnostics(robot)
    publishers = [robot.create_publisher(*t) for t in (topics.TOOL_POSE, topics.REFERENCE_TRAJECTORY)]
    publishers[1].publish(messages.to_msg(short_cell.target()))
    cut.trigger_configure()
    world.until(lambda: cut._pose.get_publisher_count() == 1 and cut.protocol.end_ns)
    cut.trigger_activate()
    stamps = short_cell.clock.stamp(np.arange(3))
    for stamp, tool in zip(stamps.tolist(), short_cell.target().sample(stamps), strict=True):
        publishers[0].publish(pose_msg(stamp, tool, np.array([1.0, 0.0, 0.0, 0.0])))
        world.until(lambda at=stamp: cut.stamp_ns == at and cut.protocol.step >= 0)
    world.step(0.3)
    assert not reports.reported("/cutting_process", "a second robot")
    world.partner("second").create_publisher(*topics.TOOL_POSE)
    reports.until("/cutting_process", "a second robot publishes in mid-pass", 2, deadline=3.0)


def test_compensator_that_starts_in_mid_pass_reports_the_missing_start(world, short_cell, tmp_path):
    from kr270_milling.live.nodes.trajectory_compensator import TrajectoryCompensator
    from kr270_milling.live.ros import topics

    world.add(TrajectoryCompensator, cell=short_cell, directory=tmp_path)
    machine = world.partner("machine")
    reports = world.diagnostics(machine)
    pose = machine.create_publisher(*topics.TOOL_POSE)
    world.until(pose.get_subscription_count)
    stamps = short_cell.clock.stamp(np.arange(10, 40))
    for stamp, tool in zip(stamps.tolist(), short_cell.target().sample(stamps), strict=True):
        pose.publish(pose_msg(stamp, tool, np.array([1.0, 0.0, 0.0, 0.0])))
    reports.until("/trajectory_compensator", "did not receive its start", 2, deadline=3.0)


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
    graph.close()
    assert not hanging.alive
    hanging.process.stdin.close()


def test_stopped_process_differs_from_an_ended_process():
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    process.send_signal(signal.SIGSTOP)
    assert is_alive(process.pid)
    process.kill()
    process.wait()
