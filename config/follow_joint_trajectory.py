"""Client of a joint controller: it requests ``joint_trajectory``, sends it as an action goal, reports the result, ends.

python follow_joint_trajectory.py --ros-args -r follow:=/joint_trajectory_controller/follow_joint_trajectory

The package control_msgs must be installed. The compensator checks the joint names and starts the trajectory at the
present position of the robot; this client refuses a start that is older than the message.
"""

from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.time import Time
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import OK, ReportingNode
from kr270_milling.live.ros.spin import run_node

GOAL = 1e-3  # [rad] of each joint at the end, 0.5 mm at 0.5 m; assumed
PATH = 1e-2  # [rad] of each joint under way, 5 mm at 0.5 m; assumed
LATE = 1.0  # [s] after the end of the trajectory, in which the robot must arrive; assumed


class Follower(ReportingNode):
    """Ask the compensator for ``joint_trajectory``, send it to the controller, report the result."""

    def __init__(self, **kwargs):
        super().__init__("follower", **kwargs)
        self.controller = ActionClient(self, FollowJointTrajectory, "follow")
        self.service = self.create_client(Trigger, "trajectory_compensator/send_joint_trajectory")
        self.create_subscription(JointTrajectory, topics.JOINT_TRAJECTORY.name, self.on_trajectory, 1)
        self.timer = self.create_timer(0.2, self.ask)
        self.report(OK, "waiting for the controller and the compensator")

    def ask(self) -> None:
        if self.controller.server_is_ready() and self.service.service_is_ready():
            self.destroy_timer(self.timer)
            self.service.call_async(Trigger.Request()).add_done_callback(self.on_answer)

    def on_answer(self, future) -> None:
        if not future.result().success:
            self.end(f"the compensator sends no trajectory: {future.result().message}")

    def on_trajectory(self, trajectory: JointTrajectory) -> None:
        ahead = Time.from_msg(trajectory.header.stamp) - Time.from_msg(self.get_clock().now().to_msg())
        if ahead < Duration():
            return self.end(f"the start of the trajectory is {-1e-9 * ahead.nanoseconds:.3f} s in the past")
        goal = FollowJointTrajectory.Goal(trajectory=trajectory, goal_time_tolerance=Duration(seconds=LATE).to_msg())
        goal.path_tolerance = [JointTolerance(name=name, position=PATH) for name in trajectory.joint_names]
        goal.goal_tolerance = [JointTolerance(name=name, position=GOAL) for name in trajectory.joint_names]
        self.report(OK, f"sending {len(trajectory.points)} points")
        return self.controller.send_goal_async(goal).add_done_callback(self.on_goal)

    def on_goal(self, future) -> None:
        if not future.result().accepted:
            return self.end("the controller refused the trajectory")
        return future.result().get_result_async().add_done_callback(self.on_result)

    def on_result(self, future) -> None:
        result = future.result().result
        if result.error_code:
            return self.end(f"the controller stopped with error {result.error_code}: {result.error_string}")
        self.report(OK, "the robot is at the end of the trajectory")
        return self.end()


if __name__ == "__main__":
    run_node(Follower)
