"""The player with files that are damaged, or that another program wrote: a sentence or a warning, and an end."""

from __future__ import annotations

import subprocess
import sys

import pass_recording as made
import pytest
from ros_domain import environment_of_processes

from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter

pytestmark = made.needs_messages
pytest.importorskip("rclpy")

PLAYER = [sys.executable, "-m", "kr270_milling.live.nodes", "player"]


@pytest.fixture
def play(domain, tmp_path):
    """Runs the player as a process to its end."""

    def run(*words) -> subprocess.CompletedProcess:
        environment = environment_of_processes(domain, ROS_LOG_DIR=str(tmp_path))
        words = [*PLAYER, *map(str, words)]
        return subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60)

    return run


def damaged(directory, begin: int):
    """A recording with a byte of its fourth chunk changed, well behind its begin [ns]."""
    messages = [m for m in made.one_pass() if m.topic == "wrench"]
    with BagWriter(directory) as bag:
        bag.add_topic("/wrench", made.WRENCH)
        for number, message in enumerate(messages):
            bag.write("/wrench", message.data, begin + number, begin + number * 500_000)
            if number % 10 == 9:
                bag.flush()
    bag = directory
    with Recording(bag) as recording:
        chunk, path = recording.chunks[3], recording.path
    data = bytearray(path.read_bytes())
    data[chunk.offset + chunk.size // 2] ^= 1
    path.write_bytes(data)
    return bag


@pytest.mark.parametrize("words", [(), ("--loop",)])
def test_damaged_recording_ends_with_a_sentence_and_1_where_it_is_met(play, tmp_path, words):
    done = play(damaged(tmp_path / "r", 10**18), *words)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1].startswith("player: ") and "r.mcap" in done.stderr.splitlines()[-1]


def test_damaged_recording_that_may_hold_several_passes_is_refused_before_it_is_played(play, tmp_path):
    """Where they begin is looked for in the whole file."""
    done = play(damaged(tmp_path / "r", 0))
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "r.mcap" in done.stderr.splitlines()[-1] and "recover" in done.stderr.splitlines()[-1]


def test_names_and_types_that_ros_has_not_are_skipped_with_a_warning(play, tmp_path):
    wrench = next(m for m in made.one_pass() if m.topic == "wrench")
    foreign = {"/cam-front/x": made.WRENCH, "/a//b": made.WRENCH, "/{c}": made.WRENCH, "/d": "/msg/X",
               "/e": "antigravity/msg/X", "/f": "std_msgs.msg/msg/String", "/g": "std_msgs/msg/Nothing"}  # fmt: skip
    with BagWriter(tmp_path / "r") as writer:
        for topic, kind in foreign.items():
            writer.add_channel(topic, (kind, "ros2msg", b"int8 x"), "cdr", {})
            writer.write(topic, wrench.data, 10**9)
        writer.add_topic("/wrench", made.WRENCH)
        writer.write("/wrench", wrench.data, 10**9)
    done = play(tmp_path / "r")
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert "1 messages played" in done.stderr
    assert all(f"{topic} is not played: " in done.stderr for topic in foreign)


def test_clock_that_is_told_all_the_time_does_not_stop_the_playback(play, tmp_path):
    done = play(made.write(tmp_path / "r", made.one_pass()), "--clock", "1e6", "--rate", "1e-3",
                "--playback-duration", "0.0005", "--topics", "/wrench")  # fmt: skip
    assert done.returncode == 0, done.stderr
