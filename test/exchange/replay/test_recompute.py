"""Recomputing recordings: of a plain exchange, of changed ones, and of what the compensator revised."""

import contextlib
import dataclasses
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from budget import budget
from samples import pass_recording as made
from samples.pass_recording import STEPS, files_of, flip, force_offset, one_pass, recomputed, without

from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.base.version import __version__
from kr270_milling.cell.cell_file import cell_text, read_cell
from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.cell.models import path_of
from kr270_milling.cell.plant import Plant
from kr270_milling.cli import main
from kr270_milling.exchange.cut import CutProtocol
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.exchange.replay.revisions import compensate_recording
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.messages.codec import from_bytes, to_bytes

pytestmark = made.needs_messages
LATCHED = ("compensator_state", "reference_trajectory")
TEXT_END = 4 + 8 + 4 + len("workpiece")  # of frame_id: after encapsulation, stamp and length


@pytest.mark.parametrize(("topic", "index", "offset", "bit", "field"), [
    ("wrench", 60, force_offset(1), 0, "wrench.force.y"),
    ("deflection", 33, force_offset(2), 0, "twist.linear.z"),
    ("workpiece", 0, -2000, 0, "data["),
    ("reference_trajectory", 1, -101, 0, "quaternion["),
    ("tool_pose", 50, force_offset(1), 1, "pose.position.y"),
    ("joint_states", 3, -16, 0, "position[5]"),
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
    if topic in ("deflection", "joint_states"):  # they feed nothing
        assert sum(channel.differing for channel in replayed.channels.values()) == 1
    if field == "wrench.force.y":
        wrenches = ([m.data for m in run if m.topic == topic] for run in (one_pass(), messages))
        before, after = (struct.unpack_from("<d", run[index], offset)[0] for run in wrenches)
        assert (first.stamp_ns, first.recorded, first.recomputed) == (index * 500_000, after, before)


def earlier_maps() -> list[made.Message]:
    """The map of another part, and that which the cut publishes when it is configured, before every pass."""
    other = made.changed(one_pass(), "workpiece", 0, flip(-2000))
    return [m for m in other if m.topic == "workpiece"] + made.messages(CutProtocol(made.cell_of()).configure())


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


def early_map() -> list[made.Message]:
    """A recorder that was busy and took the last map before most of the poses."""
    return late([m.topic for m in one_pass()].index("workpiece"))


WHOLE = dict.fromkeys(("/tool_pose", "/wrench", "/deflection", "/joint_states"), STEPS) | {
    "/workpiece": 1, "/compensator_state": 2, "/reference_trajectory": 2}  # fmt: skip
RECEIVED = "the compensator received 121 poses and 121 wrenches"
CASES = {  # messages, counts of channels (empty: all are 0), stops: without them the verdict is "identical"
    "the whole pass": (one_pass, {"compared": WHOLE, "not_compared": {}, "missing": {}}, ()),
    "a map that is latched from the pass before": (lambda: [*earlier_maps(), *one_pass()],
                                               {"not_compared": {"/workpiece": 2}, "compared": WHOLE}, ()),
    "a map before its pose": (early_map, {"compared": WHOLE, "not_compared": {}}, ()),
    "no wrench": (lambda: without("wrench", 40), {"compared": {"/deflection": 40}},
                  ("at 0.020000 s: the wrench of this time", RECEIVED)),
    "no pose": (lambda: without("tool_pose", 40), {"compared": {"/wrench": 40}},
                ("at 0.020000 s: the tool pose of this time", RECEIVED)),
    "no deflection": (lambda: without("deflection", 40),
                      {"missing": {"/deflection": 1}, "compared": {"/deflection": STEPS - 1}}, ()),
    "invented outputs": (lambda: [*one_pass(), *invented()], {"not_compared": {"/deflection": 399}},
                         ("/: 399 messages on /deflection were not compared",)),
    **{f"{n} joint states": (lambda n=n: joint_states_up_to(n), {"missing": {"/joint_states": STEPS - n}},
                             (f"/: {STEPS - n} messages that belong on /joint_states are ",)) for n in (4, 1)},
    "two passes": (lambda: one_pass(passes=2), {"missing": {}}, ()),
    **{f"pass {n} ends early": (lambda n=n: two_passes_without(n), {"missing": {"/deflection": 60}},
                                (" messages that belong on /deflection",)) for n in (0, 1)},
    "no exchange": (lambda: one_pass()[: made.LATCHED_FIRST], {"compared": {f"/{name}": 1 for name in LATCHED}},
                    ("no pass is in the recording",)),
    "started before the recording": (lambda: [m for m in one_pass() if m.stamp > 5_000_000 or m.topic in LATCHED], {},
                     ("middle of a pass", "a pass that was not recorded")),
    "retried": (retried, {"compared": WHOLE}, ()),
    **{f"latched message {n} is late": (lambda n=n: late(n), {}, ()) for n in range(made.LATCHED_FIRST)},
    **{f"a stop after {n} messages": (lambda n=n: one_pass()[:n], {}, ()) for n in range(200, 206)},
    "two passes with one start": (
        lambda: [*one_pass()[:200], *one_pass()[made.LATCHED_FIRST :]], {},
        ("2 passes have one start", "messages on /deflection", "a pass that was not recorded")),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_is_missing_in_a_recording_or_too_much_is_counted_and_nothing_else(tmp_path, case):
    messages, counts, sentences = CASES[case]
    replayed = recomputed(tmp_path / "r", messages())
    assert replayed.verdict == ("incomplete" if sentences else "identical"), (replayed.first, replayed.stops)
    for stop, sentence in zip(replayed.sentences, sentences, strict=True):
        assert sentence in stop
    for name, expected in counts.items():
        counted = {topic: n for topic, c in replayed.channels.items() if (n := getattr(c, name))}
        assert {topic: n for topic, n in counted.items() if topic in (expected or counted)} == expected, name
    assert not replayed.cut_off


@pytest.mark.parametrize("version", ["0.1.0", "1.3.0", __version__.rpartition(".")[0] + ".99"])
def test_a_recording_of_another_version_is_left_to_that_version(tmp_path, monkeypatch, version, capsys):
    monkeypatch.setattr("kr270_milling.recordings.bag.writer.__version__", version)
    bag = made.write(tmp_path / "r", one_pass())
    if version.endswith(".99"):  # another patch of this version
        assert recompute(bag).verdict == "identical"
        return
    assert main(["replay", str(bag), "--recompute"]) == 2
    assert f"recorded by {version}; recompute it with that version" in capsys.readouterr().err
    assert pass_from_recording(bag)[1].complete


def test_a_file_that_is_cut_off_is_compared_up_to_its_end_and_one_that_is_damaged_or_empty_is_refused(tmp_path):
    file = made.write(tmp_path / "r", one_pass()) / "r.mcap"
    data = file.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 4])
    replayed = recompute(tmp_path / "cut.mcap")
    assert replayed.cut_off and replayed.verdict == "identical"
    assert 0 < replayed.channels["/wrench"].compared < STEPS
    file.write_bytes(flip(data.index(b"zstd") + 1000)(data))  # in the first chunk
    for job in (recompute, compensate_recording):
        with pytest.raises(RecordingError, match="a chunk .*; recover may save the rest"):
            job(file)
    with pytest.raises(RecordingError, match="holds no tool_pose"):
        recomputed(tmp_path / "empty", [])


def test_iterations_and_two_namespaces_are_recomputed_side_by_side(tmp_path):
    messages = one_pass("linear", 2)
    replayed = recomputed(tmp_path / "iterated", messages, cell=made.cell_text("linear", 2))
    assert replayed.verdict == "identical"
    assert {replayed.channels[f"/{name}"].compared for name in ("tool_pose", "wrench", "deflection")} == {STEPS}
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
    assert result.channels["/wrench"].compared == result.channels["/deflection"].compared == STEPS
    assert compensate_recording(tmp_path / "r")[0][2] is True


@pytest.mark.parametrize("topic", ["deflection", "joint_states", "workpiece", "compensator_state", LATCHED[1]])
@pytest.mark.parametrize("way", ["of another type", "short"])
def test_a_message_of_the_nodes_that_cannot_be_read_is_no_identical_one(tmp_path, topic, way):
    messages = list(one_pass())
    at = [i for i, m in enumerate(messages) if m.topic == topic][-1]
    data = to_bytes(PoseSample(AT, "workpiece", ONE, DOWN)) if way == "of another type" else messages[at].data[:20]
    messages[at] = made.Message(topic, data, messages[at].stamp)
    result = recomputed(tmp_path / "r", messages)
    assert result.verdict == "incomplete" and result.channels[f"/{topic}"].not_compared == 1, result.channels
    assert f"/: 1 messages on /{topic} could not be read" in result.sentences


@pytest.mark.parametrize("change", [{"names": ("j1", "j2", "j3", "j4", "j5", "j6")}, {"position": np.full(6, np.nan)}])
def test_joint_states_of_other_names_or_of_no_numbers_make_a_recompute_incomplete(tmp_path, change):
    messages = list(one_pass())
    at = [i for i, m in enumerate(messages) if m.topic == "joint_states"][7]
    state = from_bytes("sensor_msgs/msg/JointState", messages[at].data)
    messages[at] = made.Message("joint_states", to_bytes(dataclasses.replace(state, **change)), messages[at].stamp)
    result = recomputed(tmp_path / "r", messages)
    assert result.verdict == "incomplete" and result.channels["/joint_states"].not_compared == 1, result.channels


# --- Deflections that are published less often than every exchange: nothing is lost by it ---


@pytest.mark.parametrize("every, count", [(0, 7), (40, 4)])
def test_a_thinned_recording_recomputes_and_gives_all_deflections_to_the_bit(tmp_path, every, count):
    replayed = recomputed(tmp_path / "r", one_pass(every=every), cell=made.cell_text(every=every))
    assert replayed.verdict == "identical", (replayed.first, replayed.stops)
    channel = replayed.channels["/deflection"]
    assert (channel.compared, channel.missing) == (count, 0)
    (ran, recorded), plain = pass_from_recording(tmp_path / "r"), simulate(made.cell_of(every=every))
    assert recorded.complete and recorded.messages_lost == recorded.lost_to_end == 0
    np.testing.assert_array_equal(ran.result.deflection, plain.result.deflection)
    np.testing.assert_equal(dataclasses.asdict(ran.scores), dataclasses.asdict(plain.scores))  # also where both are NaN


def test_a_thinned_deflection_that_is_lost_or_changed_is_reported(tmp_path):
    thinned, cell = one_pass(every=0), made.cell_text(every=0)
    lost = recomputed(tmp_path / "lost", without("deflection", 3, thinned), cell=cell)
    assert lost.channels["/deflection"].missing == 1 and not pass_from_recording(tmp_path / "lost")[1].complete
    messages = made.changed(thinned, "deflection", 3, flip(force_offset(1)))
    first = recomputed(tmp_path / "changed", messages, cell=cell).first
    assert (first.topic, first.index, first.stamp_ns) == ("/deflection", 3, 30_000_000)
    recorded = pass_from_recording(tmp_path / "changed")[0].result  # of another robot, then: only what it said
    assert recorded.time_ns.tolist()[-3:] == [40_000_000, 50_000_000, 60_000_000]


# --- The compensator's part: what it revised, once more from the passes that its state names ---


BODY = 12  # offset behind the stamp of a reference, which is the start of the next pass
NAMES = ("c", "a", "b")  # in another order than that of the alphabet


def folder_of(directory, method: str = "learned"):
    """One recording a pass, as ``run`` makes them."""
    for name, messages in zip(NAMES, files_of(method, NAMES), strict=True):
        made.write(directory / name, messages, cell=made.cell_text(method))
    return directory


def with_state(messages, index: int, learned=None, **changes) -> list:
    """The messages with other fields in one state of the compensator; learned: fields of its passes."""

    def change(data: bytes) -> bytes:
        state = from_bytes(made.STATE, data)
        passes = tuple(one._replace(**(learned or {})) for one in state.learned)
        return to_bytes(dataclasses.replace(state, learned=passes, **changes))

    return made.changed(messages, "compensator_state", index, change)


def test_several_passes_in_one_file_are_distinguished(tmp_path):
    result = recomputed(tmp_path / "r", one_pass("learned", 1, 3), cell=made.cell_text("learned"))
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels["/wrench"].compared == 3 * STEPS
    assert result.channels["/reference_trajectory"].compared == result.channels["/compensator_state"].compared == 4


@pytest.mark.parametrize("method", ["linear", "mirror", "learned"])
def test_a_pass_of_a_folder_is_recomputed_alone_and_its_revision_where_no_earlier_pass_matters(tmp_path, method):
    """The history of a method that learns is in other recordings; robot and cut are still compared."""
    folder_of(tmp_path, method)
    for number, name in enumerate(NAMES):
        result = recompute(tmp_path / name)
        assert result.verdict == "identical", (result.first, result.stops)
        assert result.channels["/wrench"].compared == STEPS
        alone = method == "learned" and number > 0
        assert result.channels["/reference_trajectory"].not_compared == (2 if alone else int(number > 0))
        if alone:
            with pytest.raises(RecordingError, match="passes in other recordings"):
                compensate_recording(tmp_path / name)
        else:
            assert [same for _, _, same in compensate_recording(tmp_path / name)] == [True]


def test_a_state_after_a_pass_that_cannot_be_used_is_not_compared(tmp_path):
    """Two deflections have the stamp of the start; the first pass is in another recording."""
    messages = [m for m in files_of("linear", NAMES)[1] for _ in range(1 + (m.topic == "deflection"))]
    result = recompute(made.write(tmp_path / "r", messages, cell=made.cell_text("linear")))
    reasons = [stop["reason"] for stop in result.stops]
    assert result.verdict == "incomplete" and any("2 passes have one start" in reason for reason in reasons)
    assert "the reference trajectory follows from a pass that was not recorded" in reasons


def test_a_method_that_is_chosen_between_two_passes_starts_from_the_named_pass(tmp_path):
    """As ``run`` does: the reference of ``spline`` follows from the original pass, not from that of ``linear``."""
    compensator, files = made.CompensatorProtocol(made.cell_of()), {}
    latched = made.messages(compensator.begin(path_of(made.cell_of()).target))
    for name, method in (("original", None), ("linear", "linear"), ("spline", "spline")):
        if method is not None:
            latched = made.messages(compensator.choose(method))
        files[name] = [*latched, *made.pass_along(compensator, f"{name}/{name}.mcap")]
        made.write(tmp_path / name, files[name])
    state = next(m.data for m in files["spline"] if m.topic == "compensator_state")
    assert [one.recording for one in from_bytes(made.STATE, state).learned] == ["original/original.mcap"]
    for name in files:
        assert recompute(tmp_path / name).verdict == "identical", name
    together = [message for messages in files.values() for message in messages]  # one recorder, one file
    result = recompute(made.write(tmp_path / "all", together))
    assert result.verdict == "identical" and result.channels["/compensator_state"].compared == 6


def test_a_revision_without_the_last_wrench_is_recomputed_without_it(tmp_path):
    """The live node gave the last wrench up; the recorder has it."""
    cell, whole = made.cell_of("mirror"), list(one_pass("mirror"))
    last = max(i for i, m in enumerate(whole) if m.topic == "wrench")
    compensator = made.CompensatorProtocol(cell)
    compensator.begin(path_of(cell).target)
    compensator.recording = "r/r.mcap"
    for message in whole[:last]:
        if message.topic in ("tool_pose", "wrench"):
            sample = from_bytes(made.TYPES[message.topic], message.data)
            (compensator.pose if isinstance(sample, PoseSample) else compensator.wrench)(sample)
    revised = made.messages(compensator.finish())
    result = recompute(made.write(tmp_path / "r", [*whole[: -len(revised)], *revised], cell=made.cell_text("mirror")))
    assert result.verdict == "identical", (result.first, result.stops)
    assert result.channels["/compensator_state"].compared == 2


@pytest.mark.parametrize(("index", "changes", "verdict", "sentence"), [
    (1, {"finished": True}, "different", "finished"),
    (1, {"reference": "00000000"}, "different", "reference"),
    (1, {"learned": {"fingerprint": "00" * 32}}, "different", "learned"),
    (1, {"method": "spline"}, "different", ""),
    (1, {"learned": {"poses": STEPS - 3}}, "incomplete", f"received {STEPS - 3} poses"),  # the compensator missed some
    (0, {"target": "00000000"}, "incomplete", "the target trajectory 00000000"),
])  # fmt: skip
def test_a_state_that_the_recording_does_not_lead_to_is_a_difference_and_one_of_other_messages_is_reported(
    tmp_path, index, changes, verdict, sentence
):
    result = recomputed(tmp_path / "r", with_state(one_pass(), index, **changes))
    assert result.verdict == verdict
    if verdict == "incomplete":
        assert sentence in result.sentences[0]
    elif sentence:
        assert result.first.topic == "/compensator_state" and result.first.field.startswith(sentence)


def test_references_without_states_are_taken_as_recorded(tmp_path):
    result = recomputed(tmp_path / "r", [m for m in one_pass() if m.topic != "compensator_state"])
    assert result.verdict == "incomplete" and "without its compensator_state" in result.sentences[0]
    assert result.channels["/reference_trajectory"].not_compared == 2
    assert compensate_recording(tmp_path / "r")[0][2] is True  # the cell states the method


def foreign(method: str) -> made.Message:
    """A reference of another compensator, with other knots than the pass, which end before its end."""
    knots = np.linspace(0, 48_000_000, 7).astype(np.int64)  # [ns]
    target = path_of(made.cell_of(method)).target
    reference = Trajectory(knots, target.sample(knots), target.sample_orientation(knots))
    return made.Message("reference_trajectory", to_bytes(reference), 0)


@pytest.mark.parametrize("place", [0, 200])
def test_a_reference_of_another_compensator_is_not_called_identical(tmp_path, place):
    messages = list(one_pass("inverse"))
    messages.insert(place, foreign("inverse"))
    assert recomputed(tmp_path / "r", messages, cell=made.cell_text("inverse")).verdict != "identical"


def test_a_pass_that_a_method_cannot_revise_is_refused_with_the_reason(tmp_path):
    stateless = [m for m in files_of("learned", NAMES)[1] if m.topic != "compensator_state"]
    other = [foreign("linear"), *(m for m in one_pass() if m.topic in ("tool_pose", "wrench"))]
    for messages, cell, method, sentence in (
        (stateless, "learned", None, "learned needs the passes before this one"),
        (other, "linear", "inverse", "at the times of the target's"), (one_pass()[:100], "mirror", None, "no complete"),
    ):  # fmt: skip
        with pytest.raises(RecordingError, match=sentence):
            compensate_recording(made.write(tmp_path / cell, messages, cell=made.cell_text(cell)), method)


def test_a_recording_is_revised_by_its_own_or_by_another_method(tmp_path):
    directory = made.write(tmp_path / "r", one_pass("linear"))
    for method, published in (("linear", True), ("spline", None)):
        ((_, revised, same),) = compensate_recording(directory, method)
        _, expected = (m.data for m in one_pass(method) if m.topic == "reference_trajectory")
        assert same is published and revised.method == method
        assert to_bytes(revised.reference)[BODY:] == expected[BODY:]


# --- Recordings of passes in which another cell cut than the one that planned: both are attached, all is recomputed ---


PASSES = ("original", "learned_1", "learned_2")


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    """A softer arm with backlash, no friction and scatter, and a tracker with noise."""
    cell = made.cell_of("learned")
    arm = cell.arm.replace(joint_compliance=1.1 * cell.arm.joint_compliance, friction_torque=np.zeros(6))
    imperfections = cell.imperfections.replace(pose_noise=2e-6, repeatability=60e-6, backlash=np.full(6, 1e-5), seed=3)
    file = tmp_path_factory.mktemp("cell") / "plant.yaml"
    file.write_text(cell_text(Plant(cell, cell.replace(arm=arm), imperfections).cell))
    return read_cell(file)


def test_the_passes_are_those_of_the_plain_loop_and_identical_when_recomputed_with_their_random_numbers(
    plant, tmp_path
):
    """One recording a pass, as ``run --plant`` makes them."""
    cell = made.cell_of("learned")
    runs, by = Plant(cell, plant), compensator(cell, path_of(cell).target, "learned")
    for number, (name, messages) in enumerate(zip(PASSES, files_of("learned", PASSES, plant), strict=True)):
        of_pass = plant.replace(imperfections=plant.imperfections.replace(first_pass=number))
        attached = {"cell.yaml": made.cell_text("learned"), "plant.yaml": cell_text(of_pass)}
        replayed = recomputed(tmp_path / name, messages, attachments=attached)
        assert replayed.verdict == "identical", (replayed.first, replayed.stops)
        assert replayed.channels["/tool_pose"].compared == made.STEPS
        assert replayed.channels["/reference_trajectory"].compared == (0 if number else 2)  # its history is elsewhere
        ran = simulate(cell, by.reference, name, plant=runs)
        recorded = pass_from_recording(tmp_path / name)[0]
        assert np.array_equal(recorded.result.tool, ran.result.tool)
        assert np.array_equal(recorded.result.deflection, ran.result.deflection)
        np.testing.assert_equal(dataclasses.asdict(recorded.scores), dataclasses.asdict(ran.scores))
        by.revise(record_of(cell, ran))
    other = {"cell.yaml": made.cell_text("learned"), "plant.yaml": cell_text(plant)}
    later = plant.replace(imperfections=plant.imperfections.replace(first_pass=1))
    (messages,) = files_of("learned", ("r",), later)
    assert recomputed(tmp_path / "r", messages, attachments=other).verdict == "different"


def test_a_run_attaches_the_plant_with_the_number_of_the_pass(plant, tmp_path):
    pytest.importorskip("rclpy")
    from kr270_milling.live.graph import Graph

    (tmp_path / "log").mkdir()
    given, graph = {}, Graph(made.cell_of("learned"), tmp_path, plant=plant)
    graph.driver = SimpleNamespace(
        set_parameters=lambda _, values, __: given.update(values), transition=lambda *_, **__: 0
    )
    graph.passes = 2
    graph.begin_recording("learned_2")
    assert given["attach"] == [str(tmp_path / "cell.yaml"), str(tmp_path / "log" / "learned_2" / "plant.yaml")]
    assert list(given)[-1] == "directory"  # it starts the recording
    assert read_cell(given["attach"][1]).imperfections.first_pass == 2
