"""Recomputing recordings: of a plain exchange and of changed ones."""

from __future__ import annotations

import contextlib
import struct

import numpy as np
import pass_recording as made
import pytest
from budget import budget
from pass_recording import STEPS, flip, force_offset, one_pass, recomputed, without

from kr270_milling.base.errors import MillingError, RecordingError
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
    messages = made.changed(one_pass(), topic, index, flip(offset, bit))
    assert messages != list(one_pass())
    replayed = recomputed(tmp_path / "r", messages)
    if field is None:
        assert replayed.verdict == "identical"
        return
    first = replayed.first
    assert (replayed.verdict, first.topic, first.index) == ("different", f"/{topic}", index)
    assert first.field.startswith(field) and replayed.channels[f"/{topic}"].differing == 1
    if topic == "deflection":  # it feeds nothing
        assert sum(channel.differing for channel in replayed.channels.values()) == 1
    if field == "wrench.force.y":
        wrenches = ([m.data for m in run if m.topic == topic] for run in (one_pass(), messages))
        before, after = (struct.unpack_from("<d", run[index], offset)[0] for run in wrenches)
        assert (first.stamp_ns, first.recorded, first.recomputed) == (index * 500_000, after, before)


def other_map() -> list[made.Message]:
    return [m for m in made.changed(one_pass(), "workpiece", 0, flip(-2000)) if m.topic == "workpiece"]


def fresh_map() -> list[made.Message]:
    """What the cut publishes when it is configured, before every pass."""
    return made.messages(CutProtocol(made.cell_of()).configure())


def invented() -> list[made.Message]:
    """Outputs after the end of the pass."""
    last = [m for m in one_pass() if m.topic == "deflection"][-1]
    return [made.later(last, last.stamp + i * 500_000) for i in range(1, 400)]


def joint_states_up_to(count: int) -> list[made.Message]:
    states = [m for m in one_pass() if m.topic == "joint_states"]
    return [m for m in one_pass() if m not in states[count:]]


def two_passes_without(number: int) -> list[made.Message]:
    """The deflections of one pass end in its middle."""
    both, end = one_pass(passes=2), STEPS * 500_000 * number + 30_000_000
    second = [i for i, m in enumerate(both) if m.topic == "reference_trajectory"][1]
    late = [i for i, m in enumerate(both) if m.topic == "deflection" and m.stamp > end and (i > second) == number]
    return [message for i, message in enumerate(both) if i not in late]


def retried() -> list[made.Message]:
    """A repeated pose and its repeated answer."""
    messages = list(one_pass())
    at = [i for i, m in enumerate(messages) if m.stamp == 10_000_000 and m.topic in ("tool_pose", "wrench")]
    messages[at[0] + 1 : at[0] + 1] = [messages[i] for i in at]
    return messages


def late(index: int) -> list[made.Message]:
    """A recorder that received a latched message after the start of the pass."""
    messages = list(one_pass())
    messages.insert(30, messages.pop(index))
    return messages


WHOLE = dict.fromkeys(("/tool_pose", "/wrench", "/deflection", "/joint_states"), STEPS) | {
    "/workpiece": 1, "/compensator_state": 2, "/reference_trajectory": 2}  # fmt: skip
RECEIVED = "the compensator received 121 poses and 121 wrenches"
CASES = {  # messages, counts of channels (empty: all are 0), stops: without them the verdict is "identical"
    "the whole pass": (one_pass, {"compared": WHOLE, "waiting": {}, "missing": {}, "given": {}}, ()),
    "a map that is latched from the pass before": (lambda: [*other_map(), *fresh_map(), *one_pass()],
                                               {"given": {"/workpiece": 1}, "compared": WHOLE | {"/workpiece": 2}}, ()),
    "no wrench": (lambda: without("wrench", 40), {"compared": {"/deflection": 40}},
                  ("at 0.020000 s: the wrench of this time", RECEIVED)),
    "no pose": (lambda: without("tool_pose", 40), {"compared": {"/wrench": 40}},
                ("at 0.020000 s: the tool pose of this time", RECEIVED)),
    "no deflection": (lambda: without("deflection", 40),
                      {"missing": {"/deflection": 1}, "compared": {"/deflection": STEPS - 1}}, ()),
    "invented outputs": (lambda: [*one_pass(), *invented()], {"waiting": {"/deflection": 399}},
                         ("/: 399 messages on /deflection from 0.060500 s on were not compared",)),
    **{f"{n} joint states": (lambda n=n: joint_states_up_to(n), {"missing": {"/joint_states": STEPS - n}},
                             (f"/: {STEPS - n} messages that belong on /joint_states are ",)) for n in (4, 1)},
    "two passes": (lambda: one_pass(passes=2), {"missing": {}}, ()),
    **{f"pass {n} ends early": (lambda n=n: two_passes_without(n), {"missing": {"/deflection": 60}},
                                (" messages that belong on /deflection",)) for n in (0, 1)},
    "no exchange": (lambda: one_pass()[: made.LATCHED_FIRST], {"compared": {f"/{name}": 1 for name in LATCHED}},
                    ("no pass is in the recording",)),
    "started before the recording": (lambda: [m for m in one_pass() if m.stamp > 5_000_000 or m.topic in LATCHED], {},
                     ("middle of a pass", "middle of a pass", "a pass that was not recorded")),
    "retried": (retried, {"repeated": {"/tool_pose": 1}, "compared": WHOLE | {"/wrench": STEPS + 1}}, ()),
    **{f"latched message {n} is late": (lambda n=n: late(n), {}, ()) for n in range(made.LATCHED_FIRST)},
    **{f"a stop after {n} messages": (lambda n=n: one_pass()[:n], {}, ()) for n in range(200, 206)},
    **{f"a stop after {n} messages and a start": (
        lambda n=n: [*one_pass()[:n], *one_pass()[made.LATCHED_FIRST :]], {}, ()) for n in range(200, 206)},
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_is_missing_in_a_recording_or_too_much_is_counted_and_nothing_else(tmp_path, case):
    messages, counts, sentences = CASES[case]
    replayed = recomputed(tmp_path / "r", messages())
    assert replayed.verdict == ("incomplete" if sentences else "identical"), (replayed.first, replayed.stops)
    for stop, sentence in zip(replayed.stops, sentences, strict=True):
        assert sentence in str(stop)
    for name, expected in counts.items():
        counted = {topic: n for topic, c in replayed.channels.items() if (n := getattr(c, name))}
        assert {topic: n for topic, n in counted.items() if topic in (expected or counted)} == expected, name
    assert not replayed.cut_off


def described(text: str) -> list:
    ((_, record),) = RobotProtocol(made.cell_of()).describe()
    return [made.Message("robot_description", to_bytes(Text(text) if text else record), 0)]


def test_a_changed_description_is_detected_but_not_in_a_recording_of_another_version(tmp_path, monkeypatch):
    """What the arm looks like in a viewer changes from version to version; it is no result."""
    same = recomputed(tmp_path / "same", [*described(""), *one_pass()])
    assert same.verdict == "identical" and same.channels["/robot_description"].compared == 1
    first = recomputed(tmp_path / "other", [*described("x" * 100), *one_pass()]).first
    assert first.topic == "/robot_description" and len(str(first)) < 300
    monkeypatch.setattr("kr270_milling.exchange.replay.robots.__version__", "99")
    replayed = recompute(tmp_path / "other")
    assert replayed.verdict == "identical" and replayed.channels["/robot_description"].given == 1


@pytest.mark.parametrize("index", [0, 1], ids=["of the fresh part", "of the finished part"])
def test_a_map_of_another_time_is_not_taken_for_granted(tmp_path, index):
    whole = [*fresh_map(), *one_pass()]
    for byte in (4, 8):  # seconds and nanoseconds of the stamp
        replayed = recomputed(tmp_path / str(byte), made.changed(whole, "workpiece", index, flip(byte, 5)))
        assert replayed.verdict in ("incomplete", "different")
        assert "/workpiece" in str(replayed.first or replayed.stops[0])


@pytest.mark.parametrize("version", ["0.1.0", "1.3.0", __version__.rpartition(".")[0] + ".99"])
def test_a_recording_of_another_version_is_left_to_that_version(tmp_path, monkeypatch, version, capsys):
    monkeypatch.setattr("kr270_milling.recordings.bag.writer.__version__", version)
    bag = made.write(tmp_path / "r", one_pass())
    if version.endswith(".99"):  # another patch of this version
        assert recompute(bag).verdict == "identical"
        return
    assert main(["replay", str(bag), "--recompute"]) == 2
    assert f"recorded by {version}; recompute it with that version" in capsys.readouterr().err
    assert pass_from_recording(bag).complete


def test_a_file_that_is_cut_off_is_compared_up_to_its_end_and_one_that_is_damaged_or_empty_is_refused(tmp_path):
    file = made.write(tmp_path / "r", one_pass()) / "r.mcap"
    data = file.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 4])
    replayed = recompute(tmp_path / "cut.mcap")
    assert replayed.cut_off and replayed.verdict == "identical"
    assert 0 < replayed.channels["/wrench"].compared < STEPS
    with Recording(file) as recording:
        chunk = recording.chunks[0]
    file.write_bytes(flip((chunk.offset + chunk.end) // 2)(data))
    for job in (recompute, compensate_recording):
        with pytest.raises(RecordingError, match="a chunk .*; recover may save the rest"):
            job(file)
    with pytest.raises(RecordingError, match="holds no tool_pose"):
        recomputed(tmp_path / "empty", [])


def test_iterations_and_two_namespaces_are_recomputed_side_by_side(tmp_path):
    messages = one_pass("linear", 2)
    replayed = recomputed(tmp_path / "iterated", messages, cell=made.cell_text("linear", 2))
    assert replayed.verdict == "identical"
    assert replayed.channels["/wrench"].compared == 1 + 2 * (STEPS - 1)
    assert replayed.channels["/deflection"].compared == STEPS
    replayed = recomputed(tmp_path / "two", one_pass(), namespaces=("/left", "/cell/right"))
    assert replayed.verdict == "identical"
    assert {t.rpartition("/")[0] for t in replayed.channels} == {"/left", "/cell/right"}
    assert replayed.channels["/cell/right/wrench"].compared == STEPS


@pytest.mark.parametrize("seed", range(budget(60)))
def test_messages_with_any_content_end_in_a_verdict_or_a_sentence(tmp_path, seed):
    random = np.random.default_rng(seed)
    messages = list(one_pass()[:60]) + [m for m in one_pass()[60:] if m.topic in LATCHED]
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
    "reference in another frame": (LATCHED[1], Trajectory([0, 10], [ONE, 2 * ONE], DOWN, frame="base_link")),
}


@pytest.mark.parametrize(("topic", "sample"), REFUSED.values(), ids=REFUSED)
def test_one_message_that_the_live_nodes_refused_does_not_spoil_a_recording(tmp_path, topic, sample):
    messages = list(one_pass())
    at = next(i for i, m in enumerate(messages) if m.topic == "tool_pose" and m.stamp == AT)
    data = b"\0\1\0\0" + bytes(10) if sample is None else to_bytes(sample)
    result = recomputed(tmp_path / "r", [*messages[:at], made.Message(topic, data, AT), *messages[at:]])
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels[f"/{topic}"].refused == 1
    assert result.channels["/wrench"].compared == result.channels["/deflection"].compared == STEPS
    assert compensate_recording(tmp_path / "r")[0].published is True


def test_a_wrench_that_is_spoiled_where_it_was_recorded_is_no_refused_one(tmp_path):
    """The live robot continued with it, so the recording differs from the sent message, or lacks the message."""
    messages = made.changed(one_pass(), "wrench", 60, lambda _: to_bytes(REFUSED["wrench of NaN"][1]))
    assert recomputed(tmp_path / "r", messages).verdict != "identical"


# --- Deflections that are published less often than every exchange: nothing is lost by it ---


@pytest.mark.parametrize("every, count", [(0, 7), (40, 4)])
def test_a_thinned_recording_recomputes_and_gives_all_deflections_to_the_bit(tmp_path, every, count):
    replayed = recomputed(tmp_path / "r", one_pass(every=every), cell=made.cell_text(every=every))
    assert replayed.verdict == "identical", (replayed.first, replayed.stops)
    channel = replayed.channels["/deflection"]
    assert (channel.compared, channel.missing) == (count, 0)
    recorded, plain = pass_from_recording(tmp_path / "r"), simulate(made.cell_of(every=every))
    assert recorded.complete and recorded.messages_lost == recorded.lost_to_end == 0
    np.testing.assert_array_equal(recorded.scored.result.deflection, plain.result.deflection)
    assert recorded.scored.scores == plain.scores


def test_a_recording_of_all_messages_of_a_cell_that_thins_them(tmp_path):
    """Deflections are compared in full, as recordings of before ``publish.every`` have them; joint states must be thin.

    The last bit of a joint state may depend on how often it is computed: ``RobotFeed``.
    """
    messages, cell = one_pass(every=1), made.cell_text(every=0)
    replayed = recomputed(tmp_path / "r", messages, cell=cell)
    assert (replayed.first.topic, replayed.first.index, replayed.first.stamp_ns) == ("/joint_states", 1, 500_000)
    assert {topic for topic, channel in replayed.channels.items() if channel.differing} == {"/joint_states"}
    replayed = recomputed(tmp_path / "old", [m for m in messages if m.topic != "joint_states"], cell=cell)
    assert replayed.verdict == "identical" and replayed.channels["/deflection"].compared == STEPS


def test_a_thinned_deflection_that_is_lost_or_changed_is_reported(tmp_path):
    thinned, cell = one_pass(every=0), made.cell_text(every=0)
    lost = recomputed(tmp_path / "lost", without("deflection", 3, thinned), cell=cell)
    assert lost.channels["/deflection"].missing == 1 and not pass_from_recording(tmp_path / "lost").complete
    messages = made.changed(thinned, "deflection", 3, flip(force_offset(1)))
    first = recomputed(tmp_path / "changed", messages, cell=cell).first
    assert (first.topic, first.index, first.stamp_ns) == ("/deflection", 3, 30_000_000)
    recorded = pass_from_recording(tmp_path / "changed").scored.result  # of another robot, then: only what it said
    assert recorded.time_ns.tolist()[-3:] == [40_000_000, 50_000_000, 60_000_000]
