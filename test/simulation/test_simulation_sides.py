"""The two sides of the exchange, message by message, against the compiled pass."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.simulation.sides import CuttingSide, ExchangeError, RobotSide

SHORT = ("path.length_mm=14.4",)


def sides(*assignments):
    cell = read_cell(find_file("paper.yaml"), (*SHORT, *assignments))
    target = cell.target()
    robot = RobotSide(cell.arm_model(target), cell.clock, target, cell.exchange.iterations)
    return cell, robot, CuttingSide(cell.cut(), cell.clock)


def exchange(robot, cutting):
    """The plain loop: every message of a pass as (stamp, tool, wrench, deflection or None)."""
    while not robot.done:
        stamp, tool = robot.awaited_ns, robot.tool.copy()
        wrench = cutting.answer(stamp, tool)
        yield stamp, tool, wrench.copy(), robot.answer(stamp, wrench)


def started(steps=3):
    """Both sides after some steps of a pass that cuts from the first step on."""
    _, robot, cutting = sides("path.start_mm=[-5, 0]")
    messages = exchange(robot, cutting)
    return robot, cutting, [next(messages) for _ in range(steps + 1)]


@pytest.mark.parametrize("options", [(), ("exchange.iterations=2",), ("exchange.period_ms=0.0208333333333333",),
                                     ("dynamics.follow_pose=true",), ("tool.runout_um=[0, 5, -5, 2]",)])  # fmt: skip
def test_the_plain_loop_equals_the_compiled_pass_bit_for_bit(options):
    cell, robot, cutting = sides(*options)
    compiled = simulate(cell).result
    done = [m for m in exchange(robot, cutting) if m[3] is not None]
    np.testing.assert_array_equal([m[0] for m in done], compiled.time_ns)
    np.testing.assert_array_equal([m[1] for m in done], compiled.tool)
    np.testing.assert_array_equal([m[2] for m in done], compiled.wrench)
    np.testing.assert_array_equal([m[3] for m in done], compiled.deflection)
    assert robot.correction == compiled.correction.max()
    assert cutting.cut.removed_area == compiled.removed_area


def test_an_iterated_exchange_asks_again_with_the_same_stamp():
    _, robot, cutting = sides("exchange.iterations=3")
    stamps = [m[0] for m in exchange(robot, cutting)]
    assert stamps[:5] == [0, 500_000, 500_000, 500_000, 1_000_000] and len(stamps) == 1 + 3 * robot.steps


def test_the_pass_starts_at_rest_out_of_load():
    _, robot, cutting = sides()
    first = next(exchange(robot, cutting))
    assert first[0] == 0 and not first[2].any() and not first[3].any()
    np.testing.assert_array_equal(first[1], robot.course[0])


def test_a_repeated_tool_position_gets_the_answer_of_before_and_cuts_nothing():
    _, cutting, messages = started()
    stamp, tool, wrench, _ = messages[-1]
    area = cutting.cut.removed_area
    for _ in range(3):
        np.testing.assert_array_equal(cutting.answer(stamp, tool), wrench)
    assert cutting.cut.removed_area == area and wrench.any()


def test_another_tool_position_at_the_same_stamp_is_swept_from_the_step_before():
    """As in an iterated exchange: first elsewhere, then here, is the same as here at once."""
    robot, cutting, messages = started()
    stamp, tool, wrench, _ = messages[-1]
    assert np.any(cutting.answer(stamp, tool + [3e-5, 2e-5, 0.0]) != wrench)
    np.testing.assert_array_equal(cutting.answer(stamp, tool), wrench)
    following = robot.awaited_ns, robot.tool
    other, untouched, _ = started()
    np.testing.assert_array_equal(cutting.answer(*following), untouched.answer(*following))


def test_a_repeated_wrench_moves_the_robot_no_further():
    robot, _, messages = started()
    awaited, tool = robot.awaited_ns, robot.tool.copy()
    for stamp, _, wrench, _ in (messages[-1], messages[0]):
        assert robot.answer(stamp, 2 * wrench) is None
    assert robot.awaited_ns == awaited
    np.testing.assert_array_equal(robot.tool, tool)


@pytest.mark.parametrize("ahead", [1, -500_000, 500_000])
def test_a_wrench_with_another_stamp_is_not_taken(ahead):
    robot, _, _ = started()
    assert robot.answer(robot.awaited_ns + ahead, np.ones(6)) is None


def test_a_finished_robot_takes_no_wrench_and_keeps_its_last_stamp():
    _, robot, cutting = sides()
    *_, last = exchange(robot, cutting)
    assert robot.done and robot.awaited_ns == last[0] and robot.answer(last[0], np.ones(6)) is None
    np.testing.assert_array_equal(robot.orientation_now, robot.orientation[-1])


@pytest.mark.parametrize(
    ("jump", "reason"), [(2, "does not follow"), (100, "does not follow"), (-1, "is older"), (0.3, "does not follow")]
)
def test_gaps_and_backward_stamps_are_refused_and_change_nothing(jump, reason):
    robot, cutting, messages = started()
    area = cutting.cut.removed_area
    with pytest.raises(ExchangeError, match=reason) as caught:
        cutting.answer(messages[-1][0] + round(jump * 500_000), robot.tool)
    assert caught.value.stamp_ns == messages[-1][0] + round(jump * 500_000)
    assert cutting.cut.removed_area == area
    cutting.answer(robot.awaited_ns, robot.tool)  # the pass goes on


def test_a_cutting_process_that_joins_in_the_middle_says_so():
    robot, _, _ = started()
    _, _, fresh = sides()
    with pytest.raises(ExchangeError, match="has not seen its start"):
        fresh.answer(robot.awaited_ns, robot.tool)


def test_a_second_pass_needs_a_fresh_workpiece():
    _, cutting, messages = started()
    with pytest.raises(ExchangeError, match="fresh workpiece"):
        cutting.answer(0, messages[0][1])


def test_the_start_may_be_repeated_from_elsewhere_until_the_pass_is_under_way():
    _, robot, cutting = sides()
    assert not cutting.answer(0, robot.tool + 1e-3).any() and not cutting.answer(0, robot.tool).any()
    np.testing.assert_array_equal(cutting.answer(500_000, robot.tool), np.zeros(6))


@pytest.mark.parametrize("stamp", [-500_000, 3, 500_000])
def test_a_pass_begins_at_stamp_zero(stamp):
    _, robot, cutting = sides()
    with pytest.raises(ExchangeError):
        cutting.answer(stamp, robot.tool)


def test_what_a_caller_does_to_its_arrays_afterwards_does_not_matter():
    _, robot, cutting = sides("path.start_mm=[-5, 0]")
    _, other, undisturbed = sides("path.start_mm=[-5, 0]")
    for _ in range(6):
        stamp, tool = robot.awaited_ns, robot.tool.copy()
        wrench = cutting.answer(stamp, tool).copy()
        tool[:] = np.nan
        robot.answer(stamp, wrench)
        wrench[:] = np.nan
        other.answer(stamp, undisturbed.answer(stamp, other.tool))
    np.testing.assert_array_equal(robot.tool, other.tool)
