"""The nodes in one process, stepped by hand: the graph must give what the plain loop gives."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")

from ros_messages import from_msg

from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.live.nodes.compliant_robot import CompliantRobot
from kr270_milling.live.nodes.cutting_process import CuttingProcess
from kr270_milling.live.nodes.trajectory_compensator import TrajectoryCompensator
from kr270_milling.live.ros import topics

ERROR = 2


class Loop:
    """Robot, cut and compensator in one namespace, and an ear on what they say."""

    def __init__(self, world, cell, directory, namespace="/"):
        self.world, self.cell = world, cell
        ns = ["-r", f"__ns:={namespace}"]
        self.compensator = world.add(TrajectoryCompensator, *ns, cell=cell, directory=directory)
        self.cut = world.add(CuttingProcess, *ns, cell=cell, directory=directory)
        self.robot = world.add(CompliantRobot, *ns, cell=cell, directory=directory)
        self.ear = world.partner("ear", namespace)
        self.series: dict[str, dict] = {"tool_pose": {}, "wrench": {}, "deflection": {}}
        world.listen(self.ear, topics.TOOL_POSE, lambda m: self.keep("tool_pose", m, "position"))
        world.listen(self.ear, topics.WRENCH, lambda m: self.keep("wrench", m, "wrench"))
        world.listen(self.ear, topics.DEFLECTION, lambda m: self.keep("deflection", m, "twist"))
        self.references = world.listen(self.ear, topics.REFERENCE_TRAJECTORY)
        self.reports = world.diagnostics(self.ear)
        self.name = namespace.rstrip("/") + "/"

    def keep(self, topic, msg, field) -> None:
        sample = from_msg(msg)
        self.series[topic][sample.stamp] = getattr(sample, field)

    def start(self) -> None:
        self.cut.trigger_configure()
        self.robot.trigger_configure()
        expected = {"tool_pose": 3, "wrench": 3, "deflection": 1, "reference_trajectory": 3}
        self.world.until(
            lambda: (
                all(self.ear.count_subscribers(t) == n for t, n in expected.items())
                and self.robot.outlets["tool_pose"].get_subscription_count() == 3
                and self.cut.outlets["wrench"].get_subscription_count() == 3
                and self.references
                and self.robot.protocol.reference is not None
                and self.cut.protocol.end_ns > 0
            )
        )
        self.cut.trigger_activate()
        self.robot.trigger_activate()

    def stop(self) -> None:
        for node in (self.robot, self.cut):
            node.trigger_deactivate()
            node.trigger_cleanup()

    def revised(self, count: int):
        self.world.until(lambda: len(self.references) > count, 20)
        return from_msg(self.references[count])

    def matches(self, result) -> None:
        expectations = {"tool_pose": result.tool, "wrench": result.wrench, "deflection": result.deflection}
        for topic, expected in expectations.items():
            self.world.until(lambda t=topic: len(self.series[t]) == result.time_ns.size)
            assert sorted(self.series[topic]) == result.time_ns.tolist()
            got = np.array([self.series[topic][stamp] for stamp in result.time_ns.tolist()])
            assert np.array_equal(got, expected), topic  # bit for bit, more than the 1e-12 that is asked for


def test_graph_in_one_process_gives_the_plain_loop_bit_for_bit(world, short_cell, tmp_path):
    """With two iterations; the graph of processes has one (test_ros_graph)."""
    cell = short_cell.replace(exchange=short_cell.exchange.replace(iterations=2))
    loop = Loop(world, cell, tmp_path)
    loop.start()
    plain = simulate(cell)
    revised = loop.revised(1)
    loop.matches(plain.result)
    expected = compensator(cell, cell.target()).revise(record_of(cell, plain.result))
    assert np.array_equal(revised.position, expected.position)
    assert not any(level == ERROR for _, level, _ in loop.reports.all)


@pytest.mark.parametrize("method", ["spline", "learned"])
def test_every_method_revises_on_line_as_it_does_off_line(world, short_cell, tmp_path, method):
    from rclpy.parameter import Parameter

    loop = Loop(world, short_cell, tmp_path)
    loop.start()
    loop.revised(1)
    loop.stop()
    choice = [Parameter("compensation.method", value=method)]
    assert loop.compensator.set_parameters(choice)[0].successful
    reference = loop.revised(2)
    first = simulate(short_cell)
    off_line = compensator(short_cell, short_cell.target(), method)
    expected = off_line.revise(record_of(short_cell, first.result))
    assert np.array_equal(reference.position, expected.position)
    assert (reference.velocity is None) == (expected.velocity is None)
    loop.series = {topic: {} for topic in loop.series}
    loop.start()
    second = simulate(short_cell, expected)
    next_reference = loop.revised(3)
    loop.matches(second.result)
    assert np.array_equal(next_reference.position, off_line.revise(record_of(short_cell, second.result)).position)


def test_robot_restarted_in_mid_pass_is_reported_by_the_cut_and_runs_after_a_fresh_start(world, short_cell, tmp_path):
    loop = Loop(world, short_cell, tmp_path)
    loop.start()
    world.until(lambda: len(loop.series["wrench"]) > 20)
    world.remove(loop.robot)
    loop.reports.until("/cutting_process", "the robot is gone in mid-pass", ERROR, deadline=3)
    loop.reports.until("/trajectory_compensator", "/tool_pose has no publisher", ERROR, deadline=3)
    loop.robot = world.add(CompliantRobot, cell=short_cell, directory=tmp_path)
    loop.robot.trigger_configure()
    loop.robot.trigger_activate()
    loop.reports.until("/cutting_process", "a new pass needs a fresh workpiece", ERROR)
    loop.stop()
    loop.series = {topic: {} for topic in loop.series}
    loop.start()
    loop.revised(1)
    loop.matches(simulate(short_cell).result)


def test_cut_restarted_in_mid_pass_is_reported_and_runs_after_a_fresh_start(world, short_cell, tmp_path):
    loop = Loop(world, short_cell, tmp_path)
    loop.start()
    world.until(lambda: len(loop.series["wrench"]) > 20)
    world.remove(loop.cut)
    loop.cut = world.add(CuttingProcess, cell=short_cell, directory=tmp_path)
    loop.cut.trigger_configure()
    loop.cut.trigger_activate()
    loop.reports.until("/compliant_robot", "the cutting process is gone", ERROR, deadline=20.0)
    loop.stop()
    loop.series = {topic: {} for topic in loop.series}
    loop.start()
    loop.revised(1)
    loop.matches(simulate(short_cell).result)
