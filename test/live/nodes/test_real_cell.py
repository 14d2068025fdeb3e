"""A robot, a force sensor and the shipped bridge in place of robot and cut, as processes in a namespace."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import numpy as np
import pytest
from foreign_cell import PLACED
from ros_domain import running

pytest.importorskip("rclpy")

from ros_messages import from_msg

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.cell_file import write_cell_file
from kr270_milling.cell.jobs import simulate
from kr270_milling.live.ros import topics

TEST = Path(__file__).resolve().parents[2]
PASSES = 3
SPACE = "/work_cell"


def processes(cell: Path) -> list[list[str]]:
    """The command lines of compensator, bridge, and robot with sensor."""
    words = ["--ros-args", "-r", f"__ns:={SPACE}", "--params-file", str(cell)]
    node = [sys.executable, "-m", "kr270_milling.live.nodes", "trajectory_compensator", *words]
    force = ["-r", "joint_states:=driver/joint_states", "-r", "force:=sensor/force", "-r", "tool_pose:=encoder_pose"]
    return [
        [*node, "-p", "wait_for:=bridge, driver"],
        [sys.executable, str(find_file("bridge.py")), *words, *force],
        [sys.executable, str(TEST / "foreign_cell.py"), str(cell), *words[:3]],
    ]


def test_learning_converges_with_a_robot_and_a_sensor_of_other_makers(world, ros_environment, tmp_path):
    """Every process takes some seconds to start. The error ends below the noise of one pose, 5 um."""
    given = (*PLACED, "compensation.method=learned", "imperfections.pose_noise_um=5")
    cell = read_cell(find_file("paper.yaml"), given)
    write_cell_file(cell, tmp_path / "cell.yaml")
    partner = world.partner("partner", SPACE)
    references, wrenches = (world.listen(partner, t) for t in (topics.REFERENCE_TRAJECTORY, topics.WRENCH))
    encoders: list = []
    partner.create_subscription(topics.TOOL_POSE.type, "encoder_pose", encoders.append, topics.TOOL_POSE.qos)
    with contextlib.ExitStack() as stack:
        for command in processes(tmp_path / "cell.yaml"):
            stack.enter_context(running(command, ros_environment))
        world.until(lambda: len(references) > PASSES, 120.0)
    errors = []
    for msg in references:
        result = simulate(cell, from_msg(msg)).result
        errors.append(np.abs((result.actual - result.target)[result.time > cell.full_engagement, 1]).max())
    print("largest deviation [um]:", *(f"{1e6 * error:.2f}" for error in errors))
    assert errors[0] > 60e-6 and errors[-1] < 5e-6
    # the encoders see the reference alone, from joint positions by the forward kinematics
    reference, encoder = from_msg(references[0]), np.array([from_msg(msg).position for msg in encoders[:300]])
    assert np.abs(encoder[:, 1:] - reference.position[0, 1:]).max() < 1e-8 and np.ptp(encoder[:, 0]) > 0.05
    assert {msg.header.frame_id for msg in wrenches} == {"ft_sensor"} and len(wrenches) > 3000
