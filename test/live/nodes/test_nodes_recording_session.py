from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from sample_messages import wrench_msg

pytest.importorskip("rclpy")

from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from kr270_milling.live.nodes.recorder import Recorder
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.polling import PolledMessage
from kr270_milling.recordings.bag.reader import Recording


@pytest.fixture
def recorder(world, tmp_path):
    return world.add(Recorder, "-p", f"directory:={tmp_path / 'rec'}")


def test_a_file_that_ends_anywhere_lacks_nothing_that_came_before_the_rest_of_it(recorder, monkeypatch):
    """The readers are emptied one after another: a wrench came while that of the poses was empty already."""
    batches = [[(8, "pose 1"), (12, "wrench 2")], [(11, "pose 2"), (13, "pose 3"), (21, "wrench 4")]]
    assert emptied(recorder, monkeypatch, batches, [10, 20]) == [
        ["pose 1"], ["pose 1", "pose 2", "wrench 2", "pose 3"],
    ]  # fmt: skip


def emptied(recorder, monkeypatch, batches, moments) -> list[list[str]]:
    """What is written after each time that the readers were emptied; moments: begin of each poll."""
    found: list[str] = []
    after, times, arrived = [], iter(moments), iter(batches)
    clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=next(times)))

    def taken(subscriptions):
        return [PolledMessage(at, 0, lambda data, _: found.append(data), name) for at, name in next(arrived)]

    with monkeypatch.context() as only:
        only.setattr(recorder, "get_clock", lambda: clock)
        only.setattr("kr270_milling.live.nodes.recording_session.poll", taken)
        for _ in batches:
            recorder.session.poll()
            after.append(list(found))
    recorder.session._waiting.clear()
    return after


def test_a_directory_that_is_set_ends_the_recording_and_begins_another(world, tmp_path):
    recorder = world.add(Recorder, "-p", "autostart:=false")
    partner = world.partner()
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    partner.create_publisher(String, "robot_description", latched).publish(String(data="<robot/>"))
    publisher = partner.create_publisher(*topics.WRENCH)
    assert recorder.watch() == {}
    for name, steps in (("first", range(30)), ("second", range(20))):
        assert set_directory(recorder, tmp_path / name).successful
        world.until(lambda: publisher.get_subscription_count() == 1)
        for i in steps:
            publisher.publish(wrench_msg(i * 500_000, np.full(6, float(i))))
        due = {"/wrench": len(steps), "/robot_description": 1}
        world.until(
            lambda due=due: {t: e["count"] for t, e in recorder.session.writer.report().items() if t in due} == due
        )
        assert set_directory(recorder, "").successful
        world.until(lambda: publisher.get_subscription_count() == 0)
        with Recording(tmp_path / name) as recording:
            assert not recording.cut_off
            assert {topic: recording.topics()[topic].count for topic in due} == due


def test_a_directory_that_cannot_be_used_is_refused_and_the_recorder_goes_on(world, tmp_path):
    recorder = world.add(Recorder, "-p", "autostart:=false")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "metadata.yaml").write_text("old")
    refused = set_directory(recorder, tmp_path / "old")
    assert not refused.successful and "old" in refused.reason
    assert recorder.failure is None and recorder.get_parameter("directory").value == ""
    assert set_directory(recorder, tmp_path / "new").successful
    assert recorder.close() is None


def set_directory(recorder, directory):
    return recorder.set_parameters([Parameter("directory", value=str(directory))])[0]
