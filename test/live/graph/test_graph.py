"""The graph as processes: its results, its messages when a node fails, and its end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from kr270_milling.cell.jobs import compensated, compensator, record_of, simulate
from kr270_milling.cli import main
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.live.graph import plan
from kr270_milling.live.graph.driver import Driver
from kr270_milling.live.graph.graph import Graph, RunValues
from kr270_milling.live.graph.plan import fresh_directory
from kr270_milling.live.graph.processes import Child, RunError
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.status import Status
from kr270_milling.recordings.bag.reader import Recording

SHORT = ["path.length_mm=4", "stock.grid_step_um=20", "stock.max_mm=[4,12,0]"]
LONG = ["path.length_mm=75", "stock.grid_step_um=50", "exchange.period_ms=0.125"]  # some seconds, to be disturbed
NODES = ["compliant_robot", "cutting_process", "trajectory_compensator", "recorder"]


@pytest.fixture
def runner(ros_environment):
    """Start runs; end the runs that a failed test has not ended."""
    started: list[subprocess.Popen] = []

    def start(out, *arguments, **options):
        started.append(start_run(ros_environment, out, *arguments, **{"sets": SHORT, **options}))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()
        process.communicate()


def run_words(out, *arguments, sets=SHORT) -> list[str]:
    pairs = [word for assignment in sets for word in ("--set", assignment)]
    return ["run", "paper.yaml", "--out", str(out), *arguments, *pairs]


def start_run(environment, out, *arguments, sets, program=("-m", "kr270_milling.cli")):
    command = [sys.executable, *program, *run_words(out, *arguments, sets=sets)]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def finished(process, seconds: float = 300.0) -> tuple[int, str, str]:
    try:
        out, errors = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        out, errors = process.communicate()
        pytest.fail(f"the run hangs: {errors}")
    return process.returncode, out, errors


def nodes_of(out: Path) -> dict[str, int]:
    """Node -> process id of the nodes that write below a directory, by their command lines."""
    nodes_by_name = {}
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            command = Path("/proc", pid, "cmdline").read_bytes().split(b"\0")
            state = Path("/proc", pid, "stat").read_text().rsplit(")", 1)[1].split()[0]
        except OSError:
            continue
        words = [word.decode("utf-8", "replace") for word in command]
        if not {"kr270_milling.live.nodes", "--ros-args"} <= set(words):
            continue
        nodes = words[words.index("kr270_milling.live.nodes") + 1 : words.index("--ros-args")]
        if state != "Z" and any(w.startswith(str(out)) for w in words):
            nodes_by_name |= {node: int(pid) for node in nodes if node != "milling_cell"}
    return nodes_by_name


def wait_until(condition, seconds: float, what: str):
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, what
        time.sleep(0.02)
    return value


def in_mid_pass(out: Path) -> dict[str, int]:
    """Wait until the original pass runs; returns the nodes."""
    logs = [out / "log" / f"{name}.log" for name in ("compliant_robot+cutting_process", "cutting_process")]
    wait_until(
        lambda: any("]: cutting" in log.read_text() for log in logs if log.exists()), 60, "the pass does not start"
    )
    file = out / "original" / "original.mcap"
    wait_until(lambda: file.stat().st_size > 30_000, 30, "nothing of the pass is written")
    return nodes_of(out)


def same(recorded, plain) -> None:
    for field in ("time_ns", "target", "reference", "tool", "deflection", "wrench", "torque", "removed_volume"):
        assert np.array_equal(getattr(recorded, field), getattr(plain, field)), field


def test_run_gives_the_plain_loop_bit_for_bit_and_reports_its_passes(ros_environment, tmp_path, capsys, short_cell):
    methods = ("--method", "linear", "--method", "spline", "--method", "linear")  # a repeated method is run once
    assert main(run_words(tmp_path / "o", *methods, "--json")) == 0
    printed = capsys.readouterr()
    assert "not complete" not in printed.err
    result = json.loads(printed.out)
    assert [row["name"] for row in result["passes"]] == ["original", "linear", "spline"]
    original = simulate(short_cell)
    plain = [original, *(compensated(short_cell, original, method) for method in ("linear", "spline"))]
    for row, expected in zip(result["passes"], plain, strict=True):
        recorded = pass_from_recording(row["recording"])
        assert recorded.complete and recorded.messages_lost == row["messages_lost"] == 0
        same(recorded.scored.result, expected.result)
        assert row["max_deviation_um"] == expected.scores.max_deviation * 1e6
        assert row["static_deviation_um"] == expected.scores.static_deviation * 1e6
        assert row["real_time_factor"] == pytest.approx(row["duration_s"] / row["wall_s"])
    assert 0 < result["graph_up_s"] < 30
    assert not nodes_of(tmp_path)


@pytest.mark.parametrize(("lost", "code"), [(0, 0), (1705, 1)])
def test_a_run_whose_recording_lacks_messages_states_them_and_ends_with_1(capsys, monkeypatch, short_cell, lost, code):
    row = plan.RunRow(RunValues(Path("o"), 1.0, (0.0,), True), simulate(short_cell), lost)
    ran = {"graph_up_s": 1.0, "out": Path("o"), "passes": [row]}
    monkeypatch.setattr("kr270_milling.show.commands.run.run_passes", lambda *_, **__: ran)
    assert main(run_words("o")) == code
    out = capsys.readouterr().out
    assert (f"{lost} messages are missing in the recordings" in out) == bool(lost)
    assert f" {lost} " in next(line for line in out.splitlines() if "original" in line)


def test_recordings_are_never_overwritten(tmp_path):
    for expected in ("o", "o/run_2", "o/run_3"):
        directory = fresh_directory(tmp_path / "o")
        assert directory == tmp_path / expected
        (directory / "cell.yaml").write_text("")


def test_stopped_nodes_end_the_run_with_a_sentence_and_no_process_remains(runner, tmp_path):
    process = runner(tmp_path / "o", "--passes", "1", sets=LONG)
    for pid in set(in_mid_pass(tmp_path / "o").values()):
        os.kill(pid, signal.SIGSTOP)
    code, _, errors = finished(process)
    assert code == 2 and "has not reported for 4 s" in errors
    assert not nodes_of(tmp_path)


def sockets_of(pid: int) -> list[str]:
    """Local addresses of the UDP and TCP sockets of a process."""
    inodes = set()
    for entry in os.listdir(f"/proc/{pid}/fd"):
        target = os.readlink(f"/proc/{pid}/fd/{entry}")
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    addresses = []
    for table in ("udp", "udp6", "tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes:
                addresses.append(fields[1].rpartition(":")[0])
    return addresses


def test_all_sockets_are_on_this_host_and_a_signal_ends_everything_with_a_whole_file(runner, tmp_path):
    process = runner(tmp_path / "o", "--passes", "1", sets=LONG)
    pids = in_mid_pass(tmp_path / "o")
    assert sorted(pids) == sorted(NODES) and len(set(pids.values())) == 2
    for pid in (*pids.values(), process.pid):
        assert set(sockets_of(pid)) == {"0100007F"}  # 127.0.0.1 as /proc writes it
    process.send_signal(signal.SIGTERM)
    code, _, errors = finished(process)
    assert code == 143 and "Traceback" not in errors
    assert not nodes_of(tmp_path)
    with Recording(tmp_path / "o" / "original") as recording:
        assert not recording.cut_off


def test_killed_runner_leaves_no_orphans(runner, tmp_path):
    process = runner(tmp_path / "o", "--passes", "1", sets=LONG)
    in_mid_pass(tmp_path / "o")
    process.kill()
    process.communicate()
    wait_until(lambda: not nodes_of(tmp_path), 30, "orphans are left")
    with Recording(tmp_path / "o" / "original") as recording:
        assert not recording.cut_off


BLOCKS = """
import ctypes, sys
from kr270_milling.live.nodes import start
from rclpy.node import Node
Node.destroy_node = lambda node: ctypes.PyDLL(None).sleep(100)
sys.argv = sys.argv[3:]  # the words after "-m kr270_milling.live.nodes"
raise SystemExit(start.start(sys.argv[0]))
"""


def test_run_kills_a_node_whose_middleware_blocks_while_it_leaves(runner, tmp_path):
    python = tmp_path / "python"
    python.write_text(f"#!{sys.executable}{BLOCKS}")
    python.chmod(0o755)
    program = f"import sys; from kr270_milling.cli import main; sys.executable = {str(python)!r}; main()"
    code, out, errors = finished(runner(tmp_path / "o", "--passes", "1", "--json", program=("-c", program)))
    assert code == 0 and [row["name"] for row in json.loads(out)["passes"]] == ["original"], errors
    assert not nodes_of(tmp_path)


def test_ctrl_c_after_the_passes_ends_the_run_with_130(ros_environment, tmp_path, capsys, monkeypatch):
    def press_ctrl_c(*_):
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("kr270_milling.show.commands.run.table_of", press_ctrl_c)
    assert main(run_words(tmp_path / "o", "--passes", "1")) == 130
    out, errors = capsys.readouterr()
    assert not out and errors.endswith("interrupted\n")
    assert not nodes_of(tmp_path)


def test_second_graph_with_the_same_names_is_refused_and_does_not_disturb_the_first(runner, tmp_path, capsys):
    first = runner(tmp_path / "a", "--passes", "1000", sets=["path.length_mm=25", *LONG[1:]])
    in_mid_pass(tmp_path / "a")
    assert main(run_words(tmp_path / "b", "--passes", "1")) == 2
    errors = capsys.readouterr().err
    assert "already runs in this ROS domain" in errors and errors.count("\n") == 1
    assert not list((tmp_path / "b" / "log").iterdir())  # messages of its nodes would reach the first graph
    done = list((tmp_path / "a").glob("*/metadata.yaml"))  # the pass in which the other graph came up is the next
    wait_until(lambda: len(list((tmp_path / "a").glob("*/metadata.yaml"))) > len(done) + 1, 60, "no pass ends")
    first.send_signal(signal.SIGINT)
    assert finished(first)[0] == 130
    files = sorted((tmp_path / "a").glob("*/*.mcap"), key=lambda file: file.stat().st_mtime)
    with Recording(files[-1]) as recording:
        assert not recording.cut_off
    whole = sorted((tmp_path / "a").glob("*/metadata.yaml"), key=lambda file: file.stat().st_mtime)[:-1]
    assert len(whole) > len(done) and all(pass_from_recording(file.parent).messages_lost == 0 for file in whole)


def test_graphs_in_two_namespaces_give_the_plain_loop_at_once_also_with_one_process_a_node(
    runner, tmp_path, short_cell
):
    names, plain = ("left", "right"), simulate(short_cell).result
    more = {"left": (), "right": ("--processes",)}
    runs = [runner(tmp_path / n, "--namespace", n, "--passes", "1", "--json", *more[n]) for n in names]
    for process, name in zip(runs, names, strict=True):
        code, _, errors = finished(process)
        assert code == 0, errors
        file = tmp_path / name / "original"
        same(pass_from_recording(file).scored.result, plain)
        with Recording(file) as recording:
            other = names[1 - names.index(name)]
            assert not any(topic.startswith(f"/{other}/") for topic in recording.topics())
            assert f"/{name}/clock" in recording.topics() and "/clock" not in recording.topics()
        assert recompute(file).verdict == "identical"
    assert {f"{node}.log" for node in NODES[:3]} <= {file.name for file in (tmp_path / "right" / "log").iterdir()}


# --- which passes a run makes, with a graph whose passes are simulated at once ---


class PlainGraph:
    """What ``run_plan`` needs of a graph."""

    driver = SimpleNamespace(namespace="/")

    def __init__(self, cell):
        self.cell = cell
        self.compensator = compensator(cell, cell.target())
        self.ran: dict[str, object] = {}

    @property
    def repeats(self) -> bool:
        return self.compensator.repeats

    def choose(self, method: str) -> None:
        self.compensator.choose(method)

    def run_pass(self, name: str) -> RunValues:
        self.ran[name] = simulate(self.cell, self.compensator.reference, name)
        self.compensator.revise(record_of(self.cell, self.ran[name].result))
        state = self.compensator
        return RunValues(Path(name), 1.0, tuple(state.errors), state.finished)


@pytest.fixture
def run(monkeypatch, short_cell):
    """Runs a plan for a cell with other parameters of the compensation; returns the graph and the rows."""

    def run(methods, passes=None, **parameters):
        cell = short_cell.replace(compensation=short_cell.compensation.replace(**parameters))
        graph = PlainGraph(cell)

        def recorded(recording, name, namespace):
            return SimpleNamespace(scored=graph.ran[str(recording)], lost_to_end=0)

        monkeypatch.setattr(plan, "pass_from_recording", recorded)
        return graph, plan.run_plan(graph, methods, passes)

    return run


def test_each_method_that_does_not_repeat_makes_one_pass(run):
    _, rows = run(["linear", "spline"])
    assert [row.scored.name for row in rows] == ["original", "linear", "spline"]
    assert not any(row.learning for row in rows)


def test_the_number_of_passes_may_be_given(run):
    _, rows = run(["linear"], 3)
    assert [row.scored.name for row in rows] == ["original", "linear", "linear_2"]
    assert [row.scored.name for row in run(["learned"], 1)[1]] == ["original"]


@pytest.mark.parametrize("method, repeat", [("learned", False), ("spline", True)])
def test_a_method_that_repeats_continues_until_the_compensator_is_finished_as_off_line(run, method, repeat):
    """The compensator is asked; the method's name decides nothing."""
    graph, (original, best) = run([method], repeat=repeat, max_passes=4)
    assert graph.compensator.finished and 2 <= len(best.learning) <= 4
    assert list(graph.ran) == ["original", *(f"{method}_{n + 1}" for n in range(len(best.learning)))]
    off_line = compensated(graph.cell, original.scored, method)
    assert best.scored.name == method and best.scored.scores == off_line.scores


def test_the_original_pass_is_the_best_where_no_revision_helps(run):
    graph, (original, best) = run(["spline"], repeat=True, max_correction=1e-9)
    assert len(best.learning) >= 1 and best.scored.scores.max_deviation <= original.scored.scores.max_deviation


# --- what the runner takes from the reports of the nodes ---


def test_of_two_nodes_that_have_ended_the_first_one_is_named(tmp_path, monkeypatch):
    program = tmp_path / "node"  # called with: -m, module, node, seconds
    program.write_text("#!/bin/sh\nsleep $4; echo gone; exit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    graph = Graph(None, tmp_path)
    graph.children = {node: Child((node,), [seconds], tmp_path) for node, seconds in zip(NODES, "1092", strict=True)}
    wait_until(lambda: sum(not child.alive for child in graph.children.values()) >= 2, 30, "the children do not end")
    try:
        with pytest.raises(RunError, match=r"^cutting_process: ended with exit code 1 \(gone; see "):
            graph.check()
    finally:
        graph.stop()


def test_the_node_that_is_silent_is_named_and_not_the_one_that_misses_its_messages(tmp_path):
    graph = Graph(None, tmp_path)
    graph.children, graph._in_pass = dict.fromkeys(NODES, SimpleNamespace(alive=True)), True
    silences = {
        node: SimpleNamespace(seconds=lambda s=s: s) for node, s in zip(NODES, (0.1, 3.9, 0.1, 1.2), strict=True)
    }
    graph.driver = SimpleNamespace(error=(NODES[0], "no wrench for 4 s"), silences=silences)
    with pytest.raises(RunError, match="^cutting_process: has not reported for 4 s"):
        graph.check()


def test_reports_of_another_process_under_our_name_are_ignored(ros_environment, world):
    sent = world.partner("recorder").create_publisher(*topics.STATUS)
    driver = Driver("", lambda: None)
    try:
        driver.expect("recorder", 1)
        driver.until(sent.get_subscription_count, "matching", 60.0)
        sent.publish(Status(1, 0, "recording").to_msg())
        driver.until(lambda: driver.statuses, "the report", 60.0)
        sent.publish(Status(2, 2, "the directory is there already", "the directory is there already").to_msg())
        driver.until(lambda: driver.foreign, "the other report", 60.0)
        assert driver.statuses["recorder"].message == "recording" and driver.error is None
    finally:
        driver.node.destroy_node()
        driver.node.context.try_shutdown()
