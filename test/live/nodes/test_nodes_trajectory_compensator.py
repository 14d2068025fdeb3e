from __future__ import annotations

import numpy as np
import pytest
from sample_messages import pose_msg, wrench_msg

pytest.importorskip("rclpy")

import ros_messages as messages
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.live.nodes.trajectory_compensator import TrajectoryCompensator
from kr270_milling.live.ros import topics
from kr270_milling.physics.robot.errors import ReachError

OK, WARN, ERROR = 0, 1, 2
NAME = "/trajectory_compensator"


class Cell:
    """A machine that publishes poses and wrenches of passes; it may be a real machine."""

    def __init__(self, world):
        self.world, self.node = world, world.partner()
        self.pose = self.node.create_publisher(*topics.TOOL_POSE)
        self.wrench = self.node.create_publisher(*topics.WRENCH)
        self.references = world.listen(self.node, topics.REFERENCE_TRAJECTORY)
        self.joints = world.listen(self.node, topics.JOINT_TRAJECTORY)
        self.reports = world.diagnostics(self.node)
        world.until(lambda: self.pose.get_subscription_count() and self.wrench.get_subscription_count())
        world.until(lambda: self.references)

    def play(self, result, rows, wrench: bool = True) -> None:
        down = np.array([1.0, 0.0, 0.0, 0.0])
        for i in rows:
            stamp = int(result.time_ns[i])
            self.pose.publish(pose_msg(stamp, result.tool[i], down))
            if wrench:
                self.wrench.publish(wrench_msg(stamp, result.wrench[i]))
            self.world.executor.spin_once(timeout_sec=0.0)

    def reference(self, index: int):
        self.world.until(lambda: len(self.references) > index)
        return messages.from_msg(self.references[index])


@pytest.fixture(scope="module")
def ran(short_cell):
    return simulate(short_cell).result


@pytest.fixture
def node(world, short_cell, tmp_path):
    return world.add(TrajectoryCompensator, cell=short_cell, directory=tmp_path)


@pytest.fixture
def machine(world, node):
    return Cell(world)


def test_first_reference_is_the_target_itself_with_its_joint_positions(machine, short_cell):
    target = short_cell.target()
    reference = machine.reference(0)
    assert np.array_equal(reference.position, target.position)
    machine.world.until(lambda: machine.joints)
    positions = [point.positions.tolist() for point in machine.joints[0].points]
    assert np.allclose(positions, short_cell.joints(target), rtol=0, atol=1e-12)


def test_target_and_reference_are_latched_as_paths_for_viewers(world, machine, ran, short_cell):
    machine.play(ran, range(ran.time_ns.size))
    reference = machine.reference(1)
    latecomer = world.partner("viewer")
    for topic, run in ((topics.TARGET_PATH, short_cell.target()), (topics.REFERENCE_PATH, reference)):
        paths = world.listen(latecomer, topic)
        world.until(lambda paths=paths: paths)
        (path,) = paths
        stamps = [messages.ns_from_stamp(pose.header.stamp) for pose in path.poses]
        places = [[pose.pose.position.x, pose.pose.position.y, pose.pose.position.z] for pose in path.poses]
        assert stamps[0] == 0 and stamps[-1] == run.duration_ns and set(run.time_ns.tolist()) <= set(stamps)
        assert np.array_equal(places, run.sample(stamps))
        assert path.header.frame_id == path.poses[-1].header.frame_id == "workpiece"


def test_measured_pass_without_wrench_is_revised_from_its_poses(machine, ran, short_cell):
    machine.play(ran, range(ran.time_ns.size), wrench=False)
    expected = compensator(short_cell, short_cell.target()).revise(record_of(short_cell, ran))
    assert np.array_equal(machine.reference(1).position, expected.position)


def test_repeated_and_backward_stamps_do_not_matter(machine, ran, short_cell):
    end = ran.time_ns.size
    for i in range(end):
        machine.play(ran, [i, i, max(i - 3, 1)])
    expected = compensator(short_cell, short_cell.target()).revise(record_of(short_cell, ran))
    assert np.array_equal(machine.reference(1).position, expected.position)
    machine.world.step(0.2)
    assert len(machine.references) == 2


def test_pass_that_begins_anew_is_taken_from_its_new_start(machine, ran, short_cell):
    machine.play(ran, range(40))
    machine.play(ran, range(ran.time_ns.size))
    expected = compensator(short_cell, short_cell.target()).revise(record_of(short_cell, ran))
    assert np.array_equal(machine.reference(1).position, expected.position)


def test_pass_whose_start_was_missed_is_not_used(machine, ran):
    machine.play(ran, range(10, ran.time_ns.size))
    machine.world.step(0.7)
    assert len(machine.references) == 1


@pytest.mark.parametrize("what", ["pose", "wrench"])
def test_value_that_is_not_finite_is_refused_at_once(machine, ran, what):
    machine.play(ran, range(5))
    bad = np.array([np.nan] * 6)
    if what == "pose":
        machine.pose.publish(pose_msg(int(ran.time_ns[5]), bad[:3], np.array([1.0, 0, 0, 0])))
    else:
        machine.wrench.publish(wrench_msg(int(ran.time_ns[5]), bad))
    machine.reports.until(NAME, "not finite", ERROR)
    machine.play(ran, range(5, ran.time_ns.size))
    machine.reference(1)


def test_vanished_publisher_of_poses_is_reported_in_mid_pass(machine, ran, world):
    watcher = world.diagnostics(world.partner("watcher"))
    machine.play(ran, range(20))
    world.step(0.1)
    world.remove(machine.node)
    watcher.until(NAME, "the pass broke off", ERROR, deadline=1.5)


def test_missing_poses_in_mid_pass_are_reported_and_may_resume(machine, ran, world):
    watcher = world.diagnostics(world.partner("watcher"))
    machine.play(ran, range(20))
    watcher.until(NAME, "no tool_pose for 2.6 s in mid-pass", WARN, deadline=3.2)
    machine.play(ran, range(20, 25))
    watcher.until(NAME, "the pass continues", OK)


def test_target_of_the_user_replaces_that_of_the_cell(machine, short_cell, world):
    publisher = machine.node.create_publisher(*topics.TARGET_TRAJECTORY)
    longer = short_cell.replace(path=short_cell.path.replace(length=6e-3)).target()
    publisher.publish(messages.to_msg(longer))
    assert machine.reference(1).duration_ns == longer.duration_ns


def test_target_out_of_reach_is_refused_in_a_sentence(machine, short_cell):
    publisher = machine.node.create_publisher(*topics.TARGET_TRAJECTORY)
    target = short_cell.target()
    publisher.publish(messages.to_msg(target.with_position(target.position + [0.0, 0.0, 9.0])))
    machine.reports.until(NAME, "reach", ERROR)
    machine.world.step(0.2)
    assert len(machine.references) == 1


def raised(short_cell):
    """A target that no arm of this size can reach."""
    target = short_cell.target()
    return messages.to_msg(target.with_position(target.position + [0.0, 0.0, 9.0]))


def reset(machine):
    client = machine.node.create_client(Trigger, "trajectory_compensator/reset")
    machine.world.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    machine.world.until(future.done)
    return future.result()


def test_refused_target_leaves_the_one_before_in_its_place(machine, node, ran, short_cell):
    machine.node.create_publisher(*topics.TARGET_TRAJECTORY).publish(raised(short_cell))
    machine.reports.until(NAME, "reach", ERROR)
    machine.play(ran, range(ran.time_ns.size), wrench=False)
    expected = compensator(short_cell, short_cell.target()).revise(record_of(short_cell, ran))
    assert np.array_equal(machine.reference(1).position, expected.position)
    assert reset(machine).success
    assert node.failure is None


def test_first_target_that_is_refused_leaves_the_node_waiting_for_another(world, short_cell, tmp_path):
    node = world.add(TrajectoryCompensator, "-p", "use_cell_path:=false", cell=short_cell, directory=tmp_path)
    partner = world.partner()
    reports, references = world.diagnostics(partner), world.listen(partner, topics.REFERENCE_TRAJECTORY)
    publisher = partner.create_publisher(*topics.TARGET_TRAJECTORY)
    publisher.publish(raised(short_cell))
    reports.until(NAME, "reach", ERROR)
    world.step(0.3)
    assert node.failure is None and not references
    publisher.publish(messages.to_msg(short_cell.target()))
    world.until(lambda: references)


def out_of_reach(monkeypatch) -> None:
    """As when a correction leads to the border of the reach."""

    def refuse(cell, reference):
        raise ReachError(3.0, (0.5, 2.5))

    monkeypatch.setattr("kr270_milling.exchange.compensator.commanded_joints", refuse)


def test_reset_and_method_that_are_refused_are_answered_with_the_sentence(machine, node, monkeypatch):
    out_of_reach(monkeypatch)
    answer = reset(machine)
    assert not answer.success and "would be 3.0000 m" in answer.message
    refused = node.set_parameters([Parameter("compensation.method", value="spline")])[0]
    assert not refused.successful and "would be 3.0000 m" in refused.reason
    assert node.protocol.compensator.method == "linear" == node.get_parameter("compensation.method").value
    monkeypatch.undo()
    assert reset(machine).success


def test_pass_whose_revision_is_refused_is_reported_once_and_the_next_pass_counts(machine, node, ran, short_cell):
    with pytest.MonkeyPatch.context() as patch:
        out_of_reach(patch)
        machine.play(ran, range(ran.time_ns.size))
        machine.reports.until(NAME, "would be 3.0000 m", ERROR)
        machine.world.step(0.7)
    assert node.refused == 1 and node.protocol.compensator.errors == ()
    machine.play(ran, range(ran.time_ns.size))
    expected = compensator(short_cell, short_cell.target()).revise(record_of(short_cell, ran))
    assert np.array_equal(machine.reference(1).position, expected.position)


def test_reset_goes_back_to_the_target(machine, ran, short_cell):
    machine.play(ran, range(ran.time_ns.size))
    machine.reference(1)
    assert reset(machine).success
    assert np.array_equal(machine.reference(2).position, short_cell.target().position)


def test_method_can_be_changed_but_only_to_one_that_exists(machine, node):
    refused = node.set_parameters([Parameter("compensation.method", value="magic")])[0]
    assert not refused.successful and "linear" in refused.reason
    assert node.set_parameters([Parameter("compensation.method", value="spline")])[0].successful
    machine.world.until(lambda: machine.reports.last.get(NAME, {}).get("method") == "spline")


def test_every_other_parameter_is_read_only_and_described_with_its_range(node):
    refused = node.set_parameters([Parameter("tool.diameter_mm", value=10.0)])[0]
    assert not refused.successful and "read-only" in refused.reason
    described = node.describe_parameter("tool.diameter_mm")
    assert described.read_only and "mm" in described.description
    assert described.floating_point_range[0].to_value > 20.0
    assert node.describe_parameter("tool.teeth").integer_range
