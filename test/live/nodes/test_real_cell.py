"""A robot, a force sensor and the shipped bridge in place of robot and cut, in a namespace."""

from __future__ import annotations

import runpy

import numpy as np
import pytest
from foreign_cell import PLACED, STANDING, WALL, foreign_pass

pytest.importorskip("rclpy")

from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_messages import from_msg, to_msg

from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.samples import JointSample, PoseSample
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.live.nodes.trajectory_compensator import TrajectoryCompensator
from kr270_milling.live.ros import topics

AT_ONCE = 100
SPACE = "/work_cell"
REMAPPED = ("-r", "joint_states:=driver/joint_states", "-r", "force:=sensor/force", "-r", "tool_pose:=encoder_pose")
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


class Machine:
    """A driver and a sensor with their own names, and what the bridge publishes of their messages."""

    def __init__(self, world, cell):
        self.world, self.cell = world, cell
        driver, sensor = world.partner("driver", SPACE), world.partner("sensor", SPACE)
        joints, force = topics.JOINT_STATES.type, topics.WRENCH.type
        self.pose = driver.create_publisher(*topics.TOOL_POSE)
        self.joints = driver.create_publisher(joints, "driver/joint_states", BEST_EFFORT)
        self.force = sensor.create_publisher(force, "sensor/force", BEST_EFFORT)
        self.wrenches, self.encoders = world.listen(driver, topics.WRENCH), []
        driver.create_subscription(topics.TOOL_POSE.type, "encoder_pose", self.encoders.append, topics.TOOL_POSE.qos)
        self.references, self.reports = world.listen(driver, topics.REFERENCE_TRAJECTORY), world.diagnostics(driver)
        publishers = (self.pose, self.joints, self.force)
        world.until(lambda: self.references and all(p.get_subscription_count() for p in publishers))
        self.sent = 0

    def run(self, reference, samples) -> None:
        """Publish the samples of a pass, no faster than the bridge takes them."""
        poses = [sample for sample in samples if isinstance(sample, PoseSample)]
        at = np.clip([pose.stamp - WALL for pose in poses], 0, reference.duration_ns)
        joints = iter(self.cell.joints_along(reference, at))
        for sample in samples:
            if isinstance(sample, PoseSample):
                self.pose.publish(to_msg(sample))
                self.joints.publish(to_msg(JointSample(sample.stamp, self.cell.joint_names, next(joints))))
            else:
                self.force.publish(to_msg(sample))
            self.sent += 1
            if self.sent % AT_ONCE == 0:
                self.world.until(lambda: len(self.wrenches) + len(self.encoders) == self.sent)


def test_learning_converges_with_a_robot_and_a_sensor_of_other_makers(world, tmp_path):
    """Before the pass, the robot waits 10 mm away from the start. The records (test/exchange) have all four passes."""
    given = (*PLACED, "compensation.method=learned", "imperfections.pose_noise_um=5")
    cell = read_cell(find_file("paper.yaml"), given)
    words, cell_file = ("-r", f"__ns:={SPACE}"), {"cell": cell, "directory": tmp_path}
    world.add(TrajectoryCompensator, *words, "-p", "wait_for:=bridge, driver", **cell_file)
    world.add(runpy.run_path(str(find_file("bridge.py")))["Bridge"], *words, *REMAPPED, **cell_file)
    machine, errors = Machine(world, cell), []
    for number in range(2):
        world.until(lambda n=number: len(machine.references) > n)
        reference = from_msg(machine.references[number])
        result = simulate(cell, reference).result
        errors.append(np.abs((result.actual - result.target)[result.time > cell.full_engagement, 1]).max())
        if number == 0:
            samples = foreign_pass(result, 0, cell.imperfections.pose_noise, cell, WALL)
            still = [s for s in samples if s.stamp < WALL and isinstance(s, PoseSample)]
            away = [s._replace(stamp=s.stamp - STANDING, position=s.position + [0.0, 0.0, 0.01]) for s in still]
            machine.run(reference, away)
            machine.reports.until(f"{SPACE}/trajectory_compensator", "mm from the first point of the reference")
            machine.run(reference, samples)
    assert errors[0] > 60e-6 and errors[1] < 10e-6
    # the encoders see the reference alone, from joint positions by the forward kinematics
    reference = from_msg(machine.references[0])
    encoder = np.array([from_msg(msg).position for msg in machine.encoders[100:400]])
    assert np.abs(encoder[:, 1:] - reference.position[0, 1:]).max() < 1e-8 and np.ptp(encoder[:, 0]) > 0.05
    assert {msg.header.frame_id for msg in machine.wrenches} == {"ft_sensor"}
