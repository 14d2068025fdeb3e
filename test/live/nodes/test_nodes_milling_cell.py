"""Several nodes in one process, by one executor."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pass_recording as made
import pytest
from pass_recording import STEPS

pytest.importorskip("rclpy")

from kr270_milling.exchange.replay.compensate import compensate_recording
from kr270_milling.exchange.replay.recompute import recompute

COMMAND = [sys.executable, "-m", "kr270_milling.live.nodes", "milling_cell"]
FOUR = ["compliant_robot", "cutting_process", "trajectory_compensator", "recorder"]


@pytest.fixture
def start(ros_environment, tmp_path):
    """Starts a process; gives it and its log."""
    started = []

    def start(*arguments: str):
        log = tmp_path / "log"
        with open(log, "w") as stream:
            started.append(subprocess.Popen([*COMMAND, *arguments], env=ros_environment, stderr=stream))
        return started[-1], log

    yield start
    for process in started:
        process.kill()
        process.wait()


def wait_for(process, log, sentence: str) -> None:
    end = time.monotonic() + 90.0
    while sentence not in log.read_text():
        assert process.poll() is None and time.monotonic() < end, log.read_text()
        time.sleep(0.05)


def test_all_nodes_of_a_pass_run_in_one_process_and_its_recording_recomputes(start, tmp_path):
    """Compensator and recorder poll their subscriptions, which an EventsExecutor must permit."""
    cell = tmp_path / "cell.yaml"
    cell.write_text(made.cell_text())
    given = ["autostart:=true", f"recorder:directory:={tmp_path / 'r'}", f"recorder:attach:={cell}"]
    parameters = [word for assignment in given for word in ("-p", assignment)]
    process, log = start(*FOUR, "--ros-args", "--params-file", str(cell), *parameters)
    wait_for(process, log, "revised after pass 1")
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0
    result = recompute(tmp_path / "r")
    assert result.verdict == "identical", (result.first, result.stops)
    compared = {topic: channel.compared for topic, channel in result.channels.items()}
    assert compared["/wrench"] == compared["/deflection"] == STEPS and compared["/robot_description"] == 1
    assert compared["/reference_trajectory"] == compared["/joint_trajectory"] == 2 and compared["/clock"] == 7
    assert all(c.differing == c.missing == c.waiting == 0 for c in result.channels.values())
    (revised,) = compensate_recording(tmp_path / "r")
    assert revised.published is True and revised.method == "linear"


def test_parameters_go_to_a_node_by_its_name(start, tmp_path):
    cell = tmp_path / "cell.yaml"
    cell.write_text(made.cell_text())
    process, log = start("--ros-args", "--params-file", str(cell), "-p", "compliant_robot:pace:=-1.0")
    assert process.wait(60) == 2
    assert "compliant_robot" in log.read_text() or "pace" in log.read_text()
