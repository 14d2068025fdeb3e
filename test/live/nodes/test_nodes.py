"""The nodes in one context, stepped by hand: their passes, reports and services.

The protocols (test/exchange) prove which samples are refused; these tests prove what only a node does.
"""

import functools
import itertools
import runpy

import numpy as np
import pytest
from foreign_cell import PLACED, STANDING, WALL, foreign_pass

pytest.importorskip("rclpy")

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.time import Time
from ros_domain import from_msg
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.samples import JointSample, PoseSample, WrenchSample
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.live.nodes import compliant_robot
from kr270_milling.live.nodes.compliant_robot import CompliantRobot
from kr270_milling.live.nodes.cutting_process import CuttingProcess
from kr270_milling.live.nodes.recorder import Recorder
from kr270_milling.live.nodes.trajectory_compensator import TrajectoryCompensator
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import stamp_from_ns
from kr270_milling.physics.robot.errors import ReachError
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.codec import to_bytes

OK, WARN, ERROR = 0, 1, 2
ROBOT, CUT, COMPENSATOR = "/compliant_robot", "/cutting_process", "/trajectory_compensator"
SERIES = {"tool_pose": "position", "wrench": "wrench", "deflection": "twist"}  # topic -> field that is compared
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


class Loop:
    """Robot, cut and compensator, and a node that receives their messages; arguments: of the robot."""

    def __init__(self, world, cell, directory, *arguments: str, compensator: tuple[str, ...] = ()):
        self.world, self.cell = world, cell
        self.compensator = world.add(TrajectoryCompensator, *compensator, cell=cell, directory=directory)
        self.cut = world.add(CuttingProcess, cell=cell, directory=directory)
        self.robot = world.add(CompliantRobot, *arguments, cell=cell, directory=directory)
        self.ear = world.partner("ear")
        self.series: dict[str, dict] = {name: {} for name in SERIES}
        for name in SERIES:
            world.listen(self.ear, topics.BY_NAME[name], functools.partial(self.keep, name))
        self.references = world.listen(self.ear, topics.REFERENCE_TRAJECTORY)
        self.reports = world.diagnostics(self.ear)

    def keep(self, name, msg) -> None:
        sample = from_msg(msg)
        self.series[name][sample.stamp - self.robot.protocol.start_ns] = getattr(sample, SERIES[name])

    def start(self, cut: bool = True) -> None:
        self.cut.trigger_configure()
        self.robot.trigger_configure()
        outlets = (self.robot.outlets["tool_pose"], self.cut.outlets["wrench"])
        self.world.until(lambda: all(outlet.get_subscription_count() == 3 for outlet in outlets))
        self.world.until(self.robot.outlets["deflection"].get_subscription_count)
        self.world.until(lambda: self.references and self.robot.protocol.reference and self.cut.protocol.planned)
        if cut:
            self.cut.trigger_activate()
        self.robot.trigger_activate()

    def reach(self, count: int) -> None:
        """Start a pass, and return after so many exchanges of it."""
        self.start()
        self.world.until(lambda: len(self.series["wrench"]) > count)

    def revised(self, count: int):
        self.world.until(lambda: len(self.references) > count)
        return from_msg(self.references[count])

    def matches(self, result) -> None:
        """Wait for the end of the pass, and compare bit for bit, more than the 1e-12 that is asked for."""
        self.revised(1)
        for name, expected in zip(SERIES, (result.tool, result.wrench, result.deflection), strict=True):
            self.world.until(lambda name=name: len(self.series[name]) == result.time_ns.size)
            samples = dict(sorted(self.series[name].items()))
            assert list(samples) == result.time_ns.tolist()
            assert np.array_equal(list(samples.values()), expected), name


def test_a_pass_waits_for_the_nodes_of_a_parameter_and_starts_when_all_are_matched(world, short_cell, tmp_path):
    wait = ("-p", "wait_for:=cutting_process, compliant_robot?, recorder")
    loop = Loop(world, short_cell, tmp_path, compensator=wait)
    loop.start()
    world.step(0.3)
    assert loop.compensator.own_report().values["waiting_for"] == "recorder is not in the graph (parameter wait_for)"
    assert "the pass waits: recorder" in world.request("/trajectory_compensator/send_joint_trajectory").message
    assert not loop.robot.protocol.started
    recorder = world.add(Recorder, "-p", f"directory:={tmp_path / 'r'}")
    loop.revised(1)
    assert recorder.close() is None
    with Recording(tmp_path / "r") as recording:
        stamps = {topic: {stamp_of(m.data) for m in recording.messages([topic])} for topic in ("/tool_pose", "/wrench")}
        assert "/recorder/transition_event" not in recording.topics()
    steps = simulate(short_cell).result.time_ns.size
    assert len(stamps["/tool_pose"]) == len(stamps["/wrench"]) == steps  # on a busy machine the robot repeats a pose


@pytest.fixture(scope="module")
def revised(short_cell, ran):
    """Positions of the reference after this pass."""
    return compensator(short_cell, path_of(short_cell).target).revise(record_of(short_cell, ran)).position


@pytest.fixture
def loop(world, short_cell, tmp_path):
    return Loop(world, short_cell, tmp_path)


def test_a_pass_does_not_run_far_ahead_of_a_recorder_that_is_late(world, short_cell, ran, tmp_path, monkeypatch):
    """A pass of minutes lost poses where robot and cut were quicker than the recorder."""
    monkeypatch.setattr(compliant_robot, "CHECK", 20)
    loop = Loop(world, short_cell, tmp_path)
    loop.start(cut=False)
    outlet, late = loop.robot.outlets["tool_pose"], [True]
    monkeypatch.setattr(type(outlet), "wait_for_all_acked", lambda self, _: self is not outlet or not late)
    loop.cut.trigger_activate()
    world.until(lambda: len(loop.series["wrench"]) == 19)
    world.step(0.3)
    assert len(loop.series["wrench"]) == 19
    late.clear()
    loop.matches(ran)


def test_a_paced_pass_gives_the_plain_loop_bit_for_bit_and_is_not_quicker(world, short_cell, tmp_path):
    """With two iterations; the graph of processes has one (test_graph)."""
    cell = short_cell.replace(exchange=short_cell.exchange.replace(iterations=2))
    loop = Loop(world, cell, tmp_path, "-p", "pace:=0.03")
    loop.start()
    plain = simulate(cell).result
    loop.matches(plain)
    expected = compensator(cell, path_of(cell).target).revise(record_of(cell, plain))
    assert np.array_equal(loop.revised(1).position, expected.position)
    world.until(lambda: "wall_s" in loop.reports.last.get(ROBOT, {}))
    wall = float(loop.reports.last[ROBOT]["wall_s"])
    assert wall >= plain.time[-1] / 0.03 - 0.02  # 2 s, far more than without a pace
    world.remove(loop.robot)  # after the pass this is no fault
    world.step(0.5)
    assert not any(level == ERROR for _, level, _ in loop.reports.all)


@pytest.mark.parametrize(("name", "kind", "lost", "restarted"), [
    ("robot", CompliantRobot, [(CUT, "the robot is gone in mid-pass"), (COMPENSATOR, "/tool_pose has no publisher")],
     [(CUT, "a new pass needs a fresh workpiece")]),
    ("cut", CuttingProcess, [(ROBOT, "no wrench: its publisher is gone; the cutting process is gone")], []),
])  # fmt: skip
def test_node_restarted_in_mid_pass_is_reported_and_runs_after_a_fresh_start(
    world, loop, ran, short_cell, tmp_path, name, kind, lost, restarted
):
    loop.reach(20)
    world.remove(getattr(loop, name))
    for report in lost:
        loop.reports.until(*report, ERROR)
    again = world.add(kind, cell=short_cell, directory=tmp_path)
    setattr(loop, name, again)
    again.trigger_configure()
    again.trigger_activate()
    for report in restarted:
        loop.reports.until(*report, WARN)
    for node in (loop.robot, loop.cut):
        node.trigger_deactivate()
        node.trigger_cleanup()
    loop.series = {topic: {} for topic in SERIES}
    loop.start()
    loop.matches(ran)


def test_robot_waits_for_as_long_as_its_cut_is_not_active(world, loop, ran):
    loop.start(cut=False)
    asked = world.listen(loop.ear, topics.TOOL_POSE)
    world.step(1.0)
    assert not asked and not loop.reports.reported(ROBOT, "", ERROR)
    loop.cut.trigger_activate()
    loop.matches(ran)
    assert len(asked) == ran.time_ns.size


def test_silent_cut_is_reported_and_the_pass_is_given_up(world, loop, monkeypatch):
    """In mid-pass the reports are short."""
    monkeypatch.setattr(compliant_robot, "LOST", 3.5)
    assert "subscribers of /tool_pose" in loop.robot.own_report().values
    loop.reach(20)
    assert "subscribers of /tool_pose" not in loop.robot.own_report().values
    world.executor.remove_node(loop.cut)
    loop.reports.until(ROBOT, "no wrench for 2.6 s from the cutting process", WARN)
    loop.reports.until(ROBOT, "no wrench for 3.5 s; the cutting process is gone", ERROR)
    world.executor.add_node(loop.cut)
    count = len(loop.series["deflection"])
    world.step(0.3)
    assert len(loop.series["deflection"]) == count  # a late answer does not continue the pass


def test_silent_and_second_robots_are_reported_and_the_pass_continues_with_the_same_result(world, loop, ran):
    loop.reach(20)
    world.executor.remove_node(loop.robot)
    for node in (CUT, COMPENSATOR):
        loop.reports.until(node, "no tool_pose for 2.6 s in mid-pass", WARN)
    assert not loop.reports.reported(CUT, "a second robot")
    second = world.partner("second")
    second.create_publisher(*topics.TOOL_POSE)
    loop.reports.until(CUT, "a second robot publishes in mid-pass", ERROR)
    world.remove(second)
    world.executor.add_node(loop.robot)
    loop.reports.until(CUT, "cutting again", OK)
    loop.reports.until(COMPENSATOR, "the pass continues", OK)
    loop.matches(ran)


def test_second_cutting_processes_are_reported(world, loop):
    loop.reach(20)
    second = world.partner("second")
    second.create_publisher(*topics.WRENCH)
    loop.reports.until(ROBOT, "two nodes publish wrench", WARN)
    world.remove(second)


def test_map_of_the_part_comes_fresh_on_request_and_at_the_end(world, loop):
    """Also for a pass by hand whose cut stays active."""
    maps, cut = world.listen(loop.ear, topics.WORKPIECE), loop.cut
    loop.start()
    world.until(lambda: len(maps) == 2)
    assert set(maps[0].data) == {100}  # latched, of the fresh part
    cut.trigger_deactivate()  # the map is known already
    assert world.request("/cutting_process/publish_workpiece").success
    world.until(lambda: len(maps) == 3)
    assert min(maps[1].data) < 100
    assert maps[2].data == maps[1].data and maps[1].header.frame_id == "workpiece"


def test_map_of_the_part_comes_when_the_cut_is_deactivated_in_mid_pass(world, loop):
    maps = world.listen(loop.ear, topics.WORKPIECE)
    loop.reach(20)
    loop.cut.trigger_deactivate()
    world.until(lambda: len(maps) == 2)


def test_impossible_transition_is_refused_and_the_node_lives_on(world, loop):
    client = loop.ear.create_client(ChangeState, f"{ROBOT}/change_state")
    world.until(client.service_is_ready)
    activate = client.call_async(ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE)))
    world.until(activate.done)
    assert not activate.result().success  # the node is not configured
    loop.start()
    loop.revised(1)


# --- the compensator with a machine that publishes passes ---


class Machine:
    """A machine that publishes poses and wrenches of passes; it may be a real machine."""

    def __init__(self, world):
        self.world, self.node = world, world.partner()
        self.pose = self.node.create_publisher(*topics.TOOL_POSE)
        self.wrench = self.node.create_publisher(*topics.WRENCH)
        self.references = world.listen(self.node, topics.REFERENCE_TRAJECTORY)
        self.joints = world.listen(self.node, topics.JOINT_TRAJECTORY)
        self.reports = world.diagnostics(self.node)
        world.until(lambda: self.pose.get_subscription_count() and self.wrench.get_subscription_count())

    def play(self, result, rows, wrench: bool = True) -> None:
        start = from_msg(self.references[-1]).start_ns
        for i in rows:
            stamp = start + int(result.time_ns[i])
            self.pose.publish(to_bytes(PoseSample(stamp, "workpiece", result.tool[i], UPRIGHT)))
            if wrench:
                self.wrench.publish(to_bytes(WrenchSample(stamp, "workpiece", result.wrench[i])))
            self.world.executor.spin_once(timeout_sec=0.0)

    def reference(self, index: int):
        self.world.until(lambda: len(self.references) > index)
        return from_msg(self.references[index])


@pytest.fixture
def node(world, short_cell, tmp_path):
    return world.add(TrajectoryCompensator, "-p", "wait_for:=partner", cell=short_cell, directory=tmp_path)


@pytest.fixture
def machine(world, node):
    made = Machine(world)
    world.until(lambda: made.references and not node._readiness.waiting_for)
    return made


def test_what_does_not_fit_the_start_message_is_reported(world, short_cell, tmp_path, ran):
    """A stamp before the start, then no poses."""
    given = ("-p", "start_topic:=driver/start")
    node = world.add(TrajectoryCompensator, *given, cell=short_cell, directory=tmp_path)
    machine = Machine(world)
    start = machine.node.create_publisher(Header, "driver/start", 10)
    world.until(start.get_subscription_count)
    start.publish(Header(stamp=stamp_from_ns(WALL)))
    world.until(lambda: node.protocol.under_way)
    machine.pose.publish(to_bytes(PoseSample(WALL - 10**10, "workpiece", ran.tool[0], UPRIGHT)))
    machine.reports.until(COMPENSATOR, "s before the start of the pass, so the pose is not used", WARN)
    machine.reports.until(COMPENSATOR, "no tool_pose for 0.8 s in mid-pass", WARN)
    machine.reports.until(COMPENSATOR, "no tool_pose for 2 s: the pass is over and is not used", WARN)
    assert not node.protocol.under_way


def test_a_tracker_by_best_effort_is_taken_by_the_compensator_and_named_by_a_node_that_needs_every_pose(
    world, node, short_cell, tmp_path, ran, patient
):
    world.add(CuttingProcess, cell=short_cell, directory=tmp_path)
    tracker = world.partner("tracker")
    poses = tracker.create_publisher(*topics.TOOL_POSE[:2], qos_profile_sensor_data)
    references, reports = world.listen(tracker, topics.REFERENCE_TRAJECTORY), world.diagnostics(tracker)
    world.until(lambda: poses.get_subscription_count() and references)
    reports.until(CUT, "tracker must publish reliably on /tool_pose, not with best effort", WARN)
    for sample in foreign_pass(ran, 0):
        if isinstance(sample, PoseSample):
            poses.publish(to_bytes(sample))
            world.executor.spin_once(timeout_sec=0.0)
    world.until(lambda: len(references) > 1)


def test_a_joint_trajectory_is_sent_on_request_from_where_the_robot_stands_and_not_in_a_pass(
    world, node, machine, ran, short_cell
):
    """Names and order as a driver publishes them, best effort; a controller that comes late receives nothing."""
    target, stands = path_of(short_cell).target, arm_of(short_cell).posture + 0.1

    def answered(text: str, success: bool = False) -> None:
        def matches() -> bool:
            answer = world.request("/trajectory_compensator/send_joint_trajectory")
            return text in answer.message and answer.success is success

        world.until(matches, text)

    assert np.array_equal(machine.reference(0).position, target.position)
    answered("joint_states: no message was received")
    states = machine.node.create_publisher(JointState, "joint_states", qos_profile_sensor_data)
    world.until(states.get_subscription_count)
    names = ["external", *(f"joint_{i}" for i in range(6, 0, -1))]
    states.publish(JointState(name=names[:-1], position=[9.0, *stands[:0:-1]]))
    answered("no position of joint_1 (key joint_names)")
    assert not machine.joints
    before = machine.node.get_clock().now().nanoseconds
    states.publish(JointState(name=names, position=[9.0, *stands[::-1]]))
    answered("start in 1 s", success=True)
    world.until(lambda: machine.joints)
    (sent,) = machine.joints
    assert 0.9e9 < Time.from_msg(sent.header.stamp).nanoseconds - before < 10e9
    assert sent.joint_names == [f"joint_{i}" for i in range(1, 7)]
    assert sent.points[0].positions.tolist() == stands.tolist() and not any(sent.points[-1].velocities)
    assert np.allclose(sent.points[2].positions, arm_of(short_cell).joints(target)[0], rtol=0, atol=1e-12)
    late = world.listen(world.partner("late"), topics.JOINT_TRAJECTORY)
    world.step(1.1)
    assert not late
    answered("s old")
    machine.play(ran, range(20))
    world.until(lambda: node.protocol.under_way)
    states.publish(JointState(name=names, position=[9.0, *stands[::-1]]))
    answered("a pass is under way")
    assert len(machine.joints) == 1


def test_target_and_reference_are_latched_as_paths_for_viewers(world, machine, ran, short_cell):
    machine.play(ran, range(ran.time_ns.size))
    reference = machine.reference(1)
    latecomer = world.partner("viewer")
    for topic, run in ((topics.TARGET_PATH, path_of(short_cell).target), (topics.REFERENCE_PATH, reference)):
        paths = world.listen(latecomer, topic)
        world.until(lambda paths=paths: paths)
        (path,) = paths
        stamps = [Time.from_msg(pose.header.stamp).nanoseconds for pose in path.poses]
        places = [[pose.pose.position.x, pose.pose.position.y, pose.pose.position.z] for pose in path.poses]
        assert stamps[0] == 0 and stamps[-1] == run.duration_ns and set(run.time_ns.tolist()) <= set(stamps)
        assert np.array_equal(places, run.sample(stamps))
        assert path.header.frame_id == path.poses[-1].header.frame_id == "workpiece"


def reset(machine):
    return machine.world.request("/trajectory_compensator/reset")


def test_refused_targets_leave_the_node_waiting_for_another_or_with_the_one_before(
    world, ran, revised, short_cell, tmp_path
):
    node = world.add(TrajectoryCompensator, "-p", "use_cell_path:=false", cell=short_cell, directory=tmp_path)
    machine = Machine(world)
    publisher = machine.node.create_publisher(*topics.TARGET_TRAJECTORY)
    target = path_of(short_cell).target
    out_of_reach = to_bytes(target.with_position(target.position + [0.0, 0.0, 9.0]))
    publisher.publish(out_of_reach)
    machine.reports.until(COMPENSATOR, "reach", WARN)
    world.step(0.3)
    assert node.failure is None and not machine.references
    longer = path_of(short_cell.replace(path=short_cell.path.replace(length=6e-3))).target
    for index, usable in enumerate((longer, target)):
        publisher.publish(to_bytes(usable))
        assert machine.reference(index).duration_ns == usable.duration_ns
    refused = node.refused
    publisher.publish(out_of_reach)
    world.until(lambda: node.refused > refused)
    machine.play(ran, range(ran.time_ns.size), wrench=False)
    assert np.array_equal(machine.reference(2).position, revised)
    assert reset(machine).success
    assert node.failure is None


def lead_out_of_reach(monkeypatch) -> None:
    """As when a correction leads to the border of the reach."""

    def refuse(placed, settings, reference):
        raise ReachError(3.0, (0.5, 2.5))

    monkeypatch.setattr("kr270_milling.exchange.compensator.commanded_joints", refuse)


def test_reset_and_parameters_that_are_refused_are_answered_with_the_sentence(machine, node, monkeypatch):
    refused = node.set_parameters([Parameter("compensation.method", value="magic")])[0]
    assert not refused.successful and "linear" in refused.reason
    lead_out_of_reach(monkeypatch)
    answer = reset(machine)
    assert not answer.success and "would be 3.0000 m" in answer.message
    refused = node.set_parameters([Parameter("compensation.method", value="spline")])[0]
    assert not refused.successful and "would be 3.0000 m" in refused.reason
    assert node.protocol.compensator.method == "linear" == node.get_parameter("compensation.method").value
    monkeypatch.undo()
    assert reset(machine).success
    assert node.set_parameters([Parameter("compensation.method", value="spline")])[0].successful
    machine.world.until(lambda: machine.reports.last.get(COMPENSATOR, {}).get("method") == "spline")
    refused = node.set_parameters([Parameter("cell_file", value="other.yaml")])[0]
    assert not refused.successful and "read-only" in refused.reason


def test_pass_without_its_start_and_one_whose_revision_is_refused_are_reported_and_the_next_counts(
    machine, node, ran, revised
):
    machine.play(ran, range(10, ran.time_ns.size))
    machine.reports.until(COMPENSATOR, "did not receive its start", ERROR)
    machine.world.step(0.7)
    refused = node.refused
    with pytest.MonkeyPatch.context() as patch:
        lead_out_of_reach(patch)
        machine.play(ran, range(ran.time_ns.size))
        machine.reports.until(COMPENSATOR, "would be 3.0000 m", ERROR)
        machine.world.step(0.7)
    assert node.refused == refused + 1 and node.protocol.compensator.errors == () and len(machine.references) == 1
    machine.play(ran, range(ran.time_ns.size))
    assert np.array_equal(machine.reference(1).position, revised)


# --- a robot, a force sensor and the shipped bridge in place of robot and cut, in a namespace ---


AT_ONCE = 100
AWAY = [0.0, 0.0, 0.01]  # [m]
SPACE = "/work_cell"
REMAPPED = ("-r", "joint_states:=driver/joint_states", "-r", "force:=sensor/force", "-r", "tool_pose:=encoder_pose")


@pytest.fixture
def patient(monkeypatch):
    """On a busy machine the poses of a test may come late, where those of a robot would not."""
    monkeypatch.setattr("kr270_milling.live.nodes.trajectory_compensator.BREAK_NS", 10**12)


def test_learning_converges_with_a_robot_and_a_sensor_of_other_makers(world, tmp_path, patient):
    """A driver and a sensor have their own names; before the pass, the robot waits 10 mm away from the start."""
    given = (*PLACED, "compensation.method=learned", "imperfections.pose_noise_um=5")
    cell = read_cell(find_file("paper.yaml"), given)
    words, cell_file = ("-r", f"__ns:={SPACE}"), {"cell": cell, "directory": tmp_path}
    world.add(TrajectoryCompensator, *words, "-p", "wait_for:=bridge, driver", **cell_file)
    world.add(runpy.run_path(str(find_file("bridge.py")))["Bridge"], *words, *REMAPPED, **cell_file)
    driver = world.partner("driver", SPACE)
    poses = driver.create_publisher(*topics.TOOL_POSE)
    best_effort = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
    joints = driver.create_publisher(JointState, "driver/joint_states", best_effort)
    force = driver.create_publisher(topics.WRENCH.type, "sensor/force", best_effort)
    wrenches, encoders = world.listen(driver, topics.WRENCH), []
    driver.create_subscription(topics.TOOL_POSE.type, "encoder_pose", encoders.append, topics.TOOL_POSE.qos)
    references, reports = world.listen(driver, topics.REFERENCE_TRAJECTORY), world.diagnostics(driver)
    world.until(lambda: references and all(p.get_subscription_count() for p in (poses, joints, force)))
    sent = itertools.count(1)

    def play(reference, samples) -> None:
        """Publish the samples of a pass, no faster than the bridge takes them."""
        for sample in samples:
            if isinstance(sample, PoseSample):
                poses.publish(to_bytes(sample))
                at = np.clip([sample.stamp - WALL], 0, reference.duration_ns)
                position = arm_of(cell).joints_along(reference, at)[0]
                joints.publish(to_bytes(JointSample(sample.stamp, cell.joint_names, position)))
            else:
                force.publish(to_bytes(sample))
            if (count := next(sent)) % AT_ONCE == 0:
                world.until(lambda count=count: len(wrenches) + len(encoders) == count)

    errors = []
    for number in range(2):
        world.until(lambda n=number: len(references) > n)
        reference = from_msg(references[number])
        result = simulate(cell, reference).result
        errors.append(np.abs((result.actual - result.target)[result.time > path_of(cell).full_engagement, 1]).max())
        if number == 0:
            samples = foreign_pass(result, 0, cell.imperfections.pose_noise, cell, WALL)
            still = [s for s in samples if s.stamp < WALL and isinstance(s, PoseSample)]
            play(reference, [s._replace(stamp=s.stamp - STANDING, position=s.position + AWAY) for s in still])
            reports.until(f"{SPACE}/trajectory_compensator", "mm from the first point of the reference")
            play(reference, samples)
    assert errors[0] > 60e-6 and errors[1] < 10e-6
    # the encoders see the reference alone, from joint positions by the forward kinematics
    reference = from_msg(references[0])
    encoder = np.array([from_msg(msg).position for msg in encoders[100:400]])
    assert np.abs(encoder[:, 1:] - reference.position[0, 1:]).max() < 1e-8 and np.ptp(encoder[:, 0]) > 0.05
    assert {msg.header.frame_id for msg in wrenches} == {"ft_sensor"}
