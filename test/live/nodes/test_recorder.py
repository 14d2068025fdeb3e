import os
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from samples.recording_samples import full_disk
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from kr270_milling.base.errors import MillingError
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.live.nodes.recorder import Recorder
from kr270_milling.live.ros import topics
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.recordings.passes import series

WARN, ERROR = 1, 2
NAME = "/recorder"
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture
def recorder(world, tmp_path):
    node = world.add(Recorder, "-p", f"directory:={tmp_path / 'rec'}")
    yield node
    assert node.close() is None


def test_every_message_is_in_the_open_file_and_lost_messages_and_publishers_are_reported(
    world, recorder, tmp_path, capfd
):
    """A recorder that is killed leaves what is in the file by then."""
    reports, partner = world.diagnostics(world.partner("watcher")), world.partner()
    publisher = partner.create_publisher(*topics.WRENCH)
    world.until(publisher.get_subscription_count)
    steps = [i for i in range(300) if not 10 <= i < 15]
    for i in steps:
        publisher.publish(to_bytes(WrenchSample(i * 500_000, "workpiece", np.full(6, float(i)))))
        world.executor.spin_once(timeout_sec=0.0)

    def written() -> int:
        """Messages in the file while its writer still works."""
        with Recording(tmp_path / "rec") as recording:
            return recording.topics()["/wrench"].count if recording.count else 0

    world.until(lambda: written() == len(steps))
    with Recording(tmp_path / "rec") as recording:
        assert recording.cut_off
        records = series(recording, "/wrench")
        times = [message.log_time for message in recording.messages(["/wrench"])]
    assert records.stamp.tolist() == [i * 500_000 for i in steps]
    assert times == sorted(times) and 0 <= time.time_ns() - times[0] < 600 * 10**9  # of receipt, not of the pass
    assert np.array_equal(records.values, np.repeat(np.array(steps, float)[:, None], 6, axis=1))
    world.until(lambda: reports.last.get(NAME, {}).get("missing") == "5")
    world.remove(partner)
    reports.until(NAME, "no publisher any more: /wrench", WARN)
    recorder.close()
    assert "/wrench: 5 of 300 messages are missing" in capfd.readouterr().err
    with Recording(tmp_path / "rec") as recording:
        assert not recording.cut_off and recording.topics()["/wrench"].count == len(steps)


def test_a_message_with_an_impossible_publish_time_is_counted_and_the_recording_continues(world, recorder, tmp_path):
    """What the middleware hands over; it ended the whole recording."""
    data = to_bytes(WrenchSample(0, "workpiece", np.zeros(6)))
    recorder.session.writer.add_topic("/wrench", "geometry_msgs/msg/WrenchStamped")
    for publish_time in (1, -1, 2**63, 4):
        recorder.session._write(recorder.session.writer.write, "/wrench", data, publish_time)
    assert recorder.failure is None and recorder.watch()["refused"] == 2
    assert recorder.close() is None
    with Recording(tmp_path / "rec") as recording:
        assert [m.publish_time for m in recording.messages(["/wrench"])] == [1, 4]


def test_markers_are_published_too_recorded_once_and_at_most_30_a_second_of_the_pass(world, recorder):
    """Not /tf: the wheels have no tf2_msgs; then it is recorded alone."""
    partner = world.partner()
    poses = partner.create_publisher(*topics.TOOL_POSE)
    messages: list[MarkerArray] = []
    partner.create_subscription(MarkerArray, "/markers", messages.append, topics.LATCHED)
    world.until(lambda: poses.get_subscription_count())
    for i in range(300):  # 0.15 s of the pass
        poses.publish(to_bytes(PoseSample(i * 500_000, "workpiece", np.array([i * 1e-4, 0.0, 0.0]), UPRIGHT)))
        world.executor.spin_once(timeout_sec=0.0)
    world.until(lambda: messages and messages[-1].markers[0].header.stamp.nanosec >= 133_000_000)
    world.step(0.3)  # the recorder receives none of its messages
    counted = recorder.session.writer.report()
    assert counted["/markers"]["count"] == 5 and counted["/tool_pose"]["count"] == 300
    named = [(marker.ns, marker.header.frame_id) for marker in messages[-1].markers]
    assert sorted(named) == [("force", "workpiece"), ("path", "workpiece")]


def test_what_somebody_else_publishes_for_viewers_is_left_to_him(world, recorder):
    partner = world.partner()
    markers = partner.create_publisher(MarkerArray, "/markers", 1)
    poses = partner.create_publisher(*topics.TOOL_POSE)
    world.until(lambda: poses.get_subscription_count() and markers.get_subscription_count())
    poses.publish(to_bytes(PoseSample(0, "workpiece", np.zeros(3), UPRIGHT)))
    world.until(lambda: recorder.session.writer.report().get("/tool_pose", {}).get("count") == 1)
    assert recorder.session.writer.report()["/markers"]["count"] == 0


def test_latched_description_before_every_stamp_does_not_make_the_recording_last_for_decades(world, tmp_path):
    """A publisher by best effort is matched too."""
    recorder = world.add(Recorder, "-p", f"directory:={tmp_path / 'rec'}", "-p", "topics:=robot_description,tool_pose")
    partner, count = world.partner(), lambda name: recorder.session.writer.report()[name]["count"]
    partner.create_publisher(*topics.ROBOT_DESCRIPTION).publish(String(data="<robot/>"))
    pose = partner.create_publisher(*topics.TOOL_POSE[:2], qos_profile_sensor_data)
    world.until(lambda: pose.get_subscription_count() and count("/robot_description"))
    pose.publish(to_bytes(PoseSample(500_000, "workpiece", np.zeros(3), UPRIGHT)))
    world.until(lambda: count("/tool_pose"))
    assert recorder.close() is None
    with Recording(tmp_path / "rec") as recording:
        assert [m.topic for m in recording.messages()] == ["/robot_description", "/tool_pose"]


def test_full_disk_is_reported_and_the_written_part_stays_readable(world, recorder, tmp_path):
    publisher = world.partner().create_publisher(String, "noise", 100)
    world.until(publisher.get_subscription_count)
    with full_disk(800_000):
        world.until(lambda: publisher.publish(String(data=os.urandom(5000).hex())) or recorder.finished)
    assert "are safe" in recorder.failure
    with Recording(tmp_path / "rec") as recording:
        assert recording.topics()["/noise"].count > 0


def test_topic_with_an_impossible_name_is_refused_before_anything_is_written(world, tmp_path):
    with pytest.raises(MillingError, match="topics: 'bad name!' must be"):
        world.add(Recorder, "-p", f"directory:={tmp_path / 'rec'}", "-p", "topics:=wrench,bad name!")
    assert not (tmp_path / "rec").exists()


# --- one recording after another in one node ---


def test_a_directory_that_cannot_be_used_is_refused_and_the_next_activation_records(world, tmp_path):
    recorder, reports = world.add(Recorder, "-p", "autostart:=false"), world.diagnostics(world.partner())
    world.until(lambda: NAME in reports.last)
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "metadata.yaml").write_text("old")
    recorder.trigger_configure()
    for name, state in (("old", "inactive"), ("new", "active"), ("next", "active")):
        recorder.set_parameters([Parameter("directory", value=str(tmp_path / name))])
        recorder.trigger_activate()
        assert recorder.state == state and recorder.failure is None
        if recorder.active:
            recorder.trigger_deactivate()
            assert (tmp_path / name / "metadata.yaml").exists()
    reports.until(NAME, "old: has a recording already", ERROR)
