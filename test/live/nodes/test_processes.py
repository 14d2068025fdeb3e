"""Nodes as processes: their command lines, several nodes in one process, signals, exit codes, the shipped scripts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pass_recording as made
import pytest
from pass_recording import STEPS
from ros_domain import running

pytest.importorskip("rclpy")

from kr270_milling import read_recording
from kr270_milling.base.parameter_file import find_file
from kr270_milling.exchange.replay.compensate import compensate_recording
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.live.graph.processes import Child
from kr270_milling.live.nodes.start import NODES, start
from kr270_milling.live.ros import spin

ROOT = Path(__file__).resolve().parents[3]
CONFIG = ROOT / "config"
MODULE = [sys.executable, "-m", "kr270_milling.live.nodes"]
NODE = [*MODULE, "compliant_robot", "--ros-args", "--params-file", "config/paper.yaml"]
COMMAND = [sys.executable, "-m", "kr270_milling.cli", "simulate", "config/paper.yaml"]
STARTS = 3
FOUR = ["compliant_robot", "cutting_process", "trajectory_compensator", "recorder"]


def started(command, environment) -> subprocess.Popen:
    """A process in the midst of its imports: its first compiled library is there."""
    process = subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    while "numpy" not in Path(f"/proc/{process.pid}/maps").read_text() and process.poll() is None:
        time.sleep(0.002)
    return process


@pytest.mark.parametrize("command, expected", [(NODE, 0), (COMMAND, 130)], ids=["node", "command"])
def test_start_that_is_interrupted_ends_at_once_and_quietly(ros_environment, command, expected):
    whole = time.monotonic()
    process = started(command, ros_environment)
    imports = time.monotonic() - whole  # grows with the load of the machine, as the rest of the imports does
    for turn in range(STARTS):
        if turn:
            process = started(command, ros_environment)
        time.sleep(2 * imports * turn / STARTS)
        process.send_signal(signal.SIGTERM if command is NODE and turn == 1 else signal.SIGINT)
        _, errors = process.communicate(timeout=30)
        assert "Traceback" not in errors and "ignored" not in errors
        assert process.returncode == expected, errors


def test_node_that_a_run_starts_and_interrupts_at_any_time_ends_quietly(ros_environment, tmp_path):
    """A signal may arrive while Python itself starts, which has no handlers yet."""
    names = [name for name in NODES if name != "player"]
    for turn in range(STARTS + 1):
        (tmp_path / str(turn)).mkdir()
        child = Child((names[turn % len(names)],), ["--ros-args"], tmp_path / str(turn))
        time.sleep(0.012 * turn)
        child.signal((signal.SIGINT, signal.SIGTERM)[turn % 2])
        assert child.process.wait(30) == 0
        assert child.log.read_text() == ""


@pytest.mark.parametrize(
    "program, words",
    [("compliant_robot", ["-p", "x"]), ("milling_cell", ["--params-file", "nowhere.yaml"]), ("player", ["--unknown"])],
)
def test_arguments_that_ros_refuses_end_with_a_sentence(monkeypatch, capfd, program, words):
    assert started_here(monkeypatch, program, "--ros-args", *words) == 2
    errors = capfd.readouterr().err
    assert "Traceback" not in errors
    last = errors.splitlines()[-1]
    assert last.startswith(f"{program}: ") and words[-1] in last


@pytest.mark.parametrize("names", [["spindle"], ["player"], ["recorder", "recorder"]])
def test_a_node_that_does_not_exist_or_is_named_twice_is_refused(monkeypatch, capsys, names):
    assert started_here(monkeypatch, "milling_cell", *names) == 2
    assert names[0] in (errors := capsys.readouterr().err) or "named once" in errors


def started_here(monkeypatch, program: str, *words: str) -> int:
    """The exit code of a program whose arguments are refused, in this process."""
    monkeypatch.setattr(sys, "argv", [program, *words])
    monkeypatch.setattr(spin, "end_process", sys.exit)
    monkeypatch.setattr(spin, "use_batch_scheduling", lambda: None)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with pytest.raises(SystemExit) as ended:
            start(program)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return ended.value.code


def test_bad_parameter_ends_a_node_with_2_and_one_sentence(ros_environment):
    command = [*MODULE, "cutting_process", "--ros-args"]
    arguments = ["--params-file", str(find_file("paper.yaml")), "-p", "tool.diameter_mm:=-1.0"]
    ran = subprocess.run([*command, *arguments], env=ros_environment, capture_output=True, text=True, timeout=30)
    assert ran.returncode == 2
    lines = [line for line in ran.stderr.splitlines() if line.strip()]
    assert len(lines) == 1 and "tool.diameter_mm" in lines[0]


def test_all_nodes_of_a_pass_run_in_one_process_and_its_recording_recomputes(ros_environment, tmp_path):
    """Compensator and recorder poll their subscriptions, which an EventsExecutor must permit."""
    cell = tmp_path / "cell.yaml"
    cell.write_text(made.cell_text())
    given = ["autostart:=true", f"recorder:directory:={tmp_path / 'r'}", f"recorder:attach:={cell}"]
    parameters = [word for assignment in given for word in ("-p", assignment)]
    log, end = tmp_path / "log", time.monotonic() + 90.0
    command = [*MODULE, "milling_cell", *FOUR, "--ros-args", "--params-file", str(cell), *parameters]
    with open(log, "w") as stream, running(command, ros_environment, stderr=stream) as process:
        while "revised after pass 1" not in log.read_text():
            assert process.poll() is None and time.monotonic() < end, log.read_text()
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    result = recompute(tmp_path / "r")
    assert result.verdict == "identical", (result.first, result.stops)
    compared = {topic: channel.compared for topic, channel in result.channels.items()}
    assert compared["/wrench"] == compared["/deflection"] == STEPS and compared["/robot_description"] == 1
    assert compared["/reference_trajectory"] == 2 and compared["/clock"] == 7
    assert all(c.differing == c.missing == c.waiting == 0 for c in result.channels.values())
    (revised,) = compensate_recording(tmp_path / "r")
    assert revised.published is True and revised.method == "linear"


def test_the_script_makes_one_recorded_pass_and_stops_everything(ros_environment, tmp_path):
    for name in ("recorder", "trajectory_compensator", "milling_cell"):  # as console scripts are on a user's PATH
        script = tmp_path / "bin" / name
        script.parent.mkdir(exist_ok=True)
        script.write_text(f'#!/bin/sh\nexec {sys.executable} -m kr270_milling.live.nodes {name} "$@"\n')
        script.chmod(0o755)
    environment = {**ros_environment, "PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    words = [str(CONFIG / "one_pass.sh"), str(CONFIG / "paper.yaml"), str(tmp_path / "pass")]
    ran = subprocess.run(["bash", *words], env=environment, capture_output=True, text=True, timeout=300, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr[-2000:]
    recorded = read_recording(tmp_path / "pass")
    assert 1e6 * recorded.scores.max_deviation == pytest.approx(62.8, abs=0.1)  # Table 2: 63.2


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
        assert process.wait(20) == -signal.SIGINT


FAILS = """
from kr270_milling.live.ros.node import ReportingNode, guarded
from kr270_milling.live.ros.spin import run_node
class Failing(ReportingNode):
    calls = 0
    def __init__(self, **kwargs):
        super().__init__("failing", **kwargs)
        self.create_timer(0.0005, self.stumble)
    @guarded
    def stumble(self):
        self.calls += 1
        print(self.calls, flush=True)
        if self.calls == 100:
            raise ZeroDivisionError("a mistake")
run_node(Failing)
"""


def test_node_that_fails_ends_before_its_next_callback(ros_environment):
    ran = subprocess.run([sys.executable, "-c", FAILS], env=ros_environment, capture_output=True, text=True, timeout=30)
    assert ran.returncode == 1 and ran.stdout.split()[-1] == "100"
    assert ran.stderr.splitlines()[-1] == "failing: ZeroDivisionError in stumble: a mistake"


@pytest.mark.parametrize("name", NODES)
def test_every_node_says_how_it_is_started(monkeypatch, capsys, name):
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    try:
        assert start(name) == 0
    except SystemExit as end:
        assert end.code == 0
    assert capsys.readouterr().out.startswith(f"usage: {name} ")
