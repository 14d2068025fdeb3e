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
from kr270_milling.live.nodes.start import NODES

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


@pytest.mark.parametrize(
    "command, number, expected",
    [(NODE, signal.SIGINT, 0), (NODE, signal.SIGTERM, 0), (COMMAND, signal.SIGINT, 130)],
    ids=["node SIGINT", "node SIGTERM", "command SIGINT"],
)
def test_start_that_is_interrupted_ends_at_once_and_quietly(ros_environment, command, number, expected):
    whole = time.monotonic()
    process = started(command, ros_environment)
    imports = time.monotonic() - whole  # grows with the load of the machine, as the rest of the imports does
    for start in range(STARTS):
        if start:
            process = started(command, ros_environment)
        time.sleep(2 * imports * start / STARTS)
        process.send_signal(number)
        _, told = process.communicate(timeout=30)
        assert "Traceback" not in told and "ignored" not in told
        assert process.returncode == expected, told


def test_node_that_a_run_starts_and_interrupts_at_any_time_ends_quietly(ros_environment, tmp_path):
    """Also while Python itself starts, which has no handlers yet."""
    names = [name for name in NODES if name != "player"]
    for start in range(2 * STARTS):
        (tmp_path / str(start)).mkdir()
        child = Child((names[start % len(names)],), ["--ros-args"], tmp_path / str(start))
        time.sleep(0.008 * start)
        child.signal((signal.SIGINT, signal.SIGTERM)[start % 2])
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
def test_arguments_that_ros_refuses_are_told_in_a_sentence(ros_environment, program, words):
    command = [sys.executable, "-m", "kr270_milling.live.nodes", program, "--ros-args", *words]
    ended = subprocess.run(command, cwd=ROOT, env=ros_environment, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    last = ended.stderr.splitlines()[-1]
    assert last.startswith(f"{program}: ") and words[-1] in last


@pytest.mark.parametrize(
    "node, number", [("trajectory_compensator", signal.SIGINT), ("cutting_process", signal.SIGTERM)]
)
def test_node_by_hand_ends_with_0_on_a_signal(ros_environment, tmp_path, node, number):
    command = [sys.executable, "-m", "kr270_milling.live.nodes", node, "--ros-args", "--params-file"]
    log = tmp_path / "log"
    command.append(str(find_file("paper.yaml")))
    with open(log, "w") as stream, running(command, ros_environment, stderr=stream) as process:
        while "]: " not in log.read_text():
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(number)
        assert process.wait(30) == 0
    assert "Traceback" not in log.read_text()


BAD = [
    ("tool.diameter_mm:=-1.0", "tool.diameter_mm"),
    ("path.start_mm:=[0.0]", "path.start_mm"),
]


@pytest.mark.parametrize("assignment, key", BAD)
def test_bad_parameter_ends_a_node_with_2_and_one_sentence(ros_environment, assignment, key):
    command = [sys.executable, "-m", "kr270_milling.live.nodes", "cutting_process", "--ros-args"]
    arguments = ["--params-file", str(find_file("paper.yaml")), "-p", assignment]
    ran = subprocess.run([*command, *arguments], env=ros_environment, capture_output=True, text=True, timeout=30)
    assert ran.returncode == 2
    told = [line for line in ran.stderr.splitlines() if line.strip()]
    assert len(told) == 1 and key in told[0]
