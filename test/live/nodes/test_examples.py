"""The example programs in ``config`` for a real cell. control_msgs and launch are no wheels; the tests imitate them."""

import runpy
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from rclpy.task import Future
from ros_domain import from_msg
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.models import arm_of
from kr270_milling.live.nodes.__main__ import CLASSES
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import stamp_from_ns
from kr270_milling.physics.robot.kinematics import forward, jacobian
from kr270_milling.physics.robot.loads import link_loads, load_torque


def example(name: str) -> dict:
    return runpy.run_path(str(find_file(name)))


def test_the_torques_of_the_joints_give_the_wrench_at_the_tip_in_axes_of_the_base(world, short_cell, tmp_path):
    """tau = -(J^T w + g) of an arm at rest, with a constant error of each torque, which the first second shows."""
    world.add(example("torque_bridge.py")["TorqueBridge"], cell=short_cell, directory=tmp_path)
    driver = world.partner("driver")
    states, wrenches = driver.create_publisher(JointState, "joint_states", 10), world.listen(driver, topics.WRENCH)
    world.until(states.get_subscription_count)
    wrench, error = np.array([100.0, -200.0, 300.0, 4.0, 5.0, -6.0]), np.arange(6.0)
    arm, mount = short_cell.arm, short_cell.mount
    for number, load in enumerate((0.0, 0.0, 1.0)):
        q = arm_of(short_cell).posture + 0.1 * number
        weight = load_torque(forward(arm, mount, q), np.zeros(6), link_loads(arm, mount))
        torque = error - weight - load * jacobian(arm, mount, q).T @ wrench
        message = JointState(name=list(short_cell.joint_names), position=q.tolist(), effort=torque.tolist())
        message.header.stamp = stamp_from_ns(number * 700_000_000)
        states.publish(message)
    world.until(lambda: wrenches)
    sample = from_msg(wrenches[0])
    assert sample.frame == "base_link" and sample.stamp == 1_400_000_000
    np.testing.assert_allclose(sample.wrench, wrench, rtol=1e-9)


def finished(value) -> Future:
    future = Future()
    future.set_result(value)
    return future


@pytest.mark.parametrize("code, failure", [(0, None), (-5, "the controller stopped with error -5: goal tolerance")])
def test_the_follower_sends_the_trajectory_with_tolerances_and_reports_the_result(world, monkeypatch, code, failure):
    goals = []

    class Controller:
        def __init__(self, *_):
            self.server_is_ready = lambda: True

        def send_goal_async(self, goal):
            goals.append(goal)
            result = SimpleNamespace(result=SimpleNamespace(error_code=code, error_string="goal tolerance"))
            return finished(SimpleNamespace(accepted=True, get_result_async=lambda: finished(result)))

    action, msg = ModuleType("control_msgs.action"), ModuleType("control_msgs.msg")
    action.FollowJointTrajectory, msg.JointTolerance = SimpleNamespace(Goal=SimpleNamespace), SimpleNamespace
    for module in (ModuleType("control_msgs"), action, msg):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr("rclpy.action.ActionClient", Controller)
    planner = world.partner("trajectory_compensator")
    program = planner.create_publisher(*topics.JOINT_TRAJECTORY)

    def send(_, response):
        message = JointTrajectory(joint_names=["a", "b"], points=[JointTrajectoryPoint(positions=[0.0, 1.0])])
        message.header.stamp = (planner.get_clock().now() + ahead).to_msg()
        program.publish(message)
        response.success = True
        return response

    namespace = example("follow_joint_trajectory.py")
    ahead = namespace["Duration"](seconds=30)
    planner.create_service(Trigger, "trajectory_compensator/send_joint_trajectory", send)
    node = world.add(namespace["Follower"])
    world.until(lambda: node.finished)
    assert node.failure == failure
    (goal,) = goals
    assert goal.trajectory.joint_names == ["a", "b"] and goal.goal_time_tolerance.sec == 1
    assert [(t.name, t.position) for t in goal.goal_tolerance] == [("a", 1e-3), ("b", 1e-3)]
    assert [t.name for t in goal.path_tolerance] == ["a", "b"]


def test_the_launch_file_starts_the_nodes_of_a_pass_with_parameters_that_these_have(monkeypatch):
    for name, member in (
        ("launch", "LaunchDescription"), ("launch.actions", "DeclareLaunchArgument"),
        ("launch.substitutions", "LaunchConfiguration"), ("launch_ros", ""), ("launch_ros.actions", "Node"),
    ):  # fmt: skip
        module = ModuleType(name)
        setattr(module, member or "none", lambda *args, **words: words or args[0])
        monkeypatch.setitem(sys.modules, name, module)
    nodes = [entry for entry in example("milling.launch.py")["generate_launch_description"]() if "executable" in entry]
    assert {node["executable"] for node in nodes} == set(CLASSES)
    own = {"directory", "attach", "cell_file", "autostart"}  # test_readme: the nodes have these parameters
    assert {key for node in nodes for key in node["parameters"][0]} == own
