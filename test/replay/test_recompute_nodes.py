"""Recomputing what the real nodes recorded: every channel to the last bit."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pass_recording as made
import pytest
from pass_recording import STEPS
from ros_domain import environment_of_processes, own_domain, own_turn

from kr270_milling.replay.compensate import compensate
from kr270_milling.replay.recompute import recompute

pytest.importorskip("rclpy")


class Graph:
    """The real nodes as processes of one domain; the log of each is a file."""

    def __init__(self, directory: Path, domain: int):
        self.directory, self.running = directory, {}
        profile = {"FASTRTPS_DEFAULT_PROFILES_FILE": made.shipped("fastdds.xml")}
        self.environment = environment_of_processes(domain, ROS_LOG_DIR=str(directory), **profile)

    def start(self, node: str, *arguments: str) -> None:
        command = [sys.executable, "-m", "kr270_milling.nodes", node, "--ros-args", *arguments]
        with open(self.directory / node, "wb") as log:
            self.running[node] = subprocess.Popen(command, env=self.environment, stdout=log, stderr=log)

    def wait_for(self, node: str, text: str) -> None:
        self.wait_until(lambda: text in self.log(node))

    def wait_until(self, condition, limit: float = 60.0) -> None:
        end = time.monotonic() + limit
        while not condition():
            alive = all(process.poll() is None for process in self.running.values())
            assert alive and time.monotonic() < end, {node: self.log(node) for node in self.running}
            time.sleep(0.02)

    def activate(self, node: str) -> None:
        code = f"""
from kr270_milling.graph.driver import Driver
driver = Driver("/", lambda: None)
for step in ("configure", "activate"):
    driver.transition({node!r}, step, 60.0)
driver.close()
"""
        subprocess.run([sys.executable, "-c", code], env=self.environment, check=True, timeout=150)

    def log(self, node: str) -> str:
        return (self.directory / node).read_text(errors="replace")

    def stop(self) -> dict[str, int]:
        for process in self.running.values():
            process.send_signal(signal.SIGINT)
        return {node: process.wait(20) for node, process in self.running.items()}


def heard_all(recording: Path) -> bool:
    """Whether the file, still open, holds the last message of each kind that a pass ends with."""
    count = Counter(topic for topic, _ in made.raw(next(recording.glob("*.mcap"))))
    revised = count["/reference_trajectory"], count["/joint_trajectory"]
    return revised == (2, 2) and count["/deflection"] == count["/joint_states"] == STEPS and count["/clock"] == 7


def recorder_hears(recording: Path, *topics: str) -> bool:
    """As its own last report in the file says; a recorder that finds the topics late would miss the first messages."""
    reports = [data for topic, data in made.raw(next(recording.glob("*.mcap"))) if topic == "/diagnostics"]
    own = [data for data in reports if b"/recorder\0" in data]
    return bool(own) and all(f"{topic}=1".encode() in own[-1] for topic in topics)


@pytest.fixture(scope="module")
def of_nodes(tmp_path_factory):
    """A pass of the four real nodes, recorded; the directory of the recording."""
    with own_turn("processes"), own_domain() as domain:
        return record_a_pass(tmp_path_factory.mktemp("nodes"), domain)


def record_a_pass(directory: Path, domain: int) -> Path:
    cell = directory / "cell.yaml"
    cell.write_text(made.cell_text())
    parameters = ["--params-file", str(cell)]
    made.one_pass()  # compiles what the nodes load
    graph = Graph(directory, domain)
    try:
        graph.start("recorder", "-p", f"directory:={directory / 'r'}", "-p", f"attach:={cell}")
        graph.wait_for("recorder", "recording to")
        graph.start("trajectory_compensator", *parameters)
        graph.start("cutting_process", *parameters, "-p", "autostart:=true")
        graph.wait_for("cutting_process", "waiting for the tool")
        graph.wait_for("trajectory_compensator", "the target itself")
        graph.start("compliant_robot", *parameters, "-p", "pace:=0.1")
        graph.wait_until(lambda: recorder_hears(directory / "r", "/tool_pose", "/deflection", "/clock", "/wrench"))
        graph.activate("compliant_robot")
        graph.wait_for("trajectory_compensator", "revised after pass 1")
        graph.wait_until(lambda: heard_all(directory / "r"))
    finally:
        codes = graph.stop()
    assert set(codes.values()) == {0}
    return directory / "r"


def test_a_recording_of_the_real_nodes_is_bit_identical_on_every_channel(of_nodes):
    found = recompute(of_nodes)
    assert found.verdict == "identical", (found.first, found.stops)
    compared = {topic: c.compared for topic, c in found.channels.items()}
    assert {t: compared[t] for t in ("/tool_pose", "/wrench", "/deflection")} == {
        "/tool_pose": STEPS, "/wrench": STEPS, "/deflection": STEPS}  # fmt: skip
    assert compared["/joint_states"] == STEPS and compared["/clock"] == 7
    assert compared["/reference_trajectory"] == compared["/joint_trajectory"] == 2
    assert compared["/robot_description"] == 1
    assert all(c.differing == c.missing == c.waiting == 0 for c in found.channels.values())


def test_the_compensator_makes_of_a_recording_what_the_live_node_published(of_nodes):
    (revised,) = compensate(of_nodes)
    assert revised.published is True and revised.method == "linear"


def test_the_real_nodes_publish_what_the_plain_exchange_gives(of_nodes):
    heard = [data for topic, data in made.raw(of_nodes) if topic == "/wrench"]
    assert heard == [m.data for m in made.one_pass() if m.topic == "wrench"]


def test_a_killed_recorders_file_is_recomputed_as_far_as_it_goes(of_nodes, tmp_path):
    file = next(of_nodes.glob("*.mcap"))
    for share in (0.6, 0.75, 0.9):  # chunks are closed by the wall clock: the first of a slow pass may be behind 60 %
        cut = tmp_path / f"cut_{share}.mcap"
        shutil.copy(file, cut)
        with open(cut, "r+b") as stream:
            stream.truncate(int(file.stat().st_size * share))
        found = recompute(cut)
        if "/wrench" in found.channels and found.channels["/wrench"].compared:
            break
    assert found.cut_off and found.verdict == "identical" and found.channels["/wrench"].compared > 0
