"""A signal that comes while a node, or the command line, is still importing its libraries."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ros_domain import running

pytest.importorskip("rclpy")

from kr270_milling.base.parameter_file import find_file
from kr270_milling.live.graph.processes import Child
from kr270_milling.live.nodes.start import NODES, start
from kr270_milling.live.ros import spin

ROOT = Path(__file__).resolve().parents[3]
NODE = [
    sys.executable,
    "-m",
    "kr270_milling.live.nodes",
    "compliant_robot",
    "--ros-args",
    "--params-file",
    "config/paper.yaml",
]
COMMAND = [sys.executable, "-m", "kr270_milling.cli", "simulate", "config/paper.yaml"]
STARTS = 3


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


def test_node_in_the_background_of_a_script_obeys_sigterm(ros_environment, tmp_path):
    """A shell lets what it starts with ``&`` ignore SIGINT."""
    node = f"{sys.executable} -m kr270_milling.live.nodes recorder --ros-args -p directory:={tmp_path}/r"
    with running(["sh", "-c", f"trap '' INT; exec {node}"], ros_environment) as process:
        while not list(tmp_path.glob("r/*.mcap")):
            assert process.poll() is None
            time.sleep(0.02)
        process.terminate()
        assert process.wait(20) == 0


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


def test_node_by_hand_ends_with_0_on_a_signal(ros_environment, tmp_path):
    command = [sys.executable, "-m", "kr270_milling.live.nodes", "trajectory_compensator", "--ros-args"]
    command += ["--params-file", str(find_file("paper.yaml"))]
    log = tmp_path / "log"
    with open(log, "w") as stream, running(command, ros_environment, stderr=stream) as process:
        while "]: " not in log.read_text():
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    assert "Traceback" not in log.read_text()


def test_bad_parameter_ends_a_node_with_2_and_one_sentence(ros_environment):
    command = [sys.executable, "-m", "kr270_milling.live.nodes", "cutting_process", "--ros-args"]
    arguments = ["--params-file", str(find_file("paper.yaml")), "-p", "tool.diameter_mm:=-1.0"]
    ran = subprocess.run([*command, *arguments], env=ros_environment, capture_output=True, text=True, timeout=30)
    assert ran.returncode == 2
    lines = [line for line in ran.stderr.splitlines() if line.strip()]
    assert len(lines) == 1 and "tool.diameter_mm" in lines[0]
