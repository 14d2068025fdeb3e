from __future__ import annotations

import numpy as np
import pytest
from sample_messages import pose_msg

pytest.importorskip("rclpy")

import ros_messages as messages
from std_srvs.srv import Trigger

from kr270_milling.base.frames import WORKPIECE
from kr270_milling.base.samples import PoseSample
from kr270_milling.exchange.cut import CutProtocol
from kr270_milling.live.nodes.cutting_process import CuttingProcess
from kr270_milling.live.ros import topics

OK, WARN, ERROR = 0, 1, 2
NAME = "/cutting_process"


class Robot:
    """A rigid robot: asks for the wrench along the target, pose by pose."""

    def __init__(self, world, cell, node=None):
        self.node = node or world.partner()
        self.world, self.cell = world, cell
        self.pose = self.node.create_publisher(*topics.TOOL_POSE)
        self.reference = self.node.create_publisher(*topics.REFERENCE_TRAJECTORY)
        self.wrenches = world.listen(self.node, topics.WRENCH)
        self.reports = world.diagnostics(self.node)
        target = cell.target()
        self.stamps = cell.clock.stamp(np.arange(cell.clock.steps(target.duration_ns) + 1)).tolist()
        self.course, self.turn = target.sample(self.stamps), target.sample_orientation(self.stamps)
        self.reference.publish(messages.to_msg(target))

    def ready(self) -> None:
        self.world.until(lambda: self.pose.get_subscription_count() and self.node.count_publishers("wrench"))

    def ask(self, step: int, shift: float = 0.0, frame: str = "workpiece") -> None:
        msg = pose_msg(self.stamps[step], self.course[step] + [0.0, shift, 0.0], self.turn[step])
        msg.header.frame_id = frame
        self.pose.publish(msg)

    def exchange(self, step: int, shift: float = 0.0):
        """The answer to one pose: stamp and wrench."""
        count = len(self.wrenches)
        self.ask(step, shift)
        self.world.until(lambda: len(self.wrenches) > count)
        answer = messages.from_msg(self.wrenches[-1])
        return answer.stamp, answer.wrench


@pytest.fixture
def cut(world, short_cell, tmp_path):
    node = world.add(CuttingProcess, cell=short_cell, directory=tmp_path)
    node.trigger_configure()
    node.trigger_activate()
    return node


@pytest.fixture
def robot(world, short_cell, cut):
    made = Robot(world, short_cell)
    made.ready()
    return made


def test_every_pose_is_answered_with_the_wrench_of_the_plain_cut(robot, short_cell):
    plain = CutProtocol(short_cell)
    plain.configure()
    for step, stamp in enumerate(robot.stamps):
        answered, wrench = robot.exchange(step)
        assert answered == stamp
        ((_, expected),) = plain.pose(PoseSample(stamp, WORKPIECE, robot.course[step], robot.turn[step]))
        assert np.array_equal(wrench, expected.wrench)
    assert np.abs(wrench).max() > 0.0


def test_repeated_pose_gets_the_same_answer_and_cuts_nothing(robot, cut):
    for step in range(len(robot.stamps)):
        first = robot.exchange(step)[1]
        removed = cut.protocol.removed_volume
        assert np.array_equal(robot.exchange(step)[1], first)
        assert cut.protocol.removed_volume == removed


def test_stamp_going_backwards_is_refused_and_the_pass_continues(world, robot):
    for step in range(5):
        robot.exchange(step)
    robot.ask(2)
    robot.reports.until(NAME, "is older than the last one", ERROR)
    robot.ask(9)
    robot.reports.until(NAME, "does not follow the last one", ERROR)
    assert robot.exchange(5)[0] == robot.stamps[5]


def test_new_pass_needs_a_fresh_workpiece(world, robot, cut):
    for step in range(3):
        robot.exchange(step)
    robot.ask(0)
    robot.reports.until(NAME, "configure the cutting process again", ERROR)
    cut.trigger_deactivate()
    cut.trigger_cleanup()
    cut.trigger_configure()
    cut.trigger_activate()
    assert robot.exchange(0)[0] == 0


def test_cut_restarted_in_mid_pass_reports_that_it_missed_the_start(robot, cut):
    robot.ask(7)
    robot.reports.until(NAME, "has not seen its start", ERROR)


@pytest.mark.parametrize("shift, frame, reason", [(np.nan, "workpiece", "not finite"), (0.0, "base_link", "frame")])
def test_unusable_pose_is_refused_and_the_pass_continues(robot, shift, frame, reason):
    robot.exchange(0)
    robot.ask(1, shift, frame)
    robot.reports.until(NAME, reason, ERROR)
    assert robot.exchange(1)[0] == robot.stamps[1]


def test_cut_reports_within_a_second_that_the_robot_left_in_mid_pass(world, robot):
    watcher = world.diagnostics(world.partner("watcher"))
    for step in range(5):
        robot.exchange(step)
    world.remove(robot.node)
    watcher.until(NAME, "the robot is gone in mid-pass", ERROR, deadline=1.5)


def test_cut_reports_within_3_s_that_a_running_robot_is_silent(world, robot):
    """As one that was killed: its publisher is known for as long as its lease."""
    watcher = world.diagnostics(world.partner("watcher"))
    for step in range(5):
        robot.exchange(step)
    watcher.until(NAME, "no tool_pose for 2.6 s in mid-pass", WARN, deadline=3.0)
    assert robot.exchange(5)[0] == robot.stamps[5]
    watcher.until(NAME, "cutting again", OK)


def test_robot_that_leaves_after_the_pass_is_no_fault(world, robot):
    watcher = world.diagnostics(world.partner("watcher"))
    for step in range(len(robot.stamps)):
        robot.exchange(step)
    world.remove(robot.node)
    world.step(0.5)
    assert not watcher.reported(NAME, "", ERROR)


def test_map_of_the_part_comes_fresh_on_request_and_at_the_end(world, robot, cut):
    """Also for a pass by hand whose cut stays active."""
    maps = world.listen(robot.node, topics.WORKPIECE)
    world.until(lambda: maps)  # latched, of the fresh part
    assert set(maps[0].data) == {100}
    for step in range(len(robot.stamps) - 1):
        robot.exchange(step)
    cut.trigger_deactivate()  # in mid-pass
    world.until(lambda: len(maps) == 2)
    cut.trigger_activate()
    robot.exchange(len(robot.stamps) - 1)
    world.until(lambda: len(maps) == 3)
    cut.trigger_deactivate()  # the map is known already
    client = robot.node.create_client(Trigger, "cutting_process/publish_workpiece")
    world.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    world.until(lambda: future.done() and len(maps) == 4)
    assert future.result().success and min(maps[2].data) < 100
    assert maps[3].data == maps[2].data and maps[2].header.frame_id == "workpiece"
    cells = (100 - np.array(maps[2].data)) / 100 * maps[2].info.resolution ** 2
    depth = cut.cell.stock.max[2] - cut.cell.stock.min[2]
    # the map rounds a cell's share to a percent of the stock's height: half a percent of each touched cell
    touched = np.count_nonzero(cells) * maps[2].info.resolution ** 2
    assert abs(cells.sum() * depth - cut.protocol.removed_volume) <= 0.005 * touched * depth + 1e-15


def test_request_before_configure_is_answered_with_a_sentence(world, short_cell, tmp_path):
    world.add(CuttingProcess, cell=short_cell, directory=tmp_path)
    partner = world.partner()
    client = partner.create_client(Trigger, "cutting_process/publish_workpiece")
    world.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    world.until(future.done)
    assert not future.result().success and "configure first" in future.result().message
