"""Deflections that are published less often than every exchange: nothing is lost by it."""

from __future__ import annotations

import numpy as np
import pass_recording as made
import pytest
from pass_recording import STEPS

from kr270_milling.cell.jobs import simulate
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import pass_from_recording

pytestmark = made.needs_messages


def thinned(directory, every: int, change=lambda messages: messages):
    messages = change(list(made.one_pass(every=every)))
    return made.write(directory, messages, cell=made.cell_text(every=every))


@pytest.mark.parametrize("every, count", [(0, 7), (40, 4), (1, STEPS)])
def test_a_thinned_recording_recomputes_and_gives_all_deflections_to_the_bit(tmp_path, every, count):
    bag = thinned(tmp_path / "r", every)
    replayed = recompute(bag)
    assert replayed.verdict == "identical", (replayed.first, replayed.stops)
    channel = replayed.channels["/deflection"]
    assert (channel.compared, channel.missing) == (count, 0)
    recorded, plain = pass_from_recording(bag), simulate(made.cell_of(every=every))
    assert recorded.complete and recorded.messages_lost == recorded.lost_to_end == 0
    np.testing.assert_array_equal(recorded.scored.result.deflection, plain.result.deflection)
    assert recorded.scored.scores == plain.scores


def test_a_recording_of_all_deflections_is_compared_in_full_for_every_cell(tmp_path):
    """As recordings of before ``publish.every`` are."""
    messages = [m for m in made.one_pass(every=1) if m.topic != "joint_states"]
    bag = made.write(tmp_path / "r", messages, cell=made.cell_text(every=0))
    replayed = recompute(bag)
    assert replayed.verdict == "identical" and replayed.channels["/deflection"].compared == STEPS


def test_joint_states_must_come_as_often_as_the_cell_states(tmp_path):
    """Their last bit may depend on how often that is: ``RobotFeed``."""
    bag = made.write(tmp_path / "r", made.one_pass(every=1), cell=made.cell_text(every=0))
    replayed = recompute(bag)
    assert (replayed.first.topic, replayed.first.index, replayed.first.stamp_ns) == ("/joint_states", 1, 500_000)
    assert {topic for topic, channel in replayed.channels.items() if channel.differing} == {"/joint_states"}


def test_a_thinned_deflection_that_is_lost_or_changed_is_reported(tmp_path):
    def lose(messages):
        return made.changed(messages, "deflection", 3, lambda data: None)

    replayed = recompute(thinned(tmp_path / "lost", 0, lose))
    assert replayed.channels["/deflection"].missing == 1
    assert not pass_from_recording(tmp_path / "lost").complete

    def change(messages):
        return made.changed(messages, "deflection", 3, made.flip(made.force_offset(1)))

    first = recompute(thinned(tmp_path / "changed", 0, change)).first
    assert (first.topic, first.index, first.stamp_ns) == ("/deflection", 3, 30_000_000)
    recorded = pass_from_recording(tmp_path / "changed").scored.result  # of another robot, then: only what it said
    assert recorded.time_ns.tolist()[-3:] == [40_000_000, 50_000_000, 60_000_000]
