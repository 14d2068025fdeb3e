"""Recomputing recordings: of a plain exchange and of changed ones."""

from __future__ import annotations

import contextlib
import dataclasses
import struct
from pathlib import Path

import numpy as np
import pass_recording as made
import pytest
from pass_recording import STEPS, flip, force_offset

from kr270_milling.base.errors import ConfigError, MillingError, RecordingError
from kr270_milling.base.samples import PoseSample, Text, WrenchSample
from kr270_milling.base.version import __version__
from kr270_milling.cell.jobs import simulate
from kr270_milling.cli import main
from kr270_milling.exchange.cut import CutProtocol
from kr270_milling.exchange.replay.compensate import compensate_recording
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.exchange.robot import RobotProtocol
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.codec import to_bytes

pytestmark = made.needs_messages
LATCHED = ("compensator_state", "reference_trajectory")


def test_a_recorded_exchange_is_recomputed_to_the_last_bit_on_every_channel(tmp_path):
    replayed = recompute(made.write(tmp_path / "r", made.one_pass()))
    assert replayed.verdict == "identical" and replayed.first is None and not replayed.stops
    both = {"/compensator_state": 2, "/reference_trajectory": 2}
    counts = {topic: c.compared for topic, c in replayed.channels.items()}
    assert counts == {"/tool_pose": STEPS, "/wrench": STEPS, "/deflection": STEPS, "/joint_states": STEPS,
                      "/workpiece": 1} | both  # fmt: skip
    assert all(c.waiting == c.missing == c.given == 0 for c in replayed.channels.values())


@pytest.mark.parametrize("bit", [0, 51])
def test_one_flipped_mantissa_bit_of_a_wrench_is_named_exactly(tmp_path, bit):
    index, at = 60, force_offset(1)
    messages = made.changed(made.one_pass(), "wrench", index, flip(at + bit // 8, bit % 8))
    before = [m for m in made.one_pass() if m.topic == "wrench"][index].data
    after = [m for m in messages if m.topic == "wrench"][index].data
    first = recompute(made.write(tmp_path / "r", messages)).first
    assert (first.topic, first.index, first.stamp_ns) == ("/wrench", index, index * 500_000)
    assert first.field == "wrench.force.y"
    assert struct.pack("<d", first.recorded) == after[at : at + 8]
    assert struct.pack("<d", first.recomputed) == before[at : at + 8]
    assert first.recorded != first.recomputed


def test_a_changed_output_that_feeds_nothing_leaves_the_other_channels_identical(tmp_path):
    messages = made.changed(made.one_pass(), "deflection", 33, flip(force_offset(2)))
    replayed = recompute(made.write(tmp_path / "r", messages))
    assert replayed.verdict == "different" and replayed.first.topic == "/deflection" and replayed.first.index == 33
    assert replayed.first.field == "twist.linear.z"
    assert {t: c.differing for t, c in replayed.channels.items() if c.differing} == {"/deflection": 1}


def test_bytes_between_the_fields_do_not_count(tmp_path):
    pad = 4 + 8 + 4 + 10  # behind "workpiece" and its NUL
    messages = made.changed(made.one_pass(), "tool_pose", 5, flip(pad))
    assert messages != list(made.one_pass())
    assert recompute(made.write(tmp_path / "r", messages)).verdict == "identical"


def test_a_changed_map_of_the_workpiece_is_detected(tmp_path):
    messages = made.changed(made.one_pass(), "workpiece", 0, flip(-2000))
    replayed = recompute(made.write(tmp_path / "r", messages))
    assert replayed.first.topic == "/workpiece" and replayed.first.field.startswith("data[")


def described(text: str) -> list:
    ((_, record),) = RobotProtocol(made.cell_of()).describe()
    return [made.Message("robot_description", to_bytes(Text(text) if text else record), 0)]


def test_a_changed_description_is_detected_but_not_in_a_recording_of_another_version(tmp_path, monkeypatch):
    """What the arm looks like in a viewer changes from version to version; it is no result."""
    same = recompute(made.write(tmp_path / "same", [*described(""), *made.one_pass()]))
    assert same.verdict == "identical" and same.channels["/robot_description"].compared == 1
    other = made.write(tmp_path / "other", [*described("x" * 100), *made.one_pass()])
    first = recompute(other).first
    assert first.topic == "/robot_description" and len(str(first)) < 300
    monkeypatch.setattr("kr270_milling.exchange.replay.robots.__version__", "99")
    replayed = recompute(other)
    assert replayed.verdict == "identical" and replayed.channels["/robot_description"].given == 1


def fresh_map() -> list[made.Message]:
    """What the cut publishes when it is configured, before every pass."""
    return made.messages(CutProtocol(made.cell_of()).configure())


def test_a_map_that_is_latched_from_the_pass_before_is_not_compared_with_this_one(tmp_path):
    messages = made.changed(made.one_pass(), "workpiece", 0, flip(-2000))
    latched = [m for m in messages if m.topic == "workpiece"]
    replayed = recompute(made.write(tmp_path / "r", [*latched, *fresh_map(), *made.one_pass()]))
    assert replayed.verdict == "identical"
    assert (replayed.channels["/workpiece"].given, replayed.channels["/workpiece"].compared) == (1, 2)


@pytest.mark.parametrize("index", [0, 1], ids=["of the fresh part", "of the finished part"])
@pytest.mark.parametrize("byte", [4, 8])  # seconds and nanoseconds of the stamp
def test_a_map_of_another_time_is_not_taken_for_granted(tmp_path, index, byte):
    whole = [*fresh_map(), *made.one_pass()]
    assert recompute(made.write(tmp_path / "whole", whole)).verdict == "identical"
    replayed = recompute(made.write(tmp_path / "r", made.changed(whole, "workpiece", index, flip(byte, 5))))
    assert replayed.verdict in ("incomplete", "different")
    assert "/workpiece" in str(replayed.first or replayed.stops[0])


@pytest.mark.parametrize("topic, who", [("wrench", "wrench"), ("tool_pose", "tool pose")])
def test_a_missing_input_stops_the_recompute_at_its_stamp(tmp_path, topic, who):
    messages = made.changed(made.one_pass(), topic, 40, lambda data: None)
    replayed = recompute(made.write(tmp_path / "r", messages))
    assert replayed.verdict == "incomplete" and replayed.first is None
    first, *others = replayed.stops
    assert first.stamp_ns == 40 * 500_000 and f"the {who} of this time" in first.reason
    assert ["the compensator received 121 poses and 121 wrenches" in str(stop) for stop in others] == [True]
    output = "/deflection" if topic == "wrench" else "/wrench"
    assert replayed.channels[output].compared == 40


def test_a_missing_output_is_counted_and_nothing_stops(tmp_path):
    messages = made.changed(made.one_pass(), "deflection", 40, lambda data: None)
    replayed = recompute(made.write(tmp_path / "r", messages))
    assert replayed.verdict == "identical"
    assert (replayed.channels["/deflection"].missing, replayed.channels["/deflection"].compared) == (1, STEPS - 1)


def test_invented_outputs_behind_the_end_are_not_called_identical(tmp_path):
    last = [m for m in made.one_pass() if m.topic == "deflection"][-1]
    invented = [made.Message("deflection", stamped(last.data, last.stamp + i * 500_000), 0) for i in range(1, 400)]
    replayed = recompute(made.write(tmp_path / "r", [*made.one_pass(), *invented]))
    assert replayed.verdict == "incomplete" and replayed.channels["/deflection"].waiting == 399
    (stop,) = replayed.stops
    assert str(stop).startswith("/: 399 messages on /deflection from 0.060500 s on were not compared")


def stamped(data: bytes, stamp: int) -> bytes:
    return data[:4] + struct.pack("<iI", stamp // 10**9, stamp % 10**9) + data[12:]


@pytest.mark.parametrize("remaining", [4, 1])
def test_outputs_that_were_cut_away_from_a_closed_file_are_missed(tmp_path, remaining):
    states = [m for m in made.one_pass() if m.topic == "joint_states"]
    messages = [m for m in made.one_pass() if m not in states[remaining:]]
    replayed = recompute(made.write(tmp_path / "r", messages))
    assert replayed.verdict == "incomplete" and replayed.first is None
    assert replayed.channels["/joint_states"].missing == len(states) - remaining
    assert [s.reason.split(" are ")[0] for s in replayed.stops] == [
        f"{STEPS - remaining} messages that belong on /joint_states"
    ]


@pytest.mark.parametrize("number", [1, 2])
def test_outputs_of_either_pass_are_missed(tmp_path, number):
    messages, passes = [], 0
    for message in made.one_pass(passes=2):
        passes += message.topic == "reference_trajectory"
        time = message.stamp - (number - 1) * (made.STEPS * 500_000)
        if not (passes == number and message.topic == "deflection" and time > 30_000_000):
            messages.append(message)
    replayed = recompute(made.write(tmp_path / "r", messages))
    assert replayed.verdict == "incomplete" and replayed.channels["/deflection"].missing == 60
    assert recompute(made.write(tmp_path / "whole", made.one_pass(passes=2))).verdict == "identical"


def test_a_recording_without_any_exchange_is_not_called_identical(tmp_path):
    replayed = recompute(made.write(tmp_path / "r", made.one_pass()[: made.LATCHED_FIRST]))
    assert replayed.compared == 2 and replayed.verdict == "incomplete"
    assert "no pass is in the recording" in str(replayed.stops[0])


@pytest.mark.parametrize("end", range(200, 230, 3))
def test_a_recorder_that_was_stopped_in_mid_pass_has_lost_nothing(tmp_path, end):
    replayed = recompute(made.write(tmp_path / "r", made.one_pass()[:end]))
    assert not replayed.cut_off and replayed.verdict == "identical"


@pytest.mark.parametrize("end", range(200, 212))
def test_a_pass_that_broke_off_and_was_started_again_has_lost_nothing(tmp_path, end):
    replayed = recompute(made.write(tmp_path / "r", [*made.one_pass()[:end], *made.one_pass()[made.LATCHED_FIRST :]]))
    assert replayed.verdict == "identical", replayed.stops


@pytest.mark.parametrize("version", ["0.1.0", "0.2.0", "0.4.1", "1.3.0"])
def test_a_recording_of_another_version_is_left_to_that_version(tmp_path, monkeypatch, version, capsys):
    monkeypatch.setattr("kr270_milling.recordings.bag.writer.__version__", version)
    bag = made.write(tmp_path / "r", made.one_pass())
    assert main(["replay", str(bag), "--recompute"]) == 2
    assert f"recorded by {version}; recompute it with that version" in capsys.readouterr().err
    assert pass_from_recording(bag).complete


def test_a_recording_of_another_patch_of_this_version_is_recomputed(tmp_path, monkeypatch):
    monkeypatch.setattr("kr270_milling.recordings.bag.writer.__version__", __version__.rpartition(".")[0] + ".99")
    assert recompute(made.write(tmp_path / "r", made.one_pass())).verdict == "identical"


@pytest.mark.parametrize("job", [recompute, compensate_recording])
def test_a_flipped_bit_in_the_first_chunk_is_one_sentence(tmp_path, job):
    file = made.write(tmp_path / "r", made.one_pass()) / "r.mcap"
    with Recording(file) as recording:
        chunk = recording.chunks[0]
    data = bytearray(file.read_bytes())
    data[(chunk.offset + chunk.end) // 2] ^= 1
    file.write_bytes(data)
    with pytest.raises(RecordingError, match="a chunk .*; recover may save the rest"):
        job(file)


def test_a_pass_that_began_before_the_recording_is_not_guessed(tmp_path):
    messages = [m for m in made.one_pass() if m.stamp > 5_000_000 or m.topic in LATCHED]
    replayed = recompute(made.write(tmp_path / "r", messages))
    assert replayed.verdict == "incomplete"
    assert sum("middle of a pass" in s.reason for s in replayed.stops) == 2


def test_a_repeated_pose_and_its_repeated_answer_are_a_retry(tmp_path):
    messages = list(made.one_pass())
    (pose, at), (wrench, _) = (
        next((m, i) for i, m in enumerate(messages) if m.topic == topic and m.stamp == 10_000_000)
        for topic in ("tool_pose", "wrench")
    )
    messages[at + 1 : at + 1] = [pose, wrench]
    replayed = recompute(made.write(tmp_path / "r", messages))
    assert replayed.verdict == "identical" and replayed.channels["/tool_pose"].repeated == 1
    assert replayed.channels["/wrench"].compared + replayed.channels["/wrench"].repeated == STEPS + 1


def test_an_iterated_exchange_is_recomputed_iteration_by_iteration(tmp_path):
    messages = made.one_pass("linear", 2)
    replayed = recompute(made.write(tmp_path / "r", messages, cell=made.cell_text("linear", 2)))
    assert replayed.verdict == "identical"
    assert replayed.channels["/wrench"].compared == 1 + 2 * (STEPS - 1)
    assert replayed.channels["/deflection"].compared == STEPS


def test_two_robots_in_two_namespaces_are_recomputed_side_by_side(tmp_path):
    replayed = recompute(made.write(tmp_path / "r", made.one_pass(), namespaces=("/left", "/cell/right")))
    assert replayed.verdict == "identical"
    assert {t.rpartition("/")[0] for t in replayed.channels} == {"/left", "/cell/right"}
    assert replayed.channels["/cell/right/wrench"].compared == STEPS


def test_a_recording_that_was_cut_off_is_compared_up_to_its_end(tmp_path):
    whole = made.write(tmp_path / "r", made.one_pass()) / "r.mcap"
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 4])
    replayed = recompute(cut)
    assert replayed.cut_off and replayed.verdict == "identical"
    assert 0 < replayed.channels["/wrench"].compared < STEPS


@pytest.mark.parametrize("index", [0, 1], ids=["state", "reference"])
def test_messages_of_other_topics_may_come_before_their_causes(tmp_path, index):
    messages = list(made.one_pass())
    late = messages.pop(index)  # a recorder that received a latched message after the start of the pass
    messages.insert(30, late)
    assert recompute(made.write(tmp_path / "r", messages)).verdict == "identical"


@pytest.mark.parametrize(
    "attached, sentence",
    [
        ({}, "no parameter file attached"),
        ({"a.yaml": "", "b.yaml": ""}, "has a.yaml, b.yaml attached"),
        ({"cell.yaml": "nonsense"}, "must have the form"),
        ({"cell.yaml": made.cell_text().replace("paper.yaml", "/etc/hostname")}, "which is not attached"),
        ({"cell.yaml": made.cell_text("sideways")}, "compensation.method"),
    ],
)
def test_a_recording_without_a_usable_cell_is_refused_in_one_sentence(tmp_path, attached, sentence):
    directory = made.write(tmp_path / "r", made.one_pass()[:20], attachments=attached)
    with pytest.raises((RecordingError, ConfigError), match=sentence) as error:
        recompute(directory)
    assert "\n" not in str(error.value) and "r.mcap" in str(error.value)


def test_the_attached_files_are_used_and_not_the_shipped_ones(tmp_path):
    paper = Path(made.shipped("paper.yaml")).read_text()
    attached = {"cell.yaml": made.cell_text(), "paper.yaml": paper.replace("teeth: 4", "teeth: 2")}
    replayed = recompute(made.write(tmp_path / "r", made.one_pass(), attachments=attached))
    assert replayed.verdict == "different" and replayed.first.topic == "/wrench"


def test_a_recording_of_something_else_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="holds no tool_pose"):
        recompute(made.write(tmp_path / "r", [], cell=made.cell_text()))


@pytest.mark.parametrize("seed", range(30))
def test_messages_with_any_content_end_in_a_verdict_or_a_sentence(tmp_path, seed):
    random = np.random.default_rng(seed)
    messages = list(made.one_pass()[:60]) + [m for m in made.one_pass()[60:] if m.topic in LATCHED]
    for _ in range(3):
        at = int(random.integers(len(messages)))
        data = bytearray(messages[at].data)
        where = int(random.integers(len(data)))
        if random.random() < 0.3:
            del data[where:]
        else:
            data[where : where + 8] = random.bytes(8)[: len(data) - where]
        messages[at] = made.Message(messages[at].topic, bytes(data), 0)
    directory = made.write(tmp_path / "r", messages)
    for job in (recompute, compensate_recording):
        with contextlib.suppress(MillingError):
            job(directory)


# --- A recompute refuses what the live nodes refused, and continues ---


AT = 30_000_000  # [ns]
ONE, DOWN = np.ones(3), np.array([1.0, 0.0, 0.0, 0.0])
REFUSED = {
    "wrench of NaN": ("wrench", WrenchSample(AT, "workpiece", np.full(6, np.nan))),
    "wrench in another frame": ("wrench", WrenchSample(AT, "base_link", np.ones(6))),
    "infinite wrench of another time": ("wrench", WrenchSample(7 * AT, "workpiece", np.full(6, np.inf))),
    "pose of NaN": ("tool_pose", PoseSample(AT, "workpiece", np.full(3, np.nan), DOWN)),
    "pose in another frame": ("tool_pose", PoseSample(AT, "flange", ONE, DOWN)),
    "pose of before": ("tool_pose", PoseSample(AT - 10_000_000, "workpiece", ONE, DOWN)),
}


def disturbed(topic: str, data: bytes) -> list:
    """A pass with a foreign message in its middle."""
    messages = list(made.one_pass())
    at = next(i for i, m in enumerate(messages) if m.topic == topic and m.stamp == AT)
    messages.insert(at, made.Message(topic, data, AT))
    return messages


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("job", ["recompute", "compensate"])
def test_one_message_that_the_live_nodes_refused_does_not_spoil_a_recording(tmp_path, name, job):
    topic, sample = REFUSED[name]
    directory = made.write(tmp_path / "r", disturbed(topic, to_bytes(sample)))
    if job == "compensate":
        assert compensate_recording(directory)[0].published is True
        return
    result = recompute(directory)
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels[f"/{topic}"].refused == 1
    assert result.channels["/wrench"].compared == result.channels["/deflection"].compared == STEPS


@pytest.mark.parametrize("place", [0, 150])
def test_a_reference_in_another_frame_does_not_spoil_a_recording_at_any_place(tmp_path, place):
    messages = list(made.one_pass())
    foreign = dataclasses.replace(made.cell_of().target(), frame="base_link")
    messages.insert(place, made.Message("reference_trajectory", to_bytes(foreign), 0))
    result = recompute(made.write(tmp_path / "r", messages))
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels["/reference_trajectory"].refused == 1
    assert result.channels["/wrench"].compared == STEPS


@pytest.mark.parametrize("topic", ["wrench", "tool_pose"])
def test_bytes_that_are_no_message_are_refused_alike(tmp_path, topic):
    result = recompute(made.write(tmp_path / "r", disturbed(topic, b"\0\1\0\0" + bytes(10))))
    assert result.verdict == "identical" and result.channels[f"/{topic}"].refused == 1


def test_a_wrench_that_is_spoiled_where_it_was_recorded_is_no_refused_one(tmp_path):
    """The live robot continued with it, so the recording differs from the sent message, or lacks the message."""
    messages = made.changed(made.one_pass(), "wrench", 60, lambda _: to_bytes(REFUSED["wrench of NaN"][1]))
    assert recompute(made.write(tmp_path / "r", messages)).verdict != "identical"


# --- Deflections that are published less often than every exchange: nothing is lost by it ---


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


# --- Bytes of a message that are no field of it, but are compared ---


INDEX = 40  # of the wrench that is changed
TERMINATOR = 4 + 8 + 4 + len("workpiece")  # behind encapsulation, stamp, length and text of frame_id


def first_difference(directory, offset: int, bit: int):
    """Where one bit of a wrench is flipped; the wrench itself is the first difference, and the only one."""
    messages = made.changed(made.one_pass(), "wrench", INDEX, made.flip(offset, bit))
    result = recompute(made.write(directory, messages))
    assert result.verdict == "different" and result.channels["/wrench"].differing == 1
    assert (result.first.topic, result.first.index, result.first.stamp_ns) == ("/wrench", INDEX, INDEX * 500_000)
    return result.first


@pytest.mark.parametrize("bit", [0, 1, 7])
@pytest.mark.parametrize("offset", [2, 3])
def test_a_flipped_bit_in_the_options_of_the_encapsulation_is_named(tmp_path, offset, bit):
    first = first_difference(tmp_path / "r", offset, bit)
    assert first.field == "options of the encapsulation" and first.recomputed == b"\0\0"
    assert first.recorded == made.flip(offset - 2, bit)(b"\0\0")


@pytest.mark.parametrize("bit", [0, 1, 7])
def test_a_frame_whose_terminator_is_not_nul_is_named(tmp_path, bit):
    first = first_difference(tmp_path / "r", TERMINATOR, bit)
    assert first.field == "the message" and "string terminator" in first.recorded
