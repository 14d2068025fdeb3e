from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from ros_domain import running
from sample_messages import pose_msg, wrench_msg

pytest.importorskip("rclpy")

from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from kr270_milling.live.nodes.recorder import Recorder
from kr270_milling.live.ros import topics
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import series

OK, WARN = 0, 1
NAME = "/recorder"
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def recorder(world, tmp_path):
    node = world.add(Recorder, "-p", f"directory:={tmp_path / 'rec'}")
    yield node
    assert node.close() is None


def publish_wrenches(world, publisher, steps) -> None:
    for i in steps:
        publisher.publish(wrench_msg(i * 500_000, np.full(6, float(i))))
        world.executor.spin_once(timeout_sec=0.0)


def test_every_message_is_kept_with_its_bytes_and_its_stamp(world, recorder, tmp_path):
    partner = world.partner()
    publisher = partner.create_publisher(*topics.WRENCH)
    world.until(lambda: publisher.get_subscription_count())
    publish_wrenches(world, publisher, range(300))
    world.until(lambda: recorder.session.writer.report()["/wrench"]["count"] == 300)
    recorder.close()
    with Recording(tmp_path / "rec") as recording:
        found = series(recording, "/wrench")
        assert not recording.cut_off
        times = [message.log_time for message in recording.messages(["/wrench"])]
    assert found.stamp.tolist() == times == [i * 500_000 for i in range(300)]
    assert np.array_equal(found.values, np.repeat(np.arange(300.0)[:, None], 6, axis=1))


def test_a_message_with_an_impossible_publish_time_is_counted_and_the_recording_goes_on(world, recorder, tmp_path):
    """What the middleware hands over; it ended the whole recording."""
    data = serialize_message(wrench_msg(0, np.zeros(6)))
    recorder.session.writer.add_topic("/wrench", "geometry_msgs/msg/WrenchStamped")
    for publish_time in (1, -1, 2**63, 4):
        recorder.session._write(recorder.session.writer.write, "/wrench", data, publish_time)
    assert recorder.failure is None and recorder.watch()["refused"] == 2
    assert recorder.close() is None
    with Recording(tmp_path / "rec") as recording:
        assert [m.publish_time for m in recording.messages()] == [1, 4]


def test_markers_are_published_too_recorded_once_and_at_most_30_a_second_of_the_pass(world, recorder):
    """Not /tf: the wheels have no tf2_msgs; then it is recorded alone."""
    partner = world.partner()
    poses = partner.create_publisher(*topics.TOOL_POSE)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    heard: list[MarkerArray] = []
    partner.create_subscription(MarkerArray, "/markers", heard.append, latched)
    world.until(lambda: poses.get_subscription_count())
    for i in range(300):  # 0.15 s of the pass
        poses.publish(pose_msg(i * 500_000, np.array([i * 1e-4, 0.0, 0.0]), UPRIGHT))
        world.executor.spin_once(timeout_sec=0.0)
    world.until(lambda: heard and heard[-1].markers[0].header.stamp.nanosec >= 133_000_000)
    world.step(0.3)  # it hears no message of its own
    counted = recorder.session.writer.report()
    assert counted["/markers"]["count"] == 5 and counted["/tool_pose"]["count"] == 300
    assert {marker.ns for marker in heard[-1].markers} == {"path", "force"}


def test_what_somebody_else_publishes_for_viewers_is_left_to_him(world, recorder):
    partner = world.partner()
    markers = partner.create_publisher(MarkerArray, "/markers", 1)
    poses = partner.create_publisher(*topics.TOOL_POSE)
    world.until(lambda: poses.get_subscription_count() and markers.get_subscription_count())
    poses.publish(pose_msg(0, np.zeros(3), UPRIGHT))
    world.until(lambda: recorder.session.writer.report().get("/tool_pose", {}).get("count") == 1)
    assert recorder.session.writer.report()["/markers"]["count"] == 0


def test_latched_message_of_an_earlier_publisher_is_recorded(world, recorder):
    partner = world.partner()
    publisher = partner.create_publisher(*topics.ROBOT_DESCRIPTION)
    publisher.publish(String(data="<robot/>"))
    world.until(lambda: recorder.session.writer.report().get("/robot_description", {}).get("count") == 1)


def test_description_that_comes_before_every_stamp_does_not_make_the_recording_last_for_decades(world, tmp_path):
    recorder = world.add(Recorder, "-p", f"directory:={tmp_path / 'rec'}", "-p", "topics:=robot_description,tool_pose")
    partner = world.partner()
    description, pose = (partner.create_publisher(*t) for t in (topics.ROBOT_DESCRIPTION, topics.TOOL_POSE))
    description.publish(String(data="<robot/>"))
    world.until(
        lambda: pose.get_subscription_count() and recorder.session.writer.report()["/robot_description"]["count"]
    )
    pose.publish(pose_msg(500_000, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    world.until(lambda: recorder.session.writer.report()["/tool_pose"]["count"])
    assert recorder.close() is None
    with Recording(tmp_path / "rec") as recording:
        assert [m.log_time for m in recording.messages()] == [0, 500_000]


def test_topic_that_appears_late_is_found(world, recorder):
    world.step(0.3)
    publisher = world.partner().create_publisher(String, "late", 10)
    world.until(lambda: publisher.get_subscription_count())
    publisher.publish(String(data="hello"))
    world.until(lambda: recorder.session.writer.report().get("/late", {}).get("count") == 1)


def test_missing_messages_are_counted_and_told(world, recorder):
    partner = world.partner()
    told = world.diagnostics(partner)
    publisher = partner.create_publisher(*topics.WRENCH)
    world.until(lambda: publisher.get_subscription_count())
    publish_wrenches(world, publisher, [i for i in range(100) if i not in (50, 51, 70)])
    world.until(lambda: told.last.get(NAME, {}).get("missing") == "3")


def test_vanished_publisher_is_told_as_a_warning(world, recorder):
    told = world.diagnostics(world.partner("watcher"))
    partner = world.partner()
    publisher = partner.create_publisher(*topics.WRENCH)
    world.until(lambda: publisher.get_subscription_count())
    world.until(lambda: "/wrench=1" in told.last.get(NAME, {}).get("sources", ""))
    world.remove(partner)
    told.until(NAME, "no publisher any more: /wrench", WARN, deadline=1.5)


def test_only_the_listed_topics_are_recorded_where_there_is_a_list(world, tmp_path):
    names = "[wrench, '/robot/*']"
    recorder = world.add(Recorder, "-p", f"directory:={tmp_path / 'rec'}", "-p", f"topics:={names}")
    partner = world.partner()
    wanted = [partner.create_publisher(String, name, 10) for name in ("wrench", "/robot/a", "/robot/b/c")]
    other = partner.create_publisher(String, "other", 10)
    world.until(lambda: all(p.get_subscription_count() for p in wanted))
    world.step(0.2)
    assert not other.get_subscription_count()
    recorder.close()


def test_best_effort_and_latched_publishers_are_both_matched(world, recorder):
    partner = world.partner()
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    best_effort = QoSProfile(depth=5)
    best_effort.reliability = 2
    for name, qos in (("latched", latched), ("effort", best_effort)):
        publisher = partner.create_publisher(String, name, qos)
        world.until(lambda p=publisher: p.get_subscription_count())
        publisher.publish(String(data=name))
        world.until(lambda n=name: recorder.session.writer.report()[f"/{n}"]["count"] == 1)


def written(directory, topic: str) -> int:
    """How many messages of the topic are in the file while its writer still works."""
    with Recording(directory) as recording:
        found = recording.topics().get(topic)
        return found.count if found else 0


def start(environment, directory, *arguments, **kwargs):
    command = [
        sys.executable,
        "-m",
        "kr270_milling.live.nodes",
        "recorder",
        "--ros-args",
        "-p",
        f"directory:={directory}",
    ]
    return running([*command, *arguments], environment, stderr=subprocess.PIPE, text=True, **kwargs)


def heard(world, publisher):
    """Wait until publisher and recorder have found each other: each end matches on its own."""
    told, word = world.diagnostics(world.partner("listener")), f"{publisher.topic_name}=1"
    world.until(lambda: word in told.last.get(NAME, {}).get("sources", "").split(), 20)
    world.until(publisher.get_subscription_count)


def test_signal_ends_the_recorder_with_0_and_a_whole_file(world, ros_environment, tmp_path):
    publisher = world.partner().create_publisher(*topics.WRENCH)
    with start(ros_environment, tmp_path / "rec") as process:
        heard(world, publisher)
        publish_wrenches(world, publisher, range(200))
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0, process.stderr.read()
    with Recording(tmp_path / "rec") as recording:
        assert not recording.cut_off
        assert recording.topics()["/wrench"].count == 200
    assert (tmp_path / "rec" / "metadata.yaml").exists()


def test_killed_recorder_leaves_all_but_the_last_half_second(world, ros_environment, tmp_path):
    publisher = world.partner().create_publisher(*topics.WRENCH)
    with start(ros_environment, tmp_path / "rec") as process:
        heard(world, publisher)
        publish_wrenches(world, publisher, range(200))
        world.until(lambda: written(tmp_path / "rec", "/wrench") == 200, 20)
        publish_wrenches(world, publisher, range(200, 210))
        process.kill()
        process.wait(10)
    with Recording(tmp_path / "rec") as recording:
        assert recording.cut_off
        assert recording.topics()["/wrench"].count >= 200


def test_full_disk_is_told_and_what_was_written_stays_readable(world, ros_environment, tmp_path):
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    publisher = world.partner().create_publisher(String, "noise", 100)
    with start(ros_environment, tmp_path / "rec", preexec_fn=limit) as process:
        heard(world, publisher)
        end = time.monotonic() + 10
        while process.poll() is None and time.monotonic() < end:
            publisher.publish(String(data=os.urandom(5000).hex()))
            world.step(0.005)
        assert process.wait(5) == 1
        assert "are safe" in process.stderr.read()
    with Recording(tmp_path / "rec") as recording:
        assert recording.topics()["/noise"].count > 0


def test_topic_with_an_impossible_name_is_refused_before_anything_is_written(ros_environment, tmp_path):
    with start(ros_environment, tmp_path / "rec", "-p", "topics:=wrench,bad name!") as process:
        assert process.wait(20) == 2
        told = process.stderr.read()
    assert told.count("\n") == 1 and "topics: 'bad name!' must be" in told
    assert not (tmp_path / "rec").exists()


def test_missing_messages_are_told_of_all_that_there_should_be(world, tmp_path, capfd):
    recorder = world.add(Recorder, "-p", f"directory:={tmp_path / 'rec'}")
    publisher = world.partner().create_publisher(*topics.WRENCH)
    world.until(lambda: publisher.get_subscription_count())
    publish_wrenches(world, publisher, [i for i in range(30) if not 10 <= i < 15])
    world.until(lambda: recorder.session.writer.report()["/wrench"]["count"] == 25)
    recorder.close()
    assert "/wrench: 5 of 30 messages are missing" in capfd.readouterr().err


def test_directory_with_a_recording_is_not_overwritten(ros_environment, tmp_path):
    (tmp_path / "rec").mkdir()
    (tmp_path / "rec" / "metadata.yaml").write_text("old")
    with start(ros_environment, tmp_path / "rec") as process:
        assert process.wait(20) == 2
        told = process.stderr.read()
    assert "not overwritten" in told and "Traceback" not in told
    assert (tmp_path / "rec" / "metadata.yaml").read_text() == "old"
