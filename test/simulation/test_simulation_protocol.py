"""The protocols of robot and cut: records in, records out, against the compiled pass."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.protocols import cut_protocol, robot_protocol
from kr270_milling.simulation.protocol import MessageError, NoWorkpiece
from kr270_milling.simulation.sides import ExchangeError


def protocols(cell):
    robot, cut = robot_protocol(cell, deflection_every=1), cut_protocol(cell)
    robot.reference = cell.target()
    cut.configure()
    return robot, cut


def iterated(cell, iterations: int):
    return cell.replace(exchange=cell.exchange.replace(iterations=iterations))


def run(robot, cut, disturb=lambda robot, cut, pose: []) -> list:
    """All outputs of a pass; disturb: what else happens at a question, and what that gives."""
    outputs = robot.start()
    found = list(outputs)
    while poses := [record for topic, record in outputs if topic == "tool_pose"]:
        outputs = disturb(robot, cut, poses[-1])
        answers = [cut.pose(pose) for pose in (poses[-1], *(r for t, r in outputs if t == "tool_pose"))]
        outputs = [output for ((_, wrench),) in answers for output in robot.wrench(wrench)]
        found += [answers[0][0], *outputs]
    return found


def column(outputs, topic: str, field: str) -> np.ndarray:
    return np.array([getattr(record, field) for name, record in outputs if name == topic])


@pytest.mark.parametrize("iterations", [1, 3])
def test_the_protocols_give_the_compiled_pass_bit_for_bit(short_cell, iterations):
    cell = iterated(short_cell, iterations)
    outputs, expected = run(*protocols(cell)), simulate(cell).result
    np.testing.assert_array_equal(column(outputs, "deflection", "twist"), expected.deflection)
    np.testing.assert_array_equal(column(outputs, "deflection", "stamp"), expected.time_ns)
    last = {record.stamp: record for topic, record in outputs if topic == "tool_pose"}  # of the iterated ones
    np.testing.assert_array_equal([record.position for record in last.values()], expected.tool)
    thinned = cell.thinned_steps
    assert column(outputs, "joint_states", "stamp").tolist() == expected.time_ns[::thinned].tolist()
    assert column(outputs, "clock", "stamp").tolist() == expected.time_ns[:: cell.steps_of(0.01)].tolist()


@pytest.mark.parametrize("iterations", [1, 3])
def test_a_question_that_is_asked_twice_changes_nothing(short_cell, iterations):
    """Its second answer must not count as that of the next iteration."""
    cell = iterated(short_cell, iterations)

    def ask_again(robot, cut, pose):
        return robot.repeat() if pose.stamp in (0, 500_000, 20_000_000) else []

    disturbed, plain = run(*protocols(cell), ask_again), run(*protocols(cell))
    np.testing.assert_array_equal(column(disturbed, "deflection", "twist"), column(plain, "deflection", "twist"))


def test_a_robot_refuses_what_it_cannot_use_and_goes_on(short_cell):
    robot, cut = protocols(short_cell)

    def disturb(robot, cut, pose):
        for values, frame in ((np.full(6, np.nan), "workpiece"), (np.ones(6), "base_link")):
            with pytest.raises(MessageError):
                robot.wrench(WrenchSample(pose.stamp, frame, values))
        assert robot.wrench(WrenchSample(pose.stamp + 500_000, "workpiece", np.ones(6))) == []
        return []

    disturbed, plain = run(robot, cut, disturb), run(*protocols(short_cell))
    np.testing.assert_array_equal(column(disturbed, "deflection", "twist"), column(plain, "deflection", "twist"))


def test_a_cut_refuses_what_it_cannot_use_and_goes_on(short_cell):
    robot, cut = protocols(short_cell)

    def disturb(robot, cut, pose):
        at, turn = pose.position, pose.quaternion
        bad = [(pose.stamp, "tool0", at, turn), (pose.stamp, "workpiece", at * np.nan, turn)]
        for sample in (*bad, (pose.stamp, "workpiece", at, 2 * turn)):
            with pytest.raises(MessageError):
                cut.pose(PoseSample(*sample[:2], *sample[2:]))
        with pytest.raises(ExchangeError):
            cut.pose(PoseSample(pose.stamp + 5_000_000, "workpiece", at, turn))
        return []

    disturbed, plain = run(robot, cut, disturb), run(*protocols(short_cell))
    np.testing.assert_array_equal(column(disturbed, "wrench", "wrench"), column(plain, "wrench", "wrench"))


def test_a_cut_without_a_workpiece_says_so(short_cell):
    cut = cut_protocol(short_cell)
    with pytest.raises(NoWorkpiece, match="configure first"):
        cut.pose(PoseSample(0, "workpiece", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    with pytest.raises(NoWorkpiece):
        cut.workpiece()


def test_the_map_is_that_of_the_part_and_a_fresh_one_is_whole(short_cell):
    robot, cut = protocols(short_cell)
    ((_, fresh),) = cut.configure()
    assert fresh.stamp == 0 and set(fresh.cells.ravel().tolist()) == {100}
    run(robot, cut)
    ((_, used),) = cut.workpiece()
    assert used.stamp == cut.stamp_ns == cut.side.clock.stamp(robot.side.steps) and used.cells.min() < 100
    share = (100 - used.cells.astype(float)) / 100
    volume = share.sum() * used.resolution**2 * (short_cell.stock.max[2] - short_cell.stock.min[2])
    # a cell of the map holds the node in its middle, rounded to a percent of the height: half a percent of each cell
    bound = 0.005 * np.count_nonzero(share) * used.resolution**2 * (short_cell.stock.max[2] - short_cell.stock.min[2])
    assert abs(volume - cut.side.cut.removed_volume) <= 2 * bound


def test_a_pass_is_under_way_from_its_first_pose_to_the_end_of_the_reference(short_cell):
    robot, cut = protocols(short_cell)
    cut.end_ns = short_cell.target().duration_ns
    assert not cut.under_way
    seen = []
    run(robot, cut, lambda robot, cut, pose: seen.append(cut.under_way) or [])
    assert seen == [False] + [True] * (len(seen) - 1) and not cut.under_way
