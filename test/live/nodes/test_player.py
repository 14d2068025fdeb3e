"""The player: which bytes it publishes when, with the options of ``ros2 bag play``."""

import functools
import json
import os
import signal
from pathlib import Path

import pytest
from mcap.reader import make_reader
from samples import pass_recording as made
from samples.pass_recording import options

from kr270_milling.cli import main
from kr270_milling.live.nodes.player import PlayClock
from kr270_milling.recordings.bag.writer import BagWriter

pytestmark = made.needs_messages
END = 60_000_000  # [ns] of the pass
FIRST = ("/compensator_state", "/reference_trajectory")


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    messages = made.one_pass()
    return made.write(tmp_path_factory.mktemp("player") / "r", messages, spacing=END // len(messages))


def test_the_clock_of_a_playback_runs_at_its_rate_and_stops_while_paused():
    clock = PlayClock(5, 2.0, 100.0)
    assert (clock.position(99.0), clock.position(100.0), clock.position(101.5)) == (5, 5, 5 + 3 * 10**9)
    clock.set_paused(True, 101.0)
    assert clock.position(200.0) == 5 + 2 * 10**9
    clock.set_paused(False, 200.0)
    assert clock.position(200.5) == 5 + 3 * 10**9


def of_topic(pairs, topic: str) -> list[bytes]:
    return [data for name, data in pairs if name == topic]


def test_everything_is_played_once_in_the_order_of_the_recording(bag):
    """The revised reference, stamped 0 as every "start at once", comes behind the pass that it was revised from."""
    assert [(m.topic, m.data) for m in made.played(bag)] == made.raw(bag)


def listened(world, bag, *words: str, names=("/tool_pose", "/wrench", *FIRST), arguments=()):
    """A player that is paused and matched, and the list of the messages that a subscriber receives."""
    from rclpy.qos import QoSProfile

    from kr270_milling.live.nodes.player import Player
    from kr270_milling.live.ros import topics

    node, received = world.partner(), []
    player = world.add(Player, *arguments, args=options(str(bag), "--start-paused", *words))
    ends = [outlet.get_subscription_count for name, outlet in player._outlets.items() if name in names]
    for name in names:
        topic = topics.BY_NAME[name.rpartition("/")[2]]
        qos = QoSProfile(depth=1000, durability=topic.qos.durability)
        add = functools.partial(lambda name, data: received.append((name, data)), name)
        ends.append(node.create_subscription(topic.type, name, add, qos, raw=True).get_publisher_count)
    world.until(lambda: all(end() for end in ends))
    return player, received


def test_messages_arrive_byte_by_byte_and_in_their_order(world, bag):
    """Of a latched topic the last message arrives: its publisher stores one."""
    _, received = listened(world, bag)
    world.step(0.1)
    assert received == []  # paused
    world.request("/player/resume")
    recorded = made.raw(bag)
    for topic in ("/tool_pose", "/wrench"):
        world.until(lambda topic=topic: len(of_topic(received, topic)) == made.STEPS)
        assert of_topic(received, topic) == of_topic(recorded, topic)
    for topic in FIRST:
        world.until(lambda topic=topic: of_topic(received, topic)[-1:] == of_topic(recorded, topic)[-1:])


def test_names_follow_namespace_and_remapping_and_the_clock_does_not(world, bag):
    from rclpy.serialization import deserialize_message
    from rosgraph_msgs.msg import Clock

    arguments = ["-r", "__ns:=/left", "-r", "wrench:=force"]
    words = ["--clock", "100", "--rate", "0.1", "--topics", "/wrench", "/tool_pose"]
    player, received = listened(world, bag, *words, names=("/left/tool_pose", "/clock"), arguments=arguments)
    node = world.partner("observer")
    world.until(lambda: node.count_publishers("/left/force") == 1)
    assert node.count_publishers("/wrench") == node.count_publishers("/tool_pose") == 0
    world.request("/left/player/resume")
    world.until(lambda: player.finished)
    stamps = [deserialize_message(data, Clock).clock for data in of_topic(received, "/clock")]
    stamps = [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]
    assert (
        stamps == sorted(stamps) and 2 < len(stamps) < 70 and max(stamps) <= 10**9 + END
    )  # 60, or fewer on a busy machine


def test_a_playback_ends_by_itself_and_an_unusable_file_ends_with_2(bag, ros_environment, capfd):
    pytest.importorskip("rclpy")
    count = len(made.one_pass())
    assert main(["replay", str(bag), "--json"]) == 0
    out, errors = capfd.readouterr()
    assert json.loads(out) == {"file": str(bag), "messages": count, "exit_code": 0}
    assert f"{count} messages played" in errors
    assert main(["replay", "nowhere.mcap"]) == 2
    errors = capfd.readouterr().err
    assert errors.count("\n") == 1 and "nowhere.mcap" in errors


# --- the end: a signal, a sentence or a warning; files that are damaged, or that another program wrote ---


@pytest.fixture
def play(ros_environment, monkeypatch, capfd):
    """Run the player in this process to its end; return its exit code and its messages on standard error."""
    play_here = pytest.importorskip("kr270_milling.live.nodes.player", exc_type=ImportError).run_player
    monkeypatch.setattr("sys.argv", ["player"])

    def run(*words, progress=None) -> tuple[int, str]:
        code, _ = play_here(options(*map(str, words)), [], progress)
        return code, capfd.readouterr().err

    return run


def test_a_signal_ends_the_player_with_exit_code_0(play, bag):
    code, errors = play(bag, progress=lambda *_: os.kill(os.getpid(), signal.SIGINT))
    assert code == 0 and "Traceback" not in errors


def damaged(directory, begin: int) -> Path:
    """A recording of a pass that starts at a stamp [ns], with a byte of its fourth chunk changed."""
    made.write(directory, made.one_pass(begin=begin))
    (path,) = directory.rglob("*.mcap")
    with path.open("rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[3]
    middle = chunk.chunk_start_offset + chunk.chunk_length // 2
    path.write_bytes(made.flip(middle)(path.read_bytes()))
    return directory


def test_what_cannot_be_played_ends_with_2_before_it_is_played_and_with_1_where_it_is_met(play, bag, tmp_path):
    bad = damaged(tmp_path / "bad", 10**18)
    cases = ((bag, "--topics", "/nothing"), 2, "has no topic /nothing"), ((bad,), 1, "bad.mcap")
    for words, code, sentence in cases:
        ended, errors = play(*words)
        assert ended == code and "Traceback" not in errors
        last = errors.splitlines()[-1]
        assert last.startswith("player: ") and sentence in last


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
