"""The compensator's protocol: when a pass is complete, and that the order of its messages does not matter."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import MessageError
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.exchange.compensator import CompensatorProtocol
from kr270_milling.path.trajectory import fingerprint

DOWN = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def ran(short_cell):
    return simulate(short_cell).result


@pytest.fixture
def protocol(short_cell):
    made = CompensatorProtocol(short_cell)
    made.begin(short_cell.target())
    return made


def samples(ran, turned: bool = False) -> list:
    """Poses and wrenches in turn; turned: the wrenches in the axes of the tool."""
    turn = np.kron(np.eye(2), rotation_from_quaternion(DOWN)) if turned else np.eye(6)
    frame = "tool0" if turned else "workpiece"
    answer = []
    for stamp, tool, wrench in zip(ran.time_ns.tolist(), ran.tool, ran.wrench, strict=True):
        answer += [PoseSample(stamp, "workpiece", tool, DOWN), WrenchSample(stamp, frame, turn.T @ wrench)]
    return answer


def feed(protocol, records) -> list:
    outputs = []
    for record in records:
        outputs += (protocol.pose if isinstance(record, PoseSample) else protocol.wrench)(record)
    return outputs


def expected(cell, ran):
    return compensator(cell, cell.target()).revise(record_of(cell, ran))


def assert_revised(outputs, reference) -> None:
    assert [topic for topic, _ in outputs] == ["compensator_state", "reference_trajectory", "joint_trajectory"]
    np.testing.assert_array_equal(outputs[1][1].position, reference.position)


def in_pairs_reversed(records: list) -> list:
    """Every wrench overtakes the pose that it answers."""
    return [record for i in range(0, len(records), 2) for record in reversed(records[i : i + 2])]


@pytest.mark.parametrize("order", [list, in_pairs_reversed])
@pytest.mark.parametrize("turned", [False, True])
def test_a_pass_is_revised_once_from_all_its_messages_in_whatever_order(protocol, ran, short_cell, order, turned):
    outputs = feed(protocol, order(samples(ran, turned)))
    assert_revised(outputs, expected(short_cell, ran))
    np.testing.assert_array_equal(protocol.compensator.first.wrench, ran.wrench)
    assert not protocol.under_way


def test_poses_alone_wait_for_the_last_wrench_until_it_is_given_up(protocol, ran, short_cell):
    *most, last = samples(ran)
    assert feed(protocol, most) == [] and protocol.at_end
    assert_revised(protocol.finish(), expected(short_cell, ran))
    assert protocol.finish() == [] and feed(protocol, [last]) == []


def test_poses_before_the_start_and_out_of_order_count_for_nothing(protocol, ran, short_cell):
    records = samples(ran)
    assert feed(protocol, records[2:8:2]) == [] and protocol.inbox.ignored == 3 and not protocol.under_way
    older, repeated = records[10], records[38]
    outputs = feed(protocol, [*records[:40], older, repeated, *records[40:]])
    assert_revised(outputs, expected(short_cell, ran))
    assert protocol.missing == 0 and feed(protocol, [records[-2]]) == []  # the pass has ended


def test_a_new_start_begins_anew(protocol, ran, short_cell):
    records = samples(ran)
    assert_revised(feed(protocol, records[:30] + records), expected(short_cell, ran))
    assert len(protocol.compensator.first.time_ns) == len(ran.time_ns)


def test_nothing_is_finished_in_mid_pass(protocol, ran):
    assert feed(protocol, samples(ran)[:40]) == [] == protocol.finish()
    assert protocol.under_way and not protocol.at_end


def states(outputs) -> list:
    return [record for topic, record in outputs if topic == "compensator_state"]


def test_the_state_names_method_and_the_recording_of_each_pass_it_learned_from(protocol, ran, short_cell):
    (fresh,) = states(protocol.reset())
    assert (fresh.name, fresh.method, fresh.passes, fresh.learned) == ("trajectory_compensator", "linear", 0, ())
    assert fresh.target == fresh.reference == fingerprint(short_cell.target())
    named = []
    for name in ("original/original.mcap", "second/second.mcap"):
        protocol.recording = name
        (state,) = states(feed(protocol, samples(ran)))
        named.append(name)
        assert [one.recording for one in state.learned] == named and state.passes == len(named)
        assert state.reference == fingerprint(protocol.compensator.reference)
    one, other = state.learned  # the same messages in two files
    assert one.fingerprint == other.fingerprint and (one.poses, one.wrenches) == 2 * (len(ran.time_ns),)
    (chosen,) = states(protocol.choose("spline"))  # from the pass along the target
    assert chosen.method == "spline" and [one.recording for one in chosen.learned] == named[:1]
    assert states(protocol.reset())[0].learned == ()


@pytest.mark.parametrize("change", ["wrench", "pose", "last wrench"])
def test_the_fingerprint_of_a_pass_covers_every_message(protocol, ran, change):
    records = samples(ran)
    (plain,) = states(feed(protocol, records))
    if change == "last wrench":
        (other,) = states(feed(protocol, records[:-1]) or protocol.finish())
        assert other.learned[-1].wrenches == plain.learned[-1].wrenches - 1
    else:
        at = 41 if change == "wrench" else 40
        values = records[at][-1 if change == "wrench" else 2].copy()
        values[0] = np.nextafter(values[0], 1.0)
        records[at] = records[at]._replace(**{"wrench" if change == "wrench" else "position": values})
        (other,) = states(feed(protocol, records))
    assert other.learned[0] == plain.learned[0]
    assert other.learned[-1].fingerprint != plain.learned[-1].fingerprint


@pytest.mark.parametrize("bad", [
    PoseSample(0, "base_link", np.zeros(3), DOWN), PoseSample(0, "workpiece", np.full(3, np.nan), DOWN),
    WrenchSample(0, "base_link", np.zeros(6)), WrenchSample(0, "workpiece", np.full(6, np.inf)),
])  # fmt: skip
def test_unusable_samples_are_refused_and_the_pass_continues(protocol, ran, short_cell, bad):
    records = samples(ran)
    outputs = feed(protocol, records[:40])
    with pytest.raises(MessageError):
        feed(protocol, [bad])
    assert_revised(outputs + feed(protocol, records[40:]), expected(short_cell, ran))


def test_holes_are_counted(protocol, ran):
    records = samples(ran)
    feed(protocol, records[:40] + records[46:])
    assert protocol.missing == 3


def test_another_method_and_a_reset_start_from_the_target(protocol, ran, short_cell):
    feed(protocol, samples(ran))
    spline = compensator(short_cell, short_cell.target(), "spline").revise(record_of(short_cell, ran))
    assert_revised(protocol.choose("spline"), spline)
    assert_revised(protocol.reset(), short_cell.target())
