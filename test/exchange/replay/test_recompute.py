"""Recomputing recordings: of a plain exchange and of changed ones."""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path

import numpy as np
import pass_recording as made
import pytest
from budget import budget
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
from kr270_milling.path.trajectory import Trajectory
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


TEXT_END = 4 + 8 + 4 + len("workpiece")  # of frame_id: after encapsulation, stamp and length


@pytest.mark.parametrize(("topic", "index", "offset", "bit", "field"), [
    ("wrench", 60, force_offset(1), 0, "wrench.force.y"),
    ("deflection", 33, force_offset(2), 0, "twist.linear.z"),
    ("workpiece", 0, -2000, 0, "data["),
    ("reference_trajectory", 1, -101, 0, "points["),
    ("wrench", 40, 2, 7, "options of the encapsulation"),
    ("wrench", 40, TEXT_END, 1, "the message"),  # a text that does not end with NUL
    ("tool_pose", 5, TEXT_END + 1, 0, None),  # bytes between the fields do not count
])  # fmt: skip
def test_one_flipped_bit_of_a_message_is_named_exactly(tmp_path, topic, index, offset, bit, field):
    messages = made.changed(made.one_pass(), topic, index, flip(offset, bit))
    assert messages != list(made.one_pass())
    replayed = recompute(made.write(tmp_path / "r", messages))
    if field is None:
        assert replayed.verdict == "identical"
        return
    first = replayed.first
    assert (replayed.verdict, first.topic, first.index) == ("different", f"/{topic}", index)
    assert first.field.startswith(field) and replayed.channels[f"/{topic}"].differing == 1
    assert topic not in ("wrench", "deflection") or first.stamp_ns == index * 500_000
    if topic == "deflection":  # it feeds nothing
        assert sum(channel.differing for channel in replayed.channels.values()) == 1
    if field == "wrench.force.y":
        before, after = ([m.data for m in run if m.topic == topic][index] for run in (made.one_pass(), messages))
        assert struct.pack("<d", first.recorded) == after[offset : offset + 8]
        assert struct.pack("<d", first.recomputed) == before[offset : offset + 8]


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
def test_a_map_of_another_time_is_not_taken_for_granted(tmp_path, index):
    whole = [*fresh_map(), *made.one_pass()]
    for byte in (4, 8):  # seconds and nanoseconds of the stamp
        replayed = recompute(made.write(tmp_path / str(byte), made.changed(whole, "workpiece", index, flip(byte, 5))))
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
    channel = replayed.channels["/deflection"]
    assert (replayed.verdict, channel.missing, channel.compared) == ("identical", 1, STEPS - 1)


def test_invented_outputs_after_the_end_are_not_called_identical(tmp_path):
    last = [m for m in made.one_pass() if m.topic == "deflection"][-1]
    invented = [made.later(last, last.stamp + i * 500_000) for i in range(1, 400)]
    replayed = recompute(made.write(tmp_path / "r", [*made.one_pass(), *invented]))
    assert replayed.verdict == "incomplete" and replayed.channels["/deflection"].waiting == 399
    (stop,) = replayed.stops
    assert str(stop).startswith("/: 399 messages on /deflection from 0.060500 s on were not compared")


def test_outputs_that_were_cut_away_from_a_closed_file_are_missed(tmp_path):
    states = [m for m in made.one_pass() if m.topic == "joint_states"]
    for remaining in (4, 1):
        messages = [m for m in made.one_pass() if m not in states[remaining:]]
        replayed = recompute(made.write(tmp_path / str(remaining), messages))
        assert replayed.verdict == "incomplete" and replayed.first is None
        assert replayed.channels["/joint_states"].missing == len(states) - remaining
        (stop,) = replayed.stops
        assert stop.reason.startswith(f"{STEPS - remaining} messages that belong on /joint_states are ")


@pytest.mark.parametrize("number", [0, 1])
def test_outputs_of_either_pass_are_missed(tmp_path, number):
    both, begin = made.one_pass(passes=2), STEPS * 500_000 * number
    assert recompute(made.write(tmp_path / "whole", both)).verdict == "identical"
    second = [i for i, m in enumerate(both) if m.topic == "reference_trajectory"][1]
    messages = [
        message for i, message in enumerate(both)
        if not ((i > second) == number and message.topic == "deflection" and message.stamp - begin > 30_000_000)
    ]  # fmt: skip
    replayed = recompute(made.write(tmp_path / "r", messages))
    assert replayed.verdict == "incomplete" and replayed.channels["/deflection"].missing == 60


def test_a_recording_without_any_exchange_is_not_called_identical(tmp_path):
    replayed = recompute(made.write(tmp_path / "r", made.one_pass()[: made.LATCHED_FIRST]))
    assert replayed.compared == 2 and replayed.verdict == "incomplete"
    assert "no pass is in the recording" in str(replayed.stops[0])
    with pytest.raises(RecordingError, match="holds no tool_pose"):
        recompute(made.write(tmp_path / "empty", []))


@pytest.mark.parametrize("again", [False, True], ids=["stopped", "started again"])
def test_a_pass_that_ended_in_its_middle_has_lost_nothing(tmp_path, again):
    following = made.one_pass()[made.LATCHED_FIRST :] if again else ()
    for end in range(200, 206):
        replayed = recompute(made.write(tmp_path / str(end), [*made.one_pass()[:end], *following]))
        assert not replayed.cut_off and replayed.verdict == "identical", replayed.stops


@pytest.mark.parametrize("version", ["0.1.0", "1.3.0", __version__.rpartition(".")[0] + ".99"])
def test_a_recording_of_another_version_is_left_to_that_version(tmp_path, monkeypatch, version, capsys):
    monkeypatch.setattr("kr270_milling.recordings.bag.writer.__version__", version)
    bag = made.write(tmp_path / "r", made.one_pass())
    if version.endswith(".99"):  # another patch of this version
        assert recompute(bag).verdict == "identical"
        return
    assert main(["replay", str(bag), "--recompute"]) == 2
    assert f"recorded by {version}; recompute it with that version" in capsys.readouterr().err
    assert pass_from_recording(bag).complete


def test_a_flipped_bit_in_the_first_chunk_is_one_sentence(tmp_path):
    file = made.write(tmp_path / "r", made.one_pass()) / "r.mcap"
    with Recording(file) as recording:
        chunk = recording.chunks[0]
    file.write_bytes(flip((chunk.offset + chunk.end) // 2)(file.read_bytes()))
    for job in (recompute, compensate_recording):
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


def test_messages_of_other_topics_may_come_before_their_causes(tmp_path):
    for index in range(made.LATCHED_FIRST):
        messages = list(made.one_pass())
        late = messages.pop(index)  # a recorder that received a latched message after the start of the pass
        messages.insert(30, late)
        assert recompute(made.write(tmp_path / str(index), messages)).verdict == "identical"


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


@pytest.mark.parametrize("seed", range(budget(60)))
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
    "no wrench": ("wrench", None),
    "no pose": ("tool_pose", None),
    "reference in another frame": (
        "reference_trajectory",
        Trajectory([0, 10], [ONE, 2 * ONE], DOWN, frame="base_link"),
    ),
}


@pytest.mark.parametrize(("topic", "sample"), REFUSED.values(), ids=REFUSED)
def test_one_message_that_the_live_nodes_refused_does_not_spoil_a_recording(tmp_path, topic, sample):
    messages = list(made.one_pass())
    at = next(i for i, m in enumerate(messages) if m.topic == "tool_pose" and m.stamp == AT)
    data = b"\0\1\0\0" + bytes(10) if sample is None else to_bytes(sample)
    directory = made.write(tmp_path / "r", [*messages[:at], made.Message(topic, data, AT), *messages[at:]])
    result = recompute(directory)
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels[f"/{topic}"].refused == 1
    assert result.channels["/wrench"].compared == result.channels["/deflection"].compared == STEPS
    assert compensate_recording(directory)[0].published is True


def test_a_wrench_that_is_spoiled_where_it_was_recorded_is_no_refused_one(tmp_path):
    """The live robot continued with it, so the recording differs from the sent message, or lacks the message."""
    messages = made.changed(made.one_pass(), "wrench", 60, lambda _: to_bytes(REFUSED["wrench of NaN"][1]))
    assert recompute(made.write(tmp_path / "r", messages)).verdict != "identical"


# --- Deflections that are published less often than every exchange: nothing is lost by it ---


def thinned(directory, every: int, change=lambda data: data):
    """A recording with a change of its deflection 3."""
    messages = made.changed(made.one_pass(every=every), "deflection", 3, change)
    return made.write(directory, messages, cell=made.cell_text(every=every))


@pytest.mark.parametrize("every, count", [(0, 7), (40, 4)])
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


def test_a_recording_of_all_messages_of_a_cell_that_thins_them(tmp_path):
    """Deflections are compared in full, as recordings of before ``publish.every`` have them; joint states must be thin.

    The last bit of a joint state may depend on how often it is computed: ``RobotFeed``.
    """
    messages, cell = made.one_pass(every=1), made.cell_text(every=0)
    replayed = recompute(made.write(tmp_path / "r", messages, cell=cell))
    assert (replayed.first.topic, replayed.first.index, replayed.first.stamp_ns) == ("/joint_states", 1, 500_000)
    assert {topic for topic, channel in replayed.channels.items() if channel.differing} == {"/joint_states"}
    replayed = recompute(made.write(tmp_path / "old", [m for m in messages if m.topic != "joint_states"], cell=cell))
    assert replayed.verdict == "identical" and replayed.channels["/deflection"].compared == STEPS


def test_a_thinned_deflection_that_is_lost_or_changed_is_reported(tmp_path):
    lost = thinned(tmp_path / "lost", 0, lambda data: None)
    assert recompute(lost).channels["/deflection"].missing == 1
    assert not pass_from_recording(lost).complete
    first = recompute(thinned(tmp_path / "changed", 0, flip(force_offset(1)))).first
    assert (first.topic, first.index, first.stamp_ns) == ("/deflection", 3, 30_000_000)
    recorded = pass_from_recording(tmp_path / "changed").scored.result  # of another robot, then: only what it said
    assert recorded.time_ns.tolist()[-3:] == [40_000_000, 50_000_000, 60_000_000]
