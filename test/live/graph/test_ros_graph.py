"""The graph as processes: what it computes, what it says when a node fails, what it leaves behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.live.graph.plan import fresh_directory
from kr270_milling.recordings.bag.reader import Recording

SHORT = ["path.length_mm=4", "stock.grid_step_um=20", "stock.max_mm=[4,12,0]"]
LONG = ["path.length_mm=75", "stock.grid_step_um=50", "exchange.period_ms=0.125"]  # some seconds, to be disturbed
NODES = ["compliant_robot", "cutting_process", "trajectory_compensator", "recorder"]


@pytest.fixture
def runner(ros_environment):
    """Starts runs; whatever a failed test leaves of them is ended."""
    started: list[subprocess.Popen] = []

    def start(out, *arguments, **how):
        started.append(start_run(ros_environment, out, *arguments, **{"sets": SHORT, **how}))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()
        process.communicate()


def start_run(environment, out, *arguments, sets, program=("-m", "kr270_milling.cli")):
    command = [sys.executable, *program, "run", "paper.yaml", "--out", str(out), *arguments]
    for assignment in sets:
        command += ["--set", assignment]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def finished(process, seconds: float = 300.0) -> tuple[int, str, str]:
    try:
        out, told = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        out, told = process.communicate()
        pytest.fail(f"the run hangs: {told}")
    return process.returncode, out, told


def nodes_of(out: Path) -> dict[str, int]:
    """Node -> process id of the nodes that write below a directory; found by their command lines."""
    found = {}
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
            found |= {node: int(pid) for node in nodes if node != "milling_cell"}
    return found


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


def test_run_gives_the_plain_loop_bit_for_bit_and_tells_so(runner, tmp_path, short_cell):
    methods = ("--method", "linear", "--method", "spline", "--method", "linear")  # one that is given twice is run once
    process = runner(tmp_path / "o", *methods, "--json")
    code, out, told = finished(process)
    assert code == 0, told
    found = json.loads(out)
    assert [row["name"] for row in found["passes"]] == ["original", "linear", "spline"]
    original = simulate(short_cell)
    plain = [original, *(compensated(short_cell, original, method) for method in ("linear", "spline"))]
    for row, expected in zip(found["passes"], plain, strict=True):
        recorded = pass_from_recording(row["recording"])
        assert recorded.complete and recorded.messages_lost == row["messages_lost"] == 0
        same(recorded.scored.result, expected.result)
        assert row["max_deviation_mm"] == expected.scores.max_deviation * 1e3
        assert row["static_deviation_mm"] == expected.scores.static_deviation * 1e3
        assert row["real_time_factor"] == pytest.approx(row["duration_s"] / row["wall_s"])
    assert 0 < found["graph_up_s"] < 30
    assert not nodes_of(tmp_path)


def test_one_process_a_node_gives_the_same_to_the_bit(runner, tmp_path, short_cell):
    code, out, told = finished(runner(tmp_path / "o", "--processes", "--passes", "1", "--json"))
    assert code == 0, told
    file = json.loads(out)["passes"][0]["recording"]
    same(pass_from_recording(file).scored.result, simulate(short_cell).result)
    assert recompute(file).verdict == "identical"
    assert {f"{node}.log" for node in NODES[:3]} <= {file.name for file in (tmp_path / "o" / "log").iterdir()}


def test_namespace_that_cannot_be_is_refused_before_anything_is_written(runner, tmp_path):
    code, _, told = finished(runner(tmp_path / "o", "--namespace", "a b"))
    assert code == 2 and told.count("\n") == 1 and "--namespace: 'a b' must be a ROS namespace" in told
    assert not (tmp_path / "o").exists()


def test_recordings_are_never_overwritten(tmp_path):
    for expected in ("o", "o/run_2", "o/run_3"):
        directory = fresh_directory(tmp_path / "o")
        assert directory == tmp_path / expected
        (directory / "cell.yaml").write_text("")


@pytest.mark.parametrize("node", ["cutting_process", "recorder"])  # of each process; one process a node: test_faults
def test_killed_node_is_named_and_nothing_is_left(runner, tmp_path, node):
    process = runner(tmp_path / "o", "--passes", "1", sets=LONG)
    pids = in_mid_pass(tmp_path / "o")
    os.kill(pids[node], signal.SIGKILL)
    code, _, told = finished(process)
    last = told.splitlines()[-1]  # on a busy machine others may be told as silent before
    together = {name for name, pid in pids.items() if pid == pids[node]}
    assert code == 2 and "SIGKILL" in last and any(name in last for name in together)
    assert not nodes_of(tmp_path)
    with Recording(tmp_path / "o" / "original") as recording:
        assert recording.cut_off == (node == "recorder")
        assert recording.topics()["/wrench"].count > 0


def test_run_that_hears_of_nobody_ends_with_a_sentence_and_leaves_nobody(runner, tmp_path):
    """As when the middleware of its own process is blocked, which leaving the graph would then be as well."""
    process = runner(tmp_path / "o", "--passes", "1", sets=LONG)
    for pid in set(in_mid_pass(tmp_path / "o").values()):
        os.kill(pid, signal.SIGSTOP)
    code, _, told = finished(process)
    assert code == 2 and "no node has reported" in told
    assert not nodes_of(tmp_path)


def sockets_of(pid: int) -> list[str]:
    """Local addresses of the UDP and TCP sockets of a process."""
    inodes = set()
    for entry in os.listdir(f"/proc/{pid}/fd"):
        target = os.readlink(f"/proc/{pid}/fd/{entry}")
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = []
    for table in ("udp", "udp6", "tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes:
                found.append(fields[1].rpartition(":")[0])
    return found


def test_all_sockets_are_on_this_host_and_a_signal_ends_everything_with_a_whole_file(runner, tmp_path):
    process = runner(tmp_path / "o", "--passes", "1", sets=LONG)
    pids = in_mid_pass(tmp_path / "o")
    assert sorted(pids) == sorted(NODES) and len(set(pids.values())) == 2
    for pid in (*pids.values(), process.pid):
        assert set(sockets_of(pid)) == {"0100007F"}  # 127.0.0.1 as /proc writes it
    process.send_signal(signal.SIGTERM)
    code, _, told = finished(process)
    assert code == 143 and "Traceback" not in told
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
    program = tmp_path / "python"
    program.write_text(f"#!{sys.executable}{BLOCKS}")
    program.chmod(0o755)
    main = f"import sys; from kr270_milling.cli import main; sys.executable = {str(program)!r}; main()"
    code, out, told = finished(runner(tmp_path / "o", "--passes", "1", "--json", program=("-c", main)))
    assert code == 0 and [row["name"] for row in json.loads(out)["passes"]] == ["original"], told
    assert not nodes_of(tmp_path)


LATE = """
import os, signal, sys
from kr270_milling.cli import main
from kr270_milling.show.commands import run
tables = run.table_of
run.table_of = lambda *how: (os.kill(os.getpid(), signal.SIGINT), tables(*how))[1]
main()
"""


def test_ctrl_c_behind_the_passes_is_heard(runner, tmp_path):
    code, out, told = finished(runner(tmp_path / "o", "--passes", "1", program=("-c", LATE)))
    assert code == 130 and not out and told.endswith("interrupted\n")
    assert not nodes_of(tmp_path)


def test_second_graph_with_the_same_names_is_refused_and_does_not_disturb_the_first(runner, tmp_path):
    first = runner(tmp_path / "a", "--passes", "1000", sets=LONG)
    in_mid_pass(tmp_path / "a")
    code, _, told = finished(runner(tmp_path / "b", "--passes", "1"))
    assert code == 2 and "already runs in this ROS domain" in told and told.count("\n") == 1
    assert not list((tmp_path / "b" / "log").iterdir())  # what its nodes publish would reach the first
    done = list((tmp_path / "a").glob("*/metadata.yaml"))  # the pass in which the other came up is the next
    wait_until(lambda: len(list((tmp_path / "a").glob("*/metadata.yaml"))) > len(done) + 1, 60, "it stands still")
    first.send_signal(signal.SIGINT)
    assert finished(first)[0] == 130
    files = sorted((tmp_path / "a").glob("*/*.mcap"), key=lambda file: file.stat().st_mtime)
    with Recording(files[-1]) as recording:
        assert not recording.cut_off
    whole = sorted((tmp_path / "a").glob("*/metadata.yaml"), key=lambda file: file.stat().st_mtime)[:-1]
    assert len(whole) > len(done) and all(pass_from_recording(file.parent).messages_lost == 0 for file in whole)


def test_two_graphs_in_two_namespaces_run_at_once(runner, tmp_path, short_cell):
    names = ("left", "right")
    runs = [runner(tmp_path / n, "--namespace", n, "--passes", "1", "--json") for n in names]
    for process, name in zip(runs, names, strict=True):
        code, _, told = finished(process)
        assert code == 0, told
        same(pass_from_recording(tmp_path / name / "original").scored.result, simulate(short_cell).result)
        with Recording(tmp_path / name / "original") as recording:
            other = names[1 - names.index(name)]
            assert not any(topic.startswith(f"/{other}/") for topic in recording.topics())
            assert f"/{name}/clock" in recording.topics() and "/clock" not in recording.topics()
        assert recompute(tmp_path / name / "original").verdict == "identical"
