from __future__ import annotations

import numpy as np
import pytest
from sample_messages import wrench_msg

pytest.importorskip("rclpy")

import ros_messages as messages
from rclpy.lifecycle import TransitionCallbackReturn

from kr270_milling.live.nodes.compliant_robot import CompliantRobot
from kr270_milling.live.ros import topics

ERROR, WARN = 2, 1
NAME = "/compliant_robot"


class Partner:
    """A cut and a compensator in one: publishes the target and answers poses as the test says."""

    def __init__(self, world, cell, node=None):
        self.node = node or world.partner()
        self.world, self.cell, self.poses = world, cell, []
        self.answering = True
        self.wrench = self.node.create_publisher(*topics.WRENCH)
        self.reference = self.node.create_publisher(*topics.REFERENCE_TRAJECTORY)
        world.listen(self.node, topics.TOOL_POSE, self.on_pose)
        self.deflections = world.listen(self.node, topics.DEFLECTION)
        self.reports = world.diagnostics(self.node)
        self.reference.publish(messages.to_msg(cell.target()))

    def on_pose(self, msg) -> None:
        self.poses.append(messages.ns_from_stamp(msg.header.stamp))
        if self.answering:
            self.answer(self.poses[-1])

    def answer(self, stamp: int, value: float = 1.0, frame: str = "workpiece") -> None:
        msg = wrench_msg(stamp, np.array([0.0, value, 0.0, 0.0, 0.0, 0.0]))
        msg.header.frame_id = frame
        self.wrench.publish(msg)


@pytest.fixture
def robot(world, short_cell, tmp_path):
    node = world.add(CompliantRobot, cell=short_cell, directory=tmp_path)
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    return node


def test_robot_waits_for_a_cut_that_comes_late(world, robot, short_cell):
    robot.trigger_activate()
    world.step(0.3)
    partner = Partner(world, short_cell)
    partner.reports.until(NAME, "pass complete")
    steps = short_cell.clock.steps(short_cell.target().duration_ns)
    assert partner.poses == short_cell.clock.stamp(np.arange(steps + 1)).tolist()
    assert len(partner.deflections) == steps + 1


def test_pass_is_complete_also_where_its_last_deflection_is_not_published(world, short_cell, tmp_path):
    cell = short_cell.replace(publish=short_cell.publish.replace(every=7))
    robot = world.add(CompliantRobot, cell=cell, directory=tmp_path)
    robot.trigger_configure()
    partner = Partner(world, cell)
    robot.trigger_activate()
    partner.reports.until(NAME, "pass complete")
    steps = cell.clock.steps(cell.target().duration_ns)
    assert steps % 7 and len(partner.poses) == steps + 1
    world.until(lambda: len(partner.deflections) == steps // 7 + 1)


def test_robot_asks_again_before_the_start_for_as_long_as_it_takes(world, robot, short_cell):
    partner = Partner(world, short_cell)
    partner.answering = False
    robot.trigger_activate()
    world.until(lambda: len(partner.poses) >= 6, 10)  # longer than a pass under way would be waited for
    assert set(partner.poses) == {0}
    assert not partner.reports.reported(NAME, "", ERROR)
    partner.answering = True
    partner.reports.until(NAME, "pass complete")


def test_robot_reports_within_3_s_that_its_cut_is_silent(world, robot, short_cell):
    partner = Partner(world, short_cell)
    robot.trigger_activate()
    world.until(lambda: len(partner.poses) > 10)
    partner.answering = False
    partner.reports.until(NAME, "no wrench from the cutting process: repeating the tool pose", WARN, deadline=1.5)
    partner.reports.until(NAME, "no wrench for 4 s; the cutting process is gone", ERROR, deadline=4.5)
    partner.answering = True
    count = len(partner.deflections)
    partner.answer(partner.poses[-1])
    world.step(0.3)
    assert len(partner.deflections) == count  # the pass is given up, a late answer does not revive it


def test_robot_reports_at_once_that_its_cut_has_left(world, robot, short_cell):
    partner = Partner(world, short_cell)
    watcher = world.diagnostics(world.partner("watcher"))
    robot.trigger_activate()
    world.until(lambda: len(partner.poses) > 10)
    world.remove(partner.node)
    watcher.until(NAME, "its publisher is gone", ERROR, deadline=1.5)


def test_pass_can_be_run_again_after_the_cut_was_restarted(world, robot, short_cell):
    partner = Partner(world, short_cell)
    robot.trigger_activate()
    world.until(lambda: len(partner.poses) > 10)
    world.remove(partner.node)
    again = Partner(world, short_cell, world.partner("again"))
    again.answering = False  # as a cut does that has not seen the start
    again.reports.until(NAME, "given up", ERROR, deadline=4.5)
    again.answering = True
    assert robot.trigger_deactivate() == TransitionCallbackReturn.SUCCESS
    assert robot.trigger_activate() == TransitionCallbackReturn.SUCCESS
    again.reports.until(NAME, "pass complete")


def test_repeated_and_old_answers_change_nothing(world, robot, short_cell):
    partner = Partner(world, short_cell)
    once = []

    def on_pose(msg):
        stamp = messages.ns_from_stamp(msg.header.stamp)
        partner.answer(stamp)
        partner.answer(stamp, 999.0)
        if stamp:
            partner.answer(stamp - 500_000, 999.0)
            partner.answer(stamp + 500_000_000, 999.0)
        once.append(stamp)

    partner.answering = False
    world.listen(partner.node, topics.TOOL_POSE, on_pose)
    robot.trigger_activate()
    partner.reports.until(NAME, "pass complete")
    repeated = [d.twist.linear.y for d in partner.deflections]
    robot.trigger_deactivate()
    plain = Partner(world, short_cell, world.partner("plain"))
    world.remove(partner.node)
    robot.trigger_activate()
    world.until(lambda: len(plain.deflections) == len(repeated))
    assert [d.twist.linear.y for d in plain.deflections] == repeated


@pytest.mark.parametrize("value, frame, reason", [(np.nan, "workpiece", "not finite"), (1.0, "base_link", "frame")])
def test_unusable_wrench_is_refused_and_the_pass_continues_with_a_good_wrench(
    world, robot, short_cell, value, frame, reason
):
    partner = Partner(world, short_cell)

    def on_pose(msg):
        if partner.answering:
            return
        partner.answer(partner.poses[-1], value, frame)
        partner.answering = True
        partner.answer(partner.poses[-1])

    world.listen(partner.node, topics.TOOL_POSE, on_pose)
    robot.trigger_activate()
    world.until(lambda: len(partner.poses) > 10)
    partner.answering = False
    partner.reports.until(NAME, reason, ERROR)
    partner.reports.until(NAME, "pass complete")
    world.until(lambda: partner.reports.last[NAME]["refused"] == "1")


def test_wrench_of_a_sensor_in_tool_axes_counts_in_workpiece_axes(world, robot, short_cell):
    partner = Partner(world, short_cell)
    robot.trigger_activate()
    partner.reports.until(NAME, "pass complete")
    expected = [d.twist.linear.y for d in partner.deflections]
    robot.trigger_deactivate()
    partner.deflections.clear()
    partner.answering = False
    # tool0 points down to the workpiece: its y axis is the negative y axis of the workpiece
    world.listen(partner.node, topics.TOOL_POSE, lambda _: partner.answer(partner.poses[-1], -1.0, "tool0"))
    robot.trigger_activate()
    world.until(lambda: len(partner.deflections) == len(expected))
    assert [d.twist.linear.y for d in partner.deflections] == pytest.approx(expected, rel=1e-12)


def test_impossible_transition_is_refused_and_the_node_lives_on(world, robot, short_cell):
    from lifecycle_msgs.srv import ChangeState

    partner = Partner(world, short_cell)
    client = partner.node.create_client(ChangeState, f"{NAME}/change_state")
    world.until(client.service_is_ready)
    for transition, possible in ((3, True), (3, False), (1, False), (4, True), (4, False), (2, True), (1, True)):
        request = ChangeState.Request()
        request.transition.id = transition
        future = client.call_async(request)
        world.until(future.done)
        assert future.result().success is possible
    robot.trigger_activate()
    partner.reports.until(NAME, "pass complete")


def test_pace_holds_the_pass_back_to_the_wall_clock(world, short_cell, tmp_path):
    robot = world.add(CompliantRobot, "-p", "pace:=0.1", cell=short_cell, directory=tmp_path)
    robot.trigger_configure()
    partner = Partner(world, short_cell)
    robot.trigger_activate()
    partner.reports.until(NAME, "pass complete")
    world.until(lambda: "wall_s" in partner.reports.last[NAME])
    duration = short_cell.target().duration_ns * 1e-9
    assert 10 * duration <= float(partner.reports.last[NAME]["wall_s"]) + 0.02


def test_correction_beyond_the_stated_share_of_the_chip_is_reported(world, short_cell, tmp_path):
    cell = short_cell.replace(exchange=short_cell.exchange.replace(warn_correction=1e-9))
    robot = world.add(CompliantRobot, cell=cell, directory=tmp_path)
    robot.trigger_configure()
    partner = Partner(world, cell)
    partner.answering = False
    world.listen(partner.node, topics.TOOL_POSE, lambda _: partner.answer(partner.poses[-1], float(len(partner.poses))))
    robot.trigger_activate()
    partner.reports.until(NAME, "shorten exchange.period_ms", WARN)
