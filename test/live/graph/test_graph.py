"""The graph as processes: its results, its messages when a node fails, and its end."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from ros_domain import running

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from kr270_milling.base.errors import MillingError
from kr270_milling.base.files import fresh_directory
from kr270_milling.cell.jobs import compensated, compensator, record_of, simulate
from kr270_milling.cell.models import path_of
from kr270_milling.cli import main
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.live.graph import QUIET, Child, Driver, Graph, stop
from kr270_milling.live.ros import node, topics
from kr270_milling.live.ros.node import LOST, NOT_COMPLETE, Silence
from kr270_milling.live.ros.readiness import Report
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.recordings.messages.definitions import deserialise
from kr270_milling.show.commands import run as commands

SHORT = ["path.length_mm=4", "stock.grid_step_um=20", "stock.max_mm=[4,12,0]"]
MANY = ["path.length_mm=6", "stock.grid_step_um=50", "exchange.period_ms=0.125"]  # longer passes, to be disturbed
NODES = ["compliant_robot", "cutting_process", "trajectory_compensator", "recorder"]
CLI = [sys.executable, "-m", "kr270_milling.cli"]
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
LIMIT = 300.0  # [s] for what does not happen


def run_words(out, *arguments, sets=SHORT) -> list[str]:
    pairs = [word for assignment in sets for word in ("--set", assignment)]
    return ["run", "paper.yaml", "--out", str(out), *arguments, *pairs]


def nodes_of(out: Path) -> dict[str, int]:
    """Node -> process id of the nodes that write below a directory, by their command lines."""
    by_name = {}
    for process in psutil.process_iter(["cmdline", "status"]):
        words = process.info["cmdline"] or []
        ours = "kr270_milling.live.nodes" in words and any(str(out) in word for word in words)
        if ours and process.info["status"] != psutil.STATUS_ZOMBIE:
            by_name |= dict.fromkeys(set(NODES) & set(words), process.pid)
    return by_name


def wait_until(condition, what: str):
    end = time.monotonic() + LIMIT
    while not (value := condition()):
        assert time.monotonic() < end, what
        time.sleep(0.02)
    return value


def same(recorded, plain) -> None:
    for field in ("time_ns", "target", "reference", "tool", "deflection", "wrench", "torque", "removed_volume"):
        assert np.array_equal(getattr(recorded, field), getattr(plain, field)), field


STRANGER = """
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from kr270_milling.live.ros.environment import keep_to_this_host
from sensor_msgs.msg import JointState
keep_to_this_host()
rclpy.init()
node = rclpy.create_node("gripper")
sent = [(node.create_publisher(JointState, "joint_states", 10), JointState(name=["finger"], position=[0.1])),
        (node.create_publisher(WrenchStamped, "wrench", 10), WrenchStamped())]
reports = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
sent.append((reports, DiagnosticArray(status=[DiagnosticStatus(name="/gripper", level=b"\\2")])))
def publish():
    for publisher, message in sent:
        publisher.publish(message)
node.create_timer(0.02, publish)
print("ready", flush=True)
rclpy.spin(node)
"""


def test_run_gives_the_plain_loop_bit_for_bit_while_a_stranger_publishes_what_cannot_be_used(
    ros_environment, tmp_path, capsys, short_cell
):
    """A gripper with errors on joint_states and /diagnostics, wrenches of no frame. A repeated method is run once."""
    methods = ("--method", "linear", "--method", "spline", "--method", "linear")
    with running([sys.executable, "-c", STRANGER], ros_environment, stdout=subprocess.PIPE, text=True) as stranger:
        assert stranger.stdout.readline() == "ready\n"
        assert main(run_words(tmp_path / "o", *methods, "--json")) == 0
    assert not nodes_of(tmp_path)
    printed = capsys.readouterr()
    assert "not complete" not in printed.err
    result = json.loads(printed.out)
    assert [row["name"] for row in result["passes"]] == ["original", "linear", "spline"]
    original = simulate(short_cell)
    plain = [original, *(compensated(short_cell, original, method) for method in ("linear", "spline"))]
    for row, expected in zip(result["passes"], plain, strict=True):
        ran, recorded = pass_from_recording(row["recording"])
        assert recorded.complete and recorded.messages_lost == row["messages_lost"] == 0
        same(ran.result, expected.result)
        with Recording(row["recording"]) as recording:
            assert not recording.cut_off and recording.topics()["/robot_description"].count == 1
        assert row["max_deviation_um"] == expected.scores.max_deviation * 1e6
        assert row["static_deviation_um"] == expected.scores.static_deviation * 1e6
        assert row["real_time_factor"] == pytest.approx(row["duration_s"] / row["wall_s"])
    assert 0 < result["graph_up_s"] < LIMIT
    with Recording(tmp_path / "o" / "spline") as recording:
        reports = [deserialise(DIAGNOSTICS, m.data).status[0] for m in recording.messages(["/diagnostics"])]
    counted = {(report.name.strip("/"), pair.key) for report in reports for pair in report.values}
    named = {"compliant_robot": "wrench", "trajectory_compensator": "joint_states"}
    assert {(node, f"refused {topic}") for node, topic in named.items()} <= counted
    with Recording(tmp_path / "o" / "original") as recording:
        recorded_topics = recording.topics()
        assert "/tf_static" in recorded_topics
        assert recorded_topics["/tf"].count == recorded_topics["/markers"].count == 2  # 30 a second for 0.06 s


@pytest.mark.parametrize(("lost", "code"), [(0, 0), (1705, 1)])
def test_a_run_whose_recording_lacks_messages_states_them_and_ends_with_1(capsys, monkeypatch, short_cell, lost, code):
    row = commands.RunRow(simulate(short_cell), Path("o"), (0.0,), True, lost, 1.0)
    ran = {"graph_up_s": 1.0, "out": Path("o"), "passes": [row]}
    monkeypatch.setattr("kr270_milling.show.commands.run.run_passes", lambda *_, **__: ran)
    assert main(run_words("o")) == code
    out = capsys.readouterr().out
    assert (f"{lost} messages are missing in the recordings" in out) == bool(lost)
    assert f" {lost} " in next(line for line in out.splitlines() if "original" in line)


def test_recordings_are_never_overwritten(tmp_path):
    """Neither those of passes nor that of an RSI session, which is in the directory itself."""
    for expected, name in (("o", "cell.yaml"), ("o/run_2", ""), ("o/run_3", ""), ("r", "r.mcap"), ("r/run_2", "")):
        directory = fresh_directory(tmp_path / expected[0])
        assert directory == tmp_path / expected
        (directory / (name or "run.mcap")).write_text("")


def whole_passes(out: Path) -> list[Path]:
    """The passes whose recordings are closed, in their order."""
    return [file.parent for file in sorted(out.glob("*/metadata.yaml"), key=lambda file: file.stat().st_mtime)]


def test_of_runs_at_once_and_later_one_continues_on_this_host_until_a_signal_and_the_others_are_refused(
    ros_environment, tmp_path, capsys
):
    ends = {"environment": ros_environment, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    words = {name: [*CLI, *run_words(tmp_path / name, "--passes", "1000", sets=MANY)] for name in "ab"}
    with running(words["a"], **ends) as one, running(words["b"], **ends) as other:
        wait_until(lambda: {one.poll(), other.poll()} != {None}, "no run is refused")
        (refused, first, out) = (one, other, tmp_path / "b") if other.poll() is None else (other, one, tmp_path / "a")
        assert refused.wait() == 2 and "already runs in this ROS domain" in refused.stderr.read()
        wait_until(lambda: whole_passes(out), "no pass ends")
        pids = nodes_of(out)
        assert sorted(pids) == sorted(NODES) and len(set(pids.values())) == 2
        for pid in (*pids.values(), first.pid):
            assert {socket.laddr.ip for socket in psutil.Process(pid).net_connections()} == {"127.0.0.1"}
        assert main(run_words(tmp_path / "c", "--passes", "1")) == 2
        errors = capsys.readouterr().err
        assert "already runs in this ROS domain" in errors and errors.count("\n") == 1
        assert not list((tmp_path / "c" / "log").iterdir())  # messages of its nodes would reach the first graph
        done = len(whole_passes(out))  # the pass in which the other graph came up is the next
        wait_until(lambda: len(whole_passes(out)) > done + 1, "no further pass ends")
        first.send_signal(signal.SIGHUP)  # as SIGTERM
        _, errors = first.communicate(timeout=LIMIT)
    assert first.returncode == 128 + signal.SIGHUP and "Traceback" not in errors
    assert not nodes_of(tmp_path)
    *whole, last = whole_passes(out)
    assert len(whole) > done and all(pass_from_recording(path)[1].messages_lost == 0 for path in whole)
    with Recording(last) as recording:
        assert not recording.cut_off


def test_a_namespace_with_one_process_a_node_is_not_disturbed_by_a_graph_of_the_same_names(
    world, ros_environment, tmp_path, capsys, monkeypatch, short_cell
):
    """And Ctrl-C after the passes ends the run."""
    for space in ("/", "/right"):
        for name in NODES:
            partner = world.partner(name, space)
            publishers = [partner.create_publisher(*topics.BY_NAME[t]) for t in ("tool_pose", "reference_trajectory")]
            publishers[1].publish(to_bytes(path_of(short_cell).target))
    monkeypatch.setattr("kr270_milling.show.commands.run.table_of", lambda *_: os.kill(os.getpid(), signal.SIGINT))
    assert main(run_words(tmp_path, "--namespace", "left", "--passes", "1", "--processes")) == 130
    out, errors = capsys.readouterr()
    assert not out and errors.endswith("interrupted\n")
    recorded = tmp_path / "original"
    same(pass_from_recording(recorded)[0].result, simulate(short_cell).result)
    again = recompute(recorded)
    assert again.verdict == "identical", str(again.first)
    with Recording(recorded) as recording:
        assert "/left/clock" in recording.topics()
        assert {name for name in recording.topics() if not name.startswith("/left/")} == {"/diagnostics"}
    assert {f"{node}.log" for node in NODES} == {file.name for file in (tmp_path / "log").iterdir()}


# --- which passes a run makes, with a graph whose passes are simulated at once ---


@pytest.fixture
def run(monkeypatch, short_cell):
    """Runs a plan for a cell with other parameters of the compensation; returns graph, rows and names of its passes."""

    def run(methods, passes=None, **parameters):
        cell = short_cell.replace(compensation=short_cell.compensation.replace(**parameters))
        graph, ran = compensator(cell, path_of(cell).target), {}

        def run_pass(name: str) -> tuple:
            ran[name] = simulate(cell, graph.reference, name)
            graph.revise(record_of(cell, ran[name].result))
            return Path(name), 1.0, tuple(graph.errors), graph.finished

        def recorded(recording, name, namespace):
            return ran[str(recording)], SimpleNamespace(lost_to_end=0)

        graph.cell, graph.driver, graph.run_pass = cell, SimpleNamespace(namespace="/"), run_pass
        monkeypatch.setattr(commands, "pass_from_recording", recorded)
        return graph, commands.run_plan(graph, methods, passes), list(ran)

    return run


@pytest.mark.parametrize(("methods", "passes", "names"), [
    (["linear", "spline"], None, ["original", "linear", "spline"]),
    (["linear"], 3, ["original", "linear", "linear_2"]),
    (["learned"], 1, ["original"]),
])  # fmt: skip
def test_each_method_that_does_not_repeat_makes_one_pass_or_the_given_number(run, methods, passes, names):
    _, rows, _ = run(methods, passes)
    assert [row.scored.name for row in rows] == names
    assert not any(row.learning for row in rows)


@pytest.mark.parametrize("method, repeat", [("learned", False), ("spline", True)])
def test_a_method_that_repeats_continues_until_the_compensator_is_finished_as_off_line(run, method, repeat):
    """The compensator is asked; the method's name decides nothing."""
    graph, (original, best), ran = run([method], repeat=repeat, max_passes=4)
    assert graph.finished and 2 <= len(best.learning) <= 4
    assert ran == ["original", *(f"{method}_{n + 1}" for n in range(len(best.learning)))]
    off_line = compensated(graph.cell, original.scored, method)
    assert best.scored.name == method
    np.testing.assert_equal(dataclasses.asdict(best.scored.scores), dataclasses.asdict(off_line.scores))


def test_the_original_pass_is_the_best_where_no_revision_helps(run):
    _, (original, best), _ = run(["spline"], repeat=True, max_correction=1e-9)
    assert len(best.learning) >= 1 and best.scored.scores.max_deviation <= original.scored.scores.max_deviation


# --- what the runner takes from the reports and the ends of the nodes ---


@pytest.fixture
def children(tmp_path, monkeypatch):
    """Start children that run a script in place of a node; its words: -m, module, node and one more."""

    def start(script: str, **words: str) -> dict[str, Child]:
        program = tmp_path / "node"
        program.write_text(f"#!{script}")
        program.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(program))
        return {name: Child((name,), [word], tmp_path) for name, word in words.items()}

    return start


def test_of_two_nodes_that_have_ended_the_first_one_is_named(children, tmp_path):
    graph = Graph(None, tmp_path)
    words = dict(zip(NODES, ("0.3", "0", "9", "9"), strict=True))
    graph.children = children("/bin/sh\nsleep $4; echo gone; exit 1\n", **words)
    wait_until(lambda: sum(not child.alive for child in graph.children.values()) >= 2, "the children do not end")
    try:
        with pytest.raises(MillingError, match=r"^cutting_process: ended with exit code 1 \(gone; see "):
            graph.check()
    finally:
        graph.stop()


def test_a_stopped_node_may_still_close_its_file_and_a_node_that_does_not_leave_is_killed(children):
    """The middleware may block a node that leaves: no signal but SIGKILL reaches it."""
    script = f"""{sys.executable} -IS
import signal, sys, time
if sys.argv[4] == "leaves":
    signal.signal(signal.SIGINT, lambda *_: sys.exit())
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
print("up", flush=True)
time.sleep(1000)
"""
    both = children(script, recorder="leaves", cutting_process="blocks")
    for child in both.values():
        wait_until(child.last_line, "the child is not up")
    both["recorder"].signal(signal.SIGSTOP)
    assert stop(both.values()) == ["cutting_process"]
    assert both["recorder"].process.wait(LIMIT) == 0


def test_silent_node_is_reported_once_and_then_ends_the_run_and_not_the_one_that_misses_its_messages(
    tmp_path, monkeypatch
):
    now, sentences = [0.0], []
    monkeypatch.setattr(node, "time", SimpleNamespace(monotonic=lambda: now[0]))
    silence, graph = Silence(), Graph(None, tmp_path)
    other = SimpleNamespace(seconds=lambda: 0.1, is_due=lambda *_: False)
    silences = dict.fromkeys(NODES, other) | {"cutting_process": silence}
    graph.driver = SimpleNamespace(error=None, silences=silences)
    graph.children = dict.fromkeys(NODES, SimpleNamespace(alive=True))
    graph.warn = sentences.append

    def wait(seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            now[0] += 0.1
            graph.check()

    wait(9.0)  # not in mid-pass: a long computation
    now[0] += 10.0
    graph._in_pass = True
    wait(QUIET)  # this process itself was stopped
    assert not sentences
    wait(QUIET)
    assert sentences == ["cutting_process: has not reported for 1 s; waiting"]
    with pytest.raises(MillingError, match="cutting_process: has not reported for 4 s"):
        wait(LOST)


@pytest.mark.parametrize(("silent", "blamed"), [
    ("cutting_process", "^cutting_process: has not reported for 5 s"), ("", "^compliant_robot: no wrench for 4 s"),
])  # fmt: skip
def test_of_an_error_a_node_that_is_silent_is_blamed_and_not_the_one_that_misses_its_messages(
    tmp_path, monkeypatch, silent, blamed
):
    """Reports are late on a busy machine, also those of nodes that work."""
    now, graph = [100.0], Graph(None, tmp_path)
    monkeypatch.setattr("kr270_milling.live.graph.time", SimpleNamespace(monotonic=lambda: now[0]))
    late = {"compliant_robot": 99.9, "cutting_process": 97.0, "trajectory_compensator": 98.0, "recorder": 95.0}
    silences = dict.fromkeys(NODES, SimpleNamespace(seconds=lambda: 0.1, is_due=lambda *_: False))
    graph.driver = SimpleNamespace(error=(NODES[0], "no wrench for 4 s"), silences=silences, arrivals=late)
    graph.children, graph._in_pass = dict.fromkeys(NODES, SimpleNamespace(alive=True)), True
    graph.check()
    now[0] += 1.5
    graph.check()
    late.update({node: now[0] for node in NODES if node != silent})
    now[0] += 0.6
    with pytest.raises(MillingError, match=blamed):
        graph.check()


def test_silence_counts_in_mid_pass_alone(tmp_path):
    graph, in_pass = Graph(None, tmp_path), {}
    graph.begin_recording = graph.end_recording = lambda *_: None
    values = {
        "wall_s": "1.5",
        "remaining_error_um": "[2.0, 1.0]",
        "finished": "True",
        "recording": "",
        "waiting_for": "",
    }
    graph.driver = SimpleNamespace(
        until=lambda condition, what, *_: in_pass.update({what: graph._in_pass}),
        transition=lambda *_, deadline: None,
        value=lambda node, key: values.get(key),
    )
    ran = graph.run_pass("original")
    assert (in_pass["the pass"], in_pass["revising"]) == (True, False)
    assert ran == (tmp_path / "original", 1.5, (2e-6, 1e-6), True)


@pytest.mark.parametrize("node", NODES[:2] + NODES[3:])
def test_a_node_that_reports_an_incomplete_recording_is_named_after_the_pass(tmp_path, node):
    graph, sentences, calls = Graph(None, tmp_path), [], []
    reports = {name: Report(0, "stopped", {"state": "inactive"}) for name in NODES}
    reports[node] = Report(1, f"3 messages were lost; {NOT_COMPLETE}", {"state": "inactive"})
    graph.driver = SimpleNamespace(
        reports=reports,
        value=lambda name, key: reports[name].values[key],
        transition=lambda *words, deadline: calls.append(words),
        until=lambda condition, *_: condition(),
    )
    graph.warn = sentences.append
    graph.end_recording()
    assert sentences == [f"{node}: 3 messages were lost; its recording is not complete"]
    assert calls == [("deactivate", "recorder"), ("cleanup", NODES[1]), ("configure", NODES[1])]


def test_reports_of_another_process_under_our_name_are_ignored(ros_environment, world):
    sent = world.partner("recorder").create_publisher(*topics.DIAGNOSTICS)
    driver = Driver("", lambda: None)

    def publish(level: bytes, message: str, process: str) -> None:
        values = [KeyValue(key="process", value=process)]
        status = DiagnosticStatus(level=level, name="/recorder", message=message, values=values)
        sent.publish(DiagnosticArray(status=[status]))

    try:
        driver.expect("recorder", 1)
        driver.until(sent.get_subscription_count, "matching", LIMIT)
        publish(DiagnosticStatus.OK, "recording", "1")
        driver.until(lambda: driver.reports, "the report", LIMIT)
        publish(DiagnosticStatus.ERROR, "the directory is there already", "2")
        driver.until(lambda: driver.foreign, "the other report", LIMIT)
        assert driver.reports["recorder"].message == "recording" and driver.error is None
    finally:
        driver.node.destroy_node()
        driver.node.context.try_shutdown()
