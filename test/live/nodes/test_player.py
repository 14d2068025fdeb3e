"""The player: which bytes it publishes when, with the options of ``ros2 bag play``."""

from __future__ import annotations

import importlib.util
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pass_recording as made
import pytest
from player_listener import FIRST, Listener, options
from ros_domain import environment_of_processes

from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.cli import main
from kr270_milling.recordings.bag.play_options import PlayOptions
from kr270_milling.recordings.bag.playback import PlayClock, opening, passage, span
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter

pytestmark = made.needs_messages
needs_ros = pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed")
END = 60_000_000  # [ns] of the pass


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return made.write(tmp_path_factory.mktemp("player") / "r", made.one_pass())


def test_the_options_parse_as_in_ros2_bag_play():
    short = options("bag", "-r", "2", "-l", "-p", "-d", "0.5", "--clock")
    long = options("bag", "--rate", "2", "--loop", "--start-paused", "--delay", "0.5", "--clock", "40")
    assert short == long == PlayOptions(Path("bag"), 2.0, loop=True, start_paused=True, clock=40.0, delay=0.5)
    some = options("bag", "--start-offset", "0.5", "--playback-duration", "2", "--topics", "/a", "/b")
    assert (some.start_offset, some.playback_duration, some.topics) == (0.5, 2.0, ("/a", "/b"))
    assert options("bag") == PlayOptions(Path("bag"))


@pytest.mark.parametrize("seconds", [1e300, 1e10, -1.0, float("nan")])
@pytest.mark.parametrize("name", ["start_offset", "playback_duration"])
def test_a_time_that_no_recording_has_is_refused_in_one_sentence(bag, name, seconds):
    with Recording(bag) as recording, pytest.raises(InputError, match=f"--{name.replace('_', '-')}: .* is not a time"):
        span(recording, PlayOptions(bag, **{name: seconds}))


def test_the_clock_of_a_playback_runs_at_its_rate_and_stops_while_paused():
    clock = PlayClock(5, 2.0, 100.0)
    assert (clock.position(99.0), clock.position(100.0), clock.position(101.5)) == (5, 5, 5 + 3 * 10**9)
    clock.pause(101.0)
    assert clock.position(200.0) == 5 + 2 * 10**9
    clock.resume(200.0)
    assert clock.position(200.5) == 5 + 3 * 10**9


def played(bag, *words: str) -> list:
    chosen = options(str(bag), *words)
    with Recording(bag) as recording:
        topics = set(chosen.topics or recording.topics())
        start, end = span(recording, chosen)
        return [*opening(recording, start, topics), *passage(recording, start, end, topics)]


def of_topic(pairs, topic: str) -> list[bytes]:
    return [data for name, data in pairs if name == topic]


def test_everything_is_played_once_in_the_order_of_the_recording(bag):
    """The revised reference, stamped 0 as every "start at once", comes behind the pass that it was revised from."""
    messages = [(m.topic, m.data) for m in played(bag)]
    assert messages == made.raw(bag)
    assert {topic for topic, _ in messages[: len(FIRST)]} == set(FIRST)
    last_pose = max(i for i, (topic, _) in enumerate(messages) if topic == "/tool_pose")
    assert [messages[i][0] in FIRST for i in range(len(FIRST), last_pose)] == [False] * (last_pose - len(FIRST))
    assert {topic for topic, _ in messages[last_pose:]} >= set(FIRST)


def test_latched_messages_come_first_where_several_stand_at_the_first_moment(tmp_path):
    *latched, pose = made.one_pass()[: len(FIRST) + 1]
    rest = made.one_pass()[len(FIRST) + 1 :]
    assert (pose.topic, pose.stamp) == ("tool_pose", 0)
    messages = played(made.write(tmp_path / "r", [pose, *latched, *rest]))
    assert [m.topic for m in messages[: len(FIRST) + 1]] == [*FIRST, "/tool_pose"]


def test_with_an_offset_the_last_latched_messages_from_before_come_first(bag):
    messages = played(bag, "--start-offset", "0.03")
    recorded = made.raw(bag)
    before = {topic: of_topic(recorded, topic)[0] for topic in FIRST}  # the others are revised from this pass
    assert {m.topic: m.data for m in messages[: len(FIRST)]} == before
    assert all(m.log_time >= END // 2 for m in messages[len(FIRST) :]) and messages[len(FIRST)].log_time == END // 2
    behind = played(bag, "--start-offset", "0.061")
    assert {m.topic: m.data for m in behind if m.topic in FIRST} == {t: of_topic(recorded, t)[-1] for t in FIRST}


def test_the_duration_ends_a_playback(bag):
    messages = played(bag, "--start-offset", "0.03", "--playback-duration", "0.01", "--topics", "/wrench")
    assert [m.log_time for m in messages] == list(range(30_000_000, 40_000_001, 500_000))


@needs_ros
def test_messages_arrive_byte_by_byte_and_in_their_order(bag, domain):
    with Listener(domain, bag) as graph:
        for _ in range(30):
            graph.spin()
        assert graph.messages == []  # paused
        received = graph.play()
    for topic in ("/tool_pose", "/wrench"):
        assert of_topic(received, topic) == of_topic(made.raw(bag), topic)
    for topic in FIRST:
        assert of_topic(received, topic)[-1] == of_topic(made.raw(bag), topic)[-1]


@needs_ros
def test_latched_messages_arrive_whatever_the_offset(bag, domain):
    with Listener(domain, bag, ["--start-offset", "0.05", "--rate", "0.05"]) as graph:  # only the last message remains
        received = graph.play()
    recorded = made.raw(bag)
    assert [of_topic(received, t) for t in FIRST] == [of_topic(recorded, t) for t in FIRST]
    assert of_topic(received, "/wrench") == of_topic(recorded, "/wrench")[100:]


def test_a_loop_begins_again(bag, domain):
    with Listener(domain, bag, ["--loop", "--topics", "/wrench"], names=("/wrench",)) as graph:
        graph.resume()
        graph.until(lambda: len(graph.messages) >= 300)
        received = of_topic(graph.messages, "/wrench")
        assert not graph.player.done
    once = of_topic(made.raw(bag), "/wrench")
    assert received[:300] == (once * 3)[:300]


def test_the_clock_is_published_on_demand(bag, domain):
    from rclpy.serialization import deserialize_message
    from rosgraph_msgs.msg import Clock

    with Listener(domain, bag, ["--clock", "100", "--rate", "0.1", "--topics", "/wrench"], names=("/clock",)) as graph:
        received = [deserialize_message(data, Clock).clock for _, data in graph.play()]
    stamps = [c.sec * 10**9 + c.nanosec for c in received]
    assert stamps == sorted(stamps) and 20 < len(stamps) < 70 and max(stamps) <= END


@needs_ros
def test_names_follow_namespace_and_remapping(bag, domain):
    arguments = ["-r", "__ns:=/left", "-r", "wrench:=force"]
    with Listener(domain, bag, names=("/left/tool_pose",), arguments=arguments) as graph:
        assert graph.node.count_publishers("/left/force") == 1
        assert graph.node.count_publishers("/wrench") == graph.node.count_publishers("/tool_pose") == 0
        graph.resume("/left/player/resume")
        graph.until(lambda: graph.player.done)


@needs_ros
def test_a_recording_without_a_wanted_topic_is_refused(bag, domain):
    with pytest.raises(RecordingError, match="/nothing"):
        Listener(domain, bag, ["--topics", "/nothing"])


@needs_ros
def test_a_signal_ends_the_process_with_exit_code_0(bag, domain, tmp_path):
    environment = environment_of_processes(domain, ROS_LOG_DIR=str(tmp_path))
    command = [sys.executable, "-m", "kr270_milling.cli", "replay", str(bag), "--loop", "--ros-args", "-r", "__ns:=/a"]
    with open(tmp_path / "log", "wb") as log:
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
    end = time.monotonic() + 60
    while b"playing" not in (tmp_path / "log").read_bytes():
        assert process.poll() is None and time.monotonic() < end, (tmp_path / "log").read_text()
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0
    assert "Traceback" not in (tmp_path / "log").read_text()


@needs_ros
def test_a_playback_ends_by_itself_and_an_unusable_file_ends_with_2(bag, ros_environment, capfd):
    count = len(made.one_pass())
    assert main(["replay", str(bag), "--json"]) == 0
    out, errors = capfd.readouterr()
    assert json.loads(out) == {"file": str(bag), "messages": count, "exit_code": 0}
    assert f"{count} messages played" in errors
    assert main(["replay", "nowhere.mcap"]) == 2
    errors = capfd.readouterr().err
    assert errors.count("\n") == 1 and "nowhere.mcap" in errors


# --- files that are damaged, or that another program wrote: a sentence or a warning, and an end ---


@pytest.fixture
def play(ros_environment, monkeypatch, capfd):
    """Run the player in this process to its end; return its exit code and its messages on standard error."""
    play_here = pytest.importorskip("kr270_milling.live.nodes.player", exc_type=ImportError).run_player
    monkeypatch.setattr("sys.argv", ["player"])

    def run(*words) -> tuple[int, str]:
        code, _ = play_here(options(*map(str, words)), [])
        return code, capfd.readouterr().err

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
    data[(chunk.offset + chunk.end) // 2] ^= 1
    path.write_bytes(data)
    return bag


@pytest.mark.parametrize("words", [(), ("--loop",)])
def test_damaged_recording_ends_with_a_sentence_and_1_where_it_is_met(play, tmp_path, words):
    code, errors = play(damaged(tmp_path / "r", 10**18), *words)
    assert code == 1 and "Traceback" not in errors
    assert errors.splitlines()[-1].startswith("player: ") and "r.mcap" in errors.splitlines()[-1]


def test_damaged_recording_that_may_hold_several_passes_is_refused_before_it_is_played(play, tmp_path):
    """Where they begin is looked for in the whole file."""
    code, errors = play(damaged(tmp_path / "r", 0))
    assert code == 2 and "Traceback" not in errors
    assert "r.mcap" in errors.splitlines()[-1] and "recover" in errors.splitlines()[-1]


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
    code, errors = play(tmp_path / "r")
    assert code == 0 and "Traceback" not in errors
    assert "1 messages played" in errors
    assert all(f"{topic} is not played: " in errors for topic in foreign)


def test_clock_that_is_published_all_the_time_does_not_stop_the_playback(play, tmp_path):
    code, errors = play(made.write(tmp_path / "r", made.one_pass()), "--clock", "1e6", "--rate", "1e-3",
                "--playback-duration", "0.0005", "--topics", "/wrench")  # fmt: skip
    assert code == 0, errors
