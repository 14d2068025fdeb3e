"""The protocols of robot and cut: records in, records out, against the compiled pass."""

import functools

import numpy as np
import pytest
from foreign_cell import PLACED, WALL, foreign_pass, readings
from samples.small_part import GCODE, small_part

from kr270_milling.base.errors import ConfigError, MessageError
from kr270_milling.base.frames import Pose, quaternion_from_rotation, rotation_from_quaternion
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.compensator import CompensatorProtocol
from kr270_milling.exchange.cut import CutProtocol
from kr270_milling.exchange.inbox import lag
from kr270_milling.exchange.inputs import ExchangeError, WrenchFrames, checked_wrench
from kr270_milling.exchange.robot import RobotProtocol
from kr270_milling.path.trajectory import fingerprint
from kr270_milling.physics.robot.sensor import moved_wrench

H = 500_000  # [ns], exchange period
DOWN = np.array([1.0, 0.0, 0.0, 0.0])
IN_METAL = "path.start_mm=[-5, 0]"  # the cut begins with the first exchange


@functools.cache
def cell_with(*assignments):
    return read_cell(find_file("paper.yaml"), ("path.length_mm=14.4", *assignments))


def protocols(cell):
    robot, cut = RobotProtocol(cell.replace(publish=cell.publish.replace(every=1))), CutProtocol(cell)
    robot.reference = path_of(cell).target
    cut.configure()
    return robot, cut


def records(outputs, topic: str) -> list:
    return [record for name, record in outputs if name == topic]


def column(outputs, topic: str, field: str) -> np.ndarray:
    return np.array([getattr(record, field) for record in records(outputs, topic)])


def run(robot, cut, disturb=lambda robot, cut, pose: [], steps: float = np.inf) -> list:
    """All outputs of a pass, or of its first steps; disturb: what else happens at a pose, and what that gives."""
    outputs = robot.start()
    answer = list(outputs)
    while (poses := records(outputs, "tool_pose")) and poses[-1].stamp <= steps * H:
        outputs = disturb(robot, cut, poses[-1])
        answers = [cut.pose(pose) for pose in (poses[-1], *records(outputs, "tool_pose"))]
        outputs = [output for ((_, wrench),) in answers for output in robot.wrench(wrench)]
        answer += [answers[0][0], *outputs]
    return answer


def started():
    """The cut after three steps of a pass in metal, its last pose and wrench, and the next pose."""
    robot, cut = protocols(cell_with(IN_METAL))
    outputs = run(robot, cut, steps=3)
    *_, pose, following = records(outputs, "tool_pose")
    return cut, pose, records(outputs, "wrench")[-1].wrench, following


BENT = ("dynamics.reference_inertia=true",)  # the reference itself moves the arm


@pytest.mark.parametrize("options", [
    ("publish.clock=true",), ("exchange.iterations=3",), ("exchange.period_ms=0.0208333333333333",),
    ("dynamics.follow_pose=true",), (*BENT, "dynamics.follow_pose=true"),
    ("tool.runout_um=[0, 5, -5, 2]",), BENT, (*BENT, "exchange.iterations=2"),
])  # fmt: skip
def test_the_protocols_give_the_compiled_pass_bit_for_bit(options):
    cell, reference = cell_with(*options), None
    if BENT[0] in options:
        target = path_of(cell).target
        across = np.random.default_rng(5).normal(size=len(target)) * 2e-5
        reference = target.with_position(target.position + across[:, None] * [0.0, 1.0, 0.0])
    same_as_compiled(cell, reference)


def test_the_protocols_give_the_compiled_pass_of_the_mean_force_bit_for_bit(tmp_path):
    cell = small_part(tmp_path, GCODE, "cutting.detail=engagement", "exchange.iterations=2")
    assert path_of(cell).clock.period == pytest.approx(4e-3)
    same_as_compiled(cell)


def test_drilling_has_no_force_on_line_as_in_a_simulated_pass(tmp_path):
    drilled = "G21 G90 S8000 M3\nG0 X6 Y8 Z2\nG81 Z-0.5 R1 F2000\nG80\nG0 X-12 Y0\nZ-0.5\nG1 X0 F4000\nG0 Z2\nM30\n"
    cell = small_part(tmp_path, drilled)
    same_as_compiled(cell)
    ran = simulate(cell).result
    hole = path_of(cell).drilling_at(ran.time_ns)
    assert hole.any() and not ran.wrench[hole].any() and np.abs(ran.wrench).max() > 20.0


def same_as_compiled(cell, reference=None):
    robot, cut = protocols(cell)
    robot.reference = reference or robot.reference
    outputs, expected = run(robot, cut), simulate(cell, reference).result
    np.testing.assert_array_equal(column(outputs, "deflection", "twist"), expected.deflection)
    np.testing.assert_array_equal(column(outputs, "deflection", "stamp"), expected.time_ns)
    for topic, field, series in (("tool_pose", "position", expected.tool), ("wrench", "wrench", expected.wrench)):
        last = {record.stamp: getattr(record, field) for record in records(outputs, topic)}  # of the iterated ones
        np.testing.assert_array_equal(list(last.values()), series)
    assert column(outputs, "joint_states", "stamp").tolist() == expected.time_ns.tolist()
    clock = [record.stamp for record in records(outputs, "clock")]  # none unless the cell requests it
    assert clock == (expected.time_ns[:: cell.exchange.steps_of(0.01)].tolist() if cell.publish.clock else [])
    assert robot.correction == expected.correction.max() and cut.cut.removed_area == expected.removed_area
    assert robot.finished and robot.passes == 1
    assert robot.wrench(WrenchSample(robot.awaited_ns, "workpiece", DOWN)) == []
    iterations = cell.exchange.iterations
    stamps = column(outputs, "tool_pose", "stamp").tolist()
    assert stamps[: 1 + iterations] == [0] + iterations * [stamps[1]] and len(stamps) == 1 + iterations * robot.steps


def test_only_the_first_and_the_last_pose_of_a_stamp_and_the_next_one_are_swept():
    """As in an iterated exchange: first elsewhere, then here, is the same as here at once."""
    cut, pose, wrench, following = started()
    area = cut.cut.removed_area
    np.testing.assert_array_equal(cut.pose(pose)[0][1].wrench, wrench)
    assert cut.cut.removed_area == area and wrench.any()
    elsewhere = pose._replace(position=pose.position + [3e-5, 2e-5, 0.0])
    assert np.any(cut.pose(elsewhere)[0][1].wrench != wrench)
    np.testing.assert_array_equal(cut.pose(pose)[0][1].wrench, wrench)
    for jump, reason in ((2, "does not follow"), (100, "does not follow"), (-1, "is older"), (0.3, "does not follow")):
        stamp = pose.stamp + round(jump * H)
        with pytest.raises(ExchangeError, match=reason) as caught:
            cut.pose(following._replace(stamp=stamp))
        assert caught.value.stamp_ns == stamp and cut.cut.removed_area == area
    untouched, *_ = started()
    np.testing.assert_array_equal(cut.pose(following)[0][1].wrench, untouched.pose(following)[0][1].wrench)


def test_without_reference_workpiece_or_start_robot_and_cut_refuse_with_a_sentence(short_cell):
    robot, cut = RobotProtocol(short_cell), CutProtocol(short_cell)
    with pytest.raises(ExchangeError):
        robot.start()
    with pytest.raises(MessageError, match="configure first"):
        cut.pose(PoseSample(0, "workpiece", np.zeros(3), DOWN))
    cut.configure()
    for stamp in (-H, 3, H):
        with pytest.raises(ExchangeError, match="has not seen its start"):
            cut.pose(PoseSample(stamp, "workpiece", np.zeros(3), DOWN))


def test_a_wrench_in_axes_of_the_tool_moves_the_robot_as_the_same_wrench_of_the_workpiece(short_cell):
    turned = np.array([1, -1, -1, 1, -1, -1])  # tcp hangs down: half a turn about x
    deflections = []
    for frame, sign in (("workpiece", 1), ("tcp", turned)):
        robot, _ = protocols(short_cell)
        outputs = robot.start()
        for force in (300.0, -200.0, 100.0):
            wrench = np.array([force, 2 * force, -force, 5.0, 1.0, 2.0])
            outputs = robot.wrench(WrenchSample(robot.awaited_ns, frame, sign * wrench))
        deflections.append(records(outputs, "tool_pose")[-1].position)
    np.testing.assert_allclose(*deflections, rtol=0, atol=1e-15)
    assert np.abs(deflections[0] - path_of(short_cell).target.position[0]).max() > 1e-6


def test_the_map_is_that_of_the_part_and_a_pass_ends_with_its_reference(short_cell):
    robot, cut = protocols(short_cell)
    ((_, fresh),) = cut.configure()
    assert fresh.stamp == 0 and set(fresh.cells.ravel().tolist()) == {100}
    cut.reference(path_of(short_cell).target)
    going = [cut.under_way]
    run(robot, cut, lambda robot, cut, pose: going.append(cut.under_way) or [])
    assert going == [False, False] + [True] * (len(going) - 2) and not cut.under_way and cut.at_end
    used = cut.map_of_part()
    assert used.stamp == cut.stamp_ns == path_of(short_cell).clock.stamp(robot.steps) and used.cells.min() < 100
    share = (100 - used.cells.astype(float)) / 100
    height, area = short_cell.stock.max[2] - short_cell.stock.min[2], used.resolution**2
    # a cell of the map holds the node in its middle, rounded to a percent of the height: half a percent of each cell
    bound = 0.005 * np.count_nonzero(share) * area * height
    assert abs(share.sum() * area * height - cut.removed_volume) <= 2 * bound


# --- The compensator's protocol: when a pass is complete, and that the order of its messages does not matter ---


@pytest.fixture
def protocol(short_cell):
    made = CompensatorProtocol(short_cell)
    made.begin(path_of(short_cell).target)
    return made


def samples(ran, turned: bool = False) -> list:
    """Poses and wrenches in turn; turned: the wrenches in the axes of the tool."""
    turn = np.kron(np.eye(2), rotation_from_quaternion(DOWN)) if turned else np.eye(6)
    frame = "tcp" if turned else "workpiece"
    answer = []
    for stamp, tool, wrench in zip(ran.time_ns.tolist(), ran.tool, ran.wrench, strict=True):
        answer += [PoseSample(stamp, "workpiece", tool, DOWN), WrenchSample(stamp, frame, turn.T @ wrench)]
    return answer


def feed(protocol, records, begin: int | None = None) -> list:
    """Feed messages with times of the pass; begin: that of the pass [ns], else that of the protocol."""
    outputs, start = [], protocol.inbox.start_ns if begin is None else begin
    for record in (record._replace(stamp=start + record.stamp) for record in records):
        outputs += (protocol.pose if isinstance(record, PoseSample) else protocol.wrench)(record)
    return outputs


def states(outputs) -> list:
    return records(outputs, "compensator_state")


def expected(cell, ran):
    return compensator(cell, path_of(cell).target).revise(record_of(cell, ran))


def assert_revised(outputs, reference) -> None:
    assert [topic for topic, _ in outputs] == ["compensator_state", "reference_trajectory"]
    np.testing.assert_array_equal(outputs[1][1].position, reference.position)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("overtaking", [1, 2, 7, 10**6])
def test_a_pass_is_revised_once_from_all_its_messages_in_whatever_order(protocol, ran, short_cell, overtaking, turned):
    records = samples(ran, turned)
    # of so many messages the wrenches come first, each topic in its order
    groups = [records[i : i + overtaking] for i in range(0, len(records), overtaking)]
    records = [
        record for group in groups for record in sorted(group, key=lambda record: isinstance(record, PoseSample))
    ]
    outputs = feed(protocol, records)
    assert_revised(outputs, expected(short_cell, ran))
    assert outputs[0][1].learned[0].wrenches == len(ran.time_ns)
    np.testing.assert_array_equal(protocol.compensator.first.wrench, ran.wrench)
    assert not protocol.under_way


def test_the_state_names_method_and_recordings_and_another_method_and_a_reset_start_from_the_target(
    protocol, ran, short_cell
):
    (fresh,) = states(protocol.reset())
    assert (fresh.name, fresh.method, fresh.passes, fresh.learned) == ("trajectory_compensator", "linear", 0, ())
    assert fresh.target == fresh.reference == fingerprint(path_of(short_cell).target)
    named = []
    for name in ("original/original.mcap", "second/second.mcap"):
        protocol.recording = name
        (state,) = states(feed(protocol, samples(ran)))
        named.append(name)
        assert [one.recording for one in state.learned] == named and state.passes == len(named)
        assert state.reference == fingerprint(protocol.compensator.reference)
    one, other = state.learned  # the same messages in two files
    assert one.fingerprint == other.fingerprint and (one.poses, one.wrenches) == 2 * (len(ran.time_ns),)
    outputs = protocol.choose("spline")  # from the pass along the target
    assert_revised(
        outputs, compensator(short_cell, path_of(short_cell).target, "spline").revise(record_of(short_cell, ran))
    )
    (chosen,) = states(outputs)
    assert chosen.method == "spline" and [one.recording for one in chosen.learned] == named[:1]
    outputs = protocol.reset()
    assert_revised(outputs, path_of(short_cell).target)
    assert states(outputs)[0].learned == ()


@pytest.mark.parametrize(("index", "field"), [(41, "wrench"), (40, "position"), (-1, None)])
def test_the_fingerprint_of_a_pass_covers_every_message(protocol, ran, index, field):
    records = samples(ran)
    (plain,) = states(feed(protocol, records))
    record = records.pop(index)  # the last wrench, or one that differs in its last bit
    if field is not None:
        values = getattr(record, field).copy()
        values[0] = np.nextafter(values[0], 1.0)
        records.insert(index, record._replace(**{field: values}))
    (other,) = states(feed(protocol, records) or protocol.finish())
    assert other.learned[0] == plain.learned[0]
    assert other.learned[-1].wrenches == plain.learned[-1].wrenches - (field is None)
    assert other.learned[-1].fingerprint != plain.learned[-1].fingerprint


def test_samples_out_of_order_count_for_nothing_and_holes_are_counted(protocol, ran, short_cell):
    records = samples(ran)
    assert feed(protocol, records[2:8:2]) == [] and protocol.inbox.ignored == 3 and not protocol.under_way
    older, repeated = records[10], records[38]
    outputs = feed(protocol, [*records[:40], older, repeated, *records[40:]])
    assert_revised(outputs, expected(short_cell, ran))
    assert protocol.missing == 0 and feed(protocol, [records[-2]]) == []  # the pass has ended
    feed(protocol, records[:40] + records[46:])
    assert protocol.missing == 3


# --- A robot and a sensor with another clock ---


def test_learning_converges_with_a_robot_of_another_clock():
    """Poses every 4 ms with jitter, 2 % lost, force at 1 kHz; the error is at most the noise of one pose."""
    cell, noise = read_cell(find_file("paper.yaml"), (*PLACED, "compensation.method=learned")), 5e-6
    cell = cell.replace(imperfections=cell.imperfections.replace(pose_noise=noise))
    protocol = CompensatorProtocol(cell)
    protocol.begin(path_of(cell).target)
    errors = []
    for number in range(4):
        result = simulate(cell, protocol.active.reference).result
        errors.append(np.abs((result.actual - result.target)[result.time > path_of(cell).full_engagement, 1]).max())
        feed(protocol, foreign_pass(result, number, noise, cell), 0)
        assert protocol.passes == number + 1 and not protocol.under_way
    assert errors[0] > 60e-6 and errors[-1] < noise


def test_an_untared_sensor_in_its_own_frame_gives_the_wrench_at_the_tip(ran):
    """Its offset, its weight and its lever arm are gone; the mount is off the axis, and the tool is not upright."""
    cell = cell_with("path.length_mm=4", "mount.xyz_mm=[140, 30, -320]", "mount.abc_deg=[10, 80, 5]", *PLACED)
    frames, tilted = (
        WrenchFrames(cell.mount, cell.workpiece, cell.sensor),
        rotation_from_quaternion(np.array([0.9, 0.1, 0.2, 0.3])),
    )
    true, quaternions = ran.wrench[-200:], (DOWN, quaternion_from_rotation(tilted))
    before, after = (readings(cell, wrench, q) for wrench, q in zip((0 * true, true), quaternions, strict=True))
    offset = frames.offset([WrenchSample(i, "ft_sensor", row) for i, row in enumerate(before)], DOWN)
    got = frames.at_tip("ft_sensor", after, np.tile(quaternions[1], (len(after), 1)), offset)
    np.testing.assert_allclose(got, true, rtol=0, atol=1e-9)
    with pytest.raises(MessageError, match="'camera', but must be workpiece, tcp"):
        checked_wrench(WrenchSample(0, "camera", np.zeros(6)), frames.names)
    with pytest.raises(ConfigError, match="sensor.frame"):
        cell_with("sensor.frame=tcp")


def test_a_wrench_is_moved_as_pinocchio_moves_it():
    pin, random = pytest.importorskip("pinocchio"), np.random.default_rng(3)
    for _ in range(5):
        placement, wrench = pin.SE3.Random(), random.normal(size=6)
        moved = moved_wrench(wrench, Pose(placement.translation, placement.rotation))
        np.testing.assert_allclose(moved, placement.act(pin.Force(wrench)).vector, rtol=0, atol=1e-12)


@pytest.fixture
def announced(short_cell):
    """A compensator whose passes start with a message of the robot."""
    made = CompensatorProtocol(short_cell, announced=True)
    made.begin(path_of(short_cell).target)
    return made


def test_a_message_of_the_robot_starts_its_pass_where_it_says(announced, ran):
    messages = foreign_pass(ran, 0)
    assert feed(announced, messages[:100], 0) == [] and not announced.under_way  # also on the grid of the exchange
    announced.start(WALL)
    assert announced.inbox.start_ns == WALL and announced.inbox.foreign
    topics = [topic for topic, _ in feed(announced, messages[100:], 0)]
    assert topics == ["compensator_state", "reference_trajectory"]
    np.testing.assert_allclose(announced.active.first.wrench[:, 1].max(), ran.wrench[:, 1].max(), rtol=0.05)


def test_a_gap_in_the_stamps_of_a_pass_is_stated(announced, ran):
    announced.start(WALL)
    running = [sample for sample in foreign_pass(ran, 0) if sample.stamp >= WALL]
    feed(announced, [sample for sample in running if sample.stamp < WALL + 20_000_000], 0)
    later = next(sample for sample in running if isinstance(sample, PoseSample) and sample.stamp > WALL + 20_000_000)
    feed(announced, [later._replace(stamp=later.stamp + 200_000_000)], 0)
    assert announced.inbox.problem.startswith("no tool_pose for 0.2")


def test_a_pass_that_does_not_follow_the_reference_is_refused(announced, ran):
    """6 mm above; a wrong override leads away as well."""
    announced.start(WALL)
    messages = [s for s in foreign_pass(ran, 0) if s.stamp >= WALL]
    far = [s._replace(position=s.position + [0, 0, 6e-3]) if isinstance(s, PoseSample) else s for s in messages]
    with pytest.raises(MessageError, match="is the override 100 %"):
        feed(announced, far, 0)
    assert not announced.under_way and announced.passes == 0


@pytest.mark.parametrize("ends", ["no tool_pose for 6", "the tool does not move"])
def test_a_robot_that_stops_in_mid_pass_ends_the_pass_and_its_next_start_counts(short_cell, ends):
    """A pass of 10 s at a slow feed; stamps on the grid of the exchange."""
    cell = short_cell.replace(path=short_cell.path.replace(length=40e-3, feed_rate=4e-3))
    protocol = CompensatorProtocol(cell)
    protocol.begin(path_of(cell).target)
    reference, ms = protocol.active.reference, 1_000_000
    assert protocol.inbox.distance is None
    begin = [(k * ms, 0) for k in range(0, 300, 4)] + [(k * ms, (k - 300) * ms) for k in range(300, 2300, 4)]
    rest = [] if ends.startswith("no") else [(k * ms, 2000 * ms) for k in range(2300, 8000, 4)]
    again = [(8300 * ms + t, at) for t, at in begin]
    problems = []
    for stamp, at in begin + rest + again:
        protocol.pose(PoseSample(WALL // ms * ms + stamp, "workpiece", reference.sample(at), DOWN))
        problems += [protocol.inbox.problem] if protocol.inbox.problem not in problems[-1:] else []
    (over,) = [problem for problem in problems if problem.endswith("the next start begins another pass")]
    assert over.startswith(ends)
    assert protocol.under_way and protocol.inbox.foreign
    assert abs(protocol.inbox.start_ns - WALL - 8600 * ms) < 8 * ms


def test_a_tool_exactly_at_the_first_point_is_known_to_wait_there(protocol):
    protocol.pose(PoseSample(WALL, "workpiece", protocol.active.reference.position[0], DOWN))
    assert protocol.inbox.distance == 0.0 and not protocol.under_way


def test_a_robot_of_another_clock_starts_when_it_leaves_the_first_point(protocol, ran):
    poses = [sample for sample in foreign_pass(ran, 0) if isinstance(sample, PoseSample)]
    for sample in poses:
        assert protocol.pose(sample._replace(position=sample.position + [0.0, 0.0, 0.01])) == []
    assert not protocol.under_way and protocol.inbox.distance > 9.9e-3  # the whole pass is 10 mm above
    for sample in poses[:90]:
        protocol.pose(sample)
    assert protocol.under_way and protocol.inbox.foreign
    assert abs(protocol.inbox.start_ns - WALL) < 1_000_000
    assert abs(lag(protocol.active.reference, ran.time_ns + 700_000, ran.tool) - 700_000) < 100_000
