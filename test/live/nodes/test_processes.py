"""Nodes as processes: their command lines, signals, exit codes, the shipped script."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ros_domain import running
from samples import pass_recording as made
from samples.pass_recording import STEPS

pytest.importorskip("rclpy")

from kr270_milling.base.arguments import STOPS
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.live.graph import Child
from kr270_milling.live.nodes.__main__ import NODES, start
from kr270_milling.live.ros import spin
from kr270_milling.live.ros.environment import PARENT
from kr270_milling.live.ros.node import ReportingNode
from kr270_milling.recordings.bag.reader import Recording

ROOT = Path(__file__).resolve().parents[3]
PAPER = str(ROOT / "config" / "paper.yaml")
NODE = [sys.executable, "-m", "kr270_milling.live.nodes", "compliant_robot", "--ros-args", "-p", f"cell_file:={PAPER}"]


def test_start_that_is_interrupted_ends_at_once_and_quietly(ros_environment):
    for turn, number in enumerate(STOPS):
        begin = time.monotonic()
        process = subprocess.Popen(
            NODE, env=ros_environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        while "numpy" not in Path(f"/proc/{process.pid}/maps").read_text() and process.poll() is None:
            time.sleep(0.002)  # until its first compiled library is there
        imports = time.monotonic() - begin  # grows with the load of the machine, as the rest of the imports does
        time.sleep(imports * turn / 2)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
        assert "Traceback" not in errors and "ignored" not in errors and process.returncode == 0, errors


def test_node_that_a_run_starts_and_interrupts_at_any_time_ends_quietly(ros_environment, tmp_path):
    """A signal may arrive while Python itself starts, which has no handlers yet."""
    names = [name for name in NODES if name != "player"]
    for turn in range(4):
        (tmp_path / str(turn)).mkdir()
        child = Child((names[turn % len(names)],), ["--ros-args"], tmp_path / str(turn))
        time.sleep(0.012 * turn)
        child.signal((signal.SIGINT, signal.SIGTERM)[turn % 2])
        assert child.process.wait(60) == 0
        assert child.log.read_text() == ""


def ended_here(monkeypatch, program: str, *words: str) -> int:
    """The exit code of a program in this process."""
    monkeypatch.setattr(sys, "argv", [program, *words])
    monkeypatch.setattr(spin, "end_process", sys.exit)
    handlers = {number: signal.getsignal(number) for number in STOPS}
    try:
        return start(program)
    except SystemExit as ended:
        return ended.code
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@pytest.mark.parametrize(("program", "words", "named"), [
    ("compliant_robot", ["--ros-args", "-p", "x"], "x"),
    ("milling_cell", ["--ros-args", "-p", "cell_file:=nowhere.yaml"], "nowhere.yaml"),
    ("compliant_robot", [], "cell_file is missing"),
    ("trajectory_compensator", [*NODE[4:], "-p", "compensation.method:=magic"], "linear"),
    ("player", ["--ros-args", "--unknown"], "--unknown"),
    ("cutting_process", ["--ros-args", "-p", "cell_file:=[1, 2]"], "cell_file"),
    ("milling_cell", ["spindle"], "spindle"),
    ("milling_cell", ["player"], "player"),
    ("milling_cell", ["recorder", "recorder"], "named once"),
])  # fmt: skip
def test_arguments_that_cannot_be_used_end_with_2_and_a_sentence(
    monkeypatch, capfd, ros_environment, program, words, named
):
    assert ended_here(monkeypatch, program, *words) == 2
    errors = capfd.readouterr().err
    assert "Traceback" not in errors
    last = errors.splitlines()[-1]
    assert last.startswith(f"{program}: ") and named in last


@pytest.mark.parametrize("name", NODES)
def test_every_node_says_how_it_is_started(monkeypatch, capsys, name):
    assert ended_here(monkeypatch, name, "--help") == 0
    assert capsys.readouterr().out.startswith(f"usage: {name} ")


def test_the_script_makes_one_pass_that_recomputes_and_stops_everything(ros_environment, tmp_path):
    cell = tmp_path / "cell.yaml"
    cell.write_text(made.cell_text())
    for name in ("recorder", "trajectory_compensator", "milling_cell"):  # as console scripts are on a user's PATH
        script = tmp_path / "bin" / name
        script.parent.mkdir(exist_ok=True)
        script.write_text(f'#!/bin/sh\nexec {sys.executable} -m kr270_milling.live.nodes {name} "$@"\n')
        script.chmod(0o755)
    environment = {**ros_environment, "PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    words = ["bash", str(ROOT / "config" / "one_pass.sh"), str(cell), str(tmp_path / "r")]
    ran = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=300, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr[-2000:]
    result = recompute(tmp_path / "r")
    assert result.verdict == "identical", (result.first, result.stops)
    expected = {"wrench": STEPS, "deflection": STEPS, "reference_trajectory": 2}
    assert {name: result.channels[f"/{name}"].compared for name in expected} == expected


def test_a_terminal_that_closes_ends_a_recorder_with_a_closed_file(ros_environment, tmp_path):
    words = [*NODE[:3], "recorder", "--ros-args", "-p", f"directory:={tmp_path / 'r'}"]
    with running(words, ros_environment, stderr=subprocess.PIPE, text=True) as process:
        assert any("recording to" in line for line in process.stderr)
        process.send_signal(signal.SIGHUP)
        assert process.wait(60) == 0
    with Recording(tmp_path / "r") as recording:
        assert not recording.cut_off


def test_without_a_loopback_interface_a_node_and_a_run_end_with_a_sentence_within_10_s(ros_environment, tmp_path):
    """In a network of their own; the time is that of the processor, as other processes may have this one's."""
    alone = ["unshare", "--map-root-user", "--net"]
    if subprocess.run([*alone, "true"], check=False).returncode:
        pytest.skip("this kernel gives no network to a user")
    words = ["-m", "kr270_milling.cli", "run", PAPER, "--out", str(tmp_path / "o")]
    for command in ([sys.executable, *words], NODE):
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        ended = subprocess.run([*alone, *command], env=ros_environment, capture_output=True, text=True, timeout=100)
        assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before < 10.0
        assert ended.returncode == 2 and not (tmp_path / "o").exists()
        assert "127.0.0.1 does not work" in ended.stderr and ended.stderr.count("\n") == 1


BLOCKED = """
import ctypes, sys
from kr270_milling.live.ros.node import ReportingNode
from kr270_milling.live.ros.spin import run_node
class Blocked(ReportingNode):
    def __init__(self, **kwargs):
        super().__init__("blocked", **kwargs)
        print("up", flush=True)
    def destroy_node(self):
        print("leaving", flush=True)
        ctypes.PyDLL(None).sleep(100)
run_node(Blocked)
"""


def test_second_signal_ends_a_node_whose_middleware_blocks_while_it_leaves(ros_environment):
    with running([sys.executable, "-c", BLOCKED], ros_environment, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"up\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == b"leaving\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == -signal.SIGINT


class Counting(ReportingNode):
    """Fails in its 100th callback, or ends with the 5000th at the latest."""

    def __init__(self, fails: bool, **kwargs):
        super().__init__("counting", **kwargs)
        self.calls, self.fails = 0, fails
        self.create_timer(0.0005, self.count)

    def count(self) -> None:
        self.calls += 1
        if self.calls == 100 and self.fails:
            raise ZeroDivisionError("a mistake")
        if self.calls == 5000:
            self.end("is not stopped")


def test_node_that_fails_ends_before_its_next_callback_and_one_whose_runner_was_killed_ends_with_0(
    ros_environment, monkeypatch, capfd
):
    nodes: list[Counting] = []

    def make(fails: bool):
        return lambda **kwargs: nodes.append(Counting(fails, **kwargs)) or nodes[-1]

    assert spin.run_node(make(True), []) == 1 and nodes[0].calls == 100
    assert capfd.readouterr().err.splitlines()[-1] == "counting: ZeroDivisionError in count: a mistake"
    monkeypatch.setenv(PARENT, "1")
    assert spin.run_node(make(False), []) == 0 and nodes[1].calls < 5000
