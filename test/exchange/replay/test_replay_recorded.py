"""A pass out of its recording, for scores and reports."""

import json
import time

import numpy as np
import pytest
from foreign_cell import foreign_pass
from hostile import ask
from rosbags.rosbag2 import StoragePlugin, Writer
from samples import pass_recording as made
from samples.recording_samples import STORE
from samples.small_part import SET

from kr270_milling.base.errors import ConfigError, RecordingError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.cell.cell_file import cell_text, read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import path_of
from kr270_milling.cli import main
from kr270_milling.exchange.compensator import CompensatorProtocol
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import attached_cell, pass_from_recording, passes_from_recording
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.bag.info import info
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.codec import to_bytes

pytestmark = made.needs_messages
EXCHANGE = ("tool_pose", "wrench", "deflection")


def test_what_is_stamped_behind_the_end_of_the_reference_is_no_part_of_the_pass(tmp_path):
    """A hole of 2e9 s would be some 1e14 micro-steps of the tool."""
    messages = list(made.one_pass())
    last = {m.topic: m for m in messages}
    behind = [made.later(last[topic], 2 * 10**9 * 10**9) for topic in EXCHANGE]
    plain, nothing = pass_from_recording(made.write(tmp_path / "plain", messages))  # and compile
    begin = time.process_time()
    far, result = pass_from_recording(made.write(tmp_path / "far", [*messages, *behind]))
    assert time.process_time() - begin < 5.0
    np.testing.assert_equal(far.row() | {"name": "plain"}, plain.row())  # nan equals nan
    assert result.complete
    assert result.messages_lost == nothing.messages_lost == 0


def test_a_hole_makes_a_pass_incomplete(tmp_path):
    _, result = pass_from_recording(made.write(tmp_path / "hole", made.without("wrench", 40)))
    assert result.messages_lost == result.lost_to_end == 1 and not result.complete


def test_a_reference_of_an_implausible_duration_is_refused(tmp_path):
    reference = Trajectory([0, 2 * 10**18], [[0, 0, 0], [1e-3, 0, 0]], [[1, 0, 0, 0]] * 2)
    messages = [made.Message("reference_trajectory", to_bytes(reference), 0), *made.one_pass()[made.LATCHED_FIRST :]]
    with pytest.raises(RecordingError, match="trajectory: takes 2e"):
        pass_from_recording(made.write(tmp_path / "r", messages))


# --- The cell out of a recording that may be hostile ---


FORM = "/**:\n  ros__parameters:\n"


def cell_in(directory, attached: dict[str, str]):
    """The cell of a recording with these files attached."""
    with Recording(made.write(directory, [], attachments=attached)) as recording:
        return attached_cell(recording)


@pytest.mark.parametrize(("attached", "sentence"), [
    ({}, "no parameter file attached"),
    ({"a.yaml": "", "b.yaml": ""}, "has a.yaml, b.yaml attached"),
    ({"cell.yaml": "nonsense"}, "must have the form"),
    ({"cell.yaml": made.cell_text().replace("method: linear", "method: sideways")}, "compensation.method"),
])  # fmt: skip
def test_attached_files_that_give_no_cell_are_refused_in_one_sentence(tmp_path, attached, sentence):
    with pytest.raises((RecordingError, ConfigError), match=sentence) as error:
        cell_in(tmp_path / "r", attached)
    assert "\n" not in str(error.value) and "r.mcap" in str(error.value)


def test_a_file_that_an_attached_one_names_must_be_attached_too_and_is_read_there_for_every_folder(tmp_path):
    """A recording must not make us read a file of this machine."""
    secret, teeth = tmp_path / "secret.yaml", FORM + "    tool: {teeth: 2}\n"
    secret.write_text(teeth)
    names_it = f'    includes: ["{secret}"]\n'
    hostile = [{"cell.yaml": FORM + f'    includes: ["{name}"]\n', name: FORM + names_it} for name in ("b.yaml", "b")]
    hostile += [{"cell.yaml": FORM + names_it + f"    path: {path}\n"} for path in ("[]", "null", '{file: ["a"]}')]
    hostile += [{"cell.yaml": FORM + f'    path: {{file: "{secret}"}}\n'}]
    for number, attached in enumerate(hostile):
        with pytest.raises(RecordingError, match=f"names '{secret}', which is not attached"):
            cell_in(tmp_path / str(number), attached)
    main = FORM + '    includes: ["/far/away/b.yaml"]\n'
    below = FORM + '    includes: ["paper.yaml", "/other/secret.yaml"]\n'
    attached = {"cell.yaml": main, "b.yaml": below, "secret.yaml": teeth, "n" * 3000: ""}
    assert cell_in(tmp_path / "far", attached).tool.teeth == 2
    other = find_file("paper.yaml").read_text().replace("teeth: 4", "teeth: 3")  # not the shipped file
    assert (
        cell_in(
            tmp_path / "paper", {"cell.yaml": below.replace(', "/other/secret.yaml"', ""), "paper.yaml": other}
        ).tool.teeth
        == 3
    )


GCODE_OF_FILES = {
    "part.nc": "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\nM98 P7\nG0 Z2\nM5\nM30\n",
    "subs/O7.nc": "O7\nG0 Z-.5\nM98 P8\nM99\n", "O8.nc": "G1 X12 F4000\nM99\n",
}  # fmt: skip
KRL_OF_FILES = {
    "part.src": "DEF part()\n$VEL.CP=0.06\nPTP XP1\nsub7()\nEND\n",
    "part.dat": "DEFDAT part\nDECL E6POS XP1={X -14,Y 0,Z 2}\nENDDAT\n",
    "sub7.src": "DEF sub7()\nLIN {Z -.5}\nLIN {X 12}\nLIN {Z 2}\nEND\n",
}  # fmt: skip


@pytest.mark.parametrize("files", [GCODE_OF_FILES, KRL_OF_FILES], ids=["gcode", "krl"])
def test_the_files_of_sub_programs_are_part_of_the_cell_and_of_its_recordings(tmp_path, files):
    (tmp_path / "subs").mkdir()
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    first, *further = (tmp_path / name for name in files)
    cell = read_cell(find_file("paper.yaml"), [f"path.file={first}", *SET])
    assert set(cell.path.files) == {first, *further} and cell.path.files[0] == first
    attached = {"cell.yaml": cell_text(cell)} | {path.name: path.read_text() for path in cell.path.files}
    target, marks = path_of(cell).target, {cell.path.sha256}
    for file in further:
        file.write_text(file.read_text() + "\n")
        marks.add(cell.path.sha256)
    assert len(marks) == len(files)
    for name in files:
        (tmp_path / name).unlink()
    np.testing.assert_array_equal(path_of(cell_in(tmp_path / "r", attached)).target.position, target.position)


def test_attached_files_that_name_each_other_many_times_are_refused_at_once(tmp_path):
    """6.5 kB of attachments were read some million times by replay --recompute and report."""
    files = {f"{i}.yaml": FORM + f"    includes: {json.dumps([f'{i + 1}.yaml'] * 12)}\n    k{i}: 1\n" for i in range(7)}
    files |= {"7.yaml": FORM + "    k7: 1\n", "cell.yaml": FORM + '    includes: ["0.yaml"]\n'}
    begin = time.process_time()
    with pytest.raises(ConfigError, match="64 names"):
        cell_in(tmp_path / "r", files)
    assert time.process_time() - begin < 5.0


LATE = 1_700_000_000_123_456_789  # [ns], of the wall clock


@pytest.fixture(scope="module")
def late() -> list[made.Message]:
    """Two passes in one file, by the wall clock."""
    return made.one_pass(passes=2, begin=LATE)


def test_a_pass_has_the_same_bits_whatever_its_start(tmp_path, late):
    plain = made.one_pass(passes=2)
    assert len(plain) == len(late)
    for one, other in zip(plain, late, strict=True):
        moved = made.later(one, one.stamp + LATE) if one.stamp or other.stamp else one
        assert one.topic == "compensator_state" or other.data == moved.data or one.topic == "reference_trajectory"
    figures = []
    for name, messages in (("plain", plain), ("late", late)):
        replayed = recompute(made.write(tmp_path / name, messages))
        assert replayed.verdict == "identical" and replayed.compared > 900
        passes = passes_from_recording(tmp_path / name, "r")
        assert [recorded.complete for _, recorded in passes] == [True, True]
        figures.append([ran.row() for ran, _ in passes])
    np.testing.assert_equal(*figures)
    poses = [m.stamp for m in late if m.topic == "tool_pose"]
    assert poses == sorted(set(poses)) and poses[0] == LATE  # the second pass begins after the first
    with Recording(tmp_path / "late") as recording:
        assert info(recording)["missing"] == 0


def test_a_recorder_that_starts_in_mid_pass_has_an_incomplete_pass_and_a_whole_one(tmp_path, late):
    first = next(i for i, m in enumerate(late) if m.topic == "reference_trajectory")
    bag = made.write(tmp_path / "r", [*late[: first + 2], *late[first + 200 :]])
    (broken, part), (ran, whole) = passes_from_recording(bag)
    assert (part.complete, whole.complete) == (False, True) and broken.name == "r_1"
    (_, (same, _)) = passes_from_recording(made.write(tmp_path / "whole", late))
    np.testing.assert_equal(ran.row() | {"name": ""}, same.row() | {"name": ""})


def test_a_bag_of_ros2_bag_record_is_scored_and_recomputed_with_a_cell_beside_it(tmp_path):
    """A database without attachments, whose log times are those of receipt."""
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topics = {name: writer.add_connection(f"/{name}", kind, typestore=STORE) for name, kind in made.TYPES.items()}
        for k, message in enumerate(made.one_pass(begin=LATE)):
            writer.write(topics[message.topic], LATE + k, message.data)
    (tmp_path / "cell.yaml").write_text(made.cell_text())
    with pytest.raises(RecordingError, match="give it by --cell"):
        passes_from_recording(tmp_path / "bag")
    ((ran, recorded),) = passes_from_recording(tmp_path / "bag", "bag", cell_file=tmp_path / "cell.yaml")
    assert recorded.complete
    ((plain, _),) = passes_from_recording(made.write(tmp_path / "plain", made.one_pass(begin=LATE)), "bag")
    np.testing.assert_equal(ran.row(), plain.row())
    assert recompute(tmp_path / "bag", cell_file=tmp_path / "cell.yaml").verdict == "identical"
    answer = ask("report", str(tmp_path / "bag"), "--cell", str(tmp_path / "cell.yaml"), "--out", str(tmp_path / "out"))
    assert answer.code == 0 and "report: " in answer.out


def test_a_pass_that_cannot_be_used_does_not_stop_the_others(tmp_path):
    """The first two passes have one start; the third begins later."""
    bag = made.write(tmp_path / "r", [*made.one_pass()[:200], *made.one_pass()[2:], *made.one_pass(begin=LATE)])
    ((ran, recorded),) = passes_from_recording(bag)
    assert recorded.complete and ran.name == "r_2"
    assert recorded.unused == {"r_1": "does not separate its passes: 2 passes have one start"}
    ((plain, _),) = passes_from_recording(made.write(tmp_path / "plain", made.one_pass(begin=LATE)))
    np.testing.assert_equal(ran.row() | {"name": ""}, plain.row() | {"name": ""})


def test_a_pass_is_scored_along_the_target_in_force(tmp_path):
    """A target that lies 0.5 mm to the side: the deviation is that from this target, not from the path of the cell."""
    target = path_of(made.cell_of()).target
    shifted = target.with_position(target.position + [0.0, 5e-4, 0.0])
    bag = made.write(tmp_path / "moved", made.target_of_user(shifted))
    ((moved, recorded),), replayed = passes_from_recording(bag), recompute(bag)
    assert replayed.verdict == "identical" and replayed.channels["/reference_trajectory"].compared == 2
    ((plain, _),) = passes_from_recording(made.write(tmp_path / "plain", made.one_pass()))
    assert recorded.complete and recorded.target.position[0, 1] == shifted.position[0, 1]
    shift = (moved.result.tool - plain.result.tool)[:, 1]
    assert abs(moved.scores.static_deviation - plain.scores.static_deviation) < 1e-7 < 4e-4 < shift.min()


# --- messages of other publishers on our topics ---


BAD = b"\0\1\0\0abc"
POSE_AWAY = PoseSample(0, "workpiece", np.ones(3), np.array([1.0, 0.0, 0.0, 0.0]))
FORCE = WrenchSample(0, "workpiece", np.ones(6))
FOREIGN = {  # topic, message, first stamp and step [ns]
    "force sensor of another clock": ("wrench", FORCE, LATE + 10**17, 10**6),
    "force sensor ahead of the pass": ("wrench", FORCE, LATE + 30_000_077, 10**6),
    "force sensor behind the pass": ("wrench", FORCE, LATE - 10**10, 10**6),
    "force without stamps": ("wrench", FORCE, 0, 0),
    "driver ahead of the pass": ("tool_pose", POSE_AWAY, LATE + 30_000_077, 10**6),
    "driver of another clock": ("tool_pose", POSE_AWAY, 77, 10**6),
    **{f"bytes on {topic}": (topic, None, 0, 0) for topic in (*EXCHANGE, "reference_trajectory", "compensator_state")},
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The scores of the pass without messages of others."""
    bag = made.write(tmp_path_factory.mktemp("plain") / "r", made.one_pass(begin=LATE))
    return passes_from_recording(bag)[0][0].row()


@pytest.mark.parametrize(("topic", "record", "begin", "step"), FOREIGN.values(), ids=list(FOREIGN))
def test_messages_of_another_publisher_are_not_missing_and_spoil_nothing(tmp_path, plain, topic, record, begin, step):
    messages = []
    for k, message in enumerate(made.one_pass(begin=LATE)):
        messages.append(message)
        if k % 5 == 4:
            stamp = begin + k // 5 * step
            data = BAD if record is None else to_bytes(record._replace(stamp=stamp))
            messages.append(made.Message(topic, data, stamp))
    bag = made.write(tmp_path / "r", messages)
    with Recording(bag) as recording:  # two series of one clock on one topic are not distinguished
        assert info(recording)["missing"] == 0 or begin == LATE + 30_000_077
    replayed = recompute(bag)
    assert replayed.verdict == "identical", [replayed.first, *replayed.stops]
    ((ran, recorded),) = passes_from_recording(bag)
    assert recorded.complete and recorded.messages_lost == 0
    np.testing.assert_equal(ran.row() | {"name": ""}, plain | {"name": ""})


def test_messages_of_an_unknown_type_on_our_topics_do_not_prevent_a_report(tmp_path):
    with BagWriter(tmp_path / "r", attachments={"cell.yaml": made.cell_text()}) as writer:
        for topic, kind in made.TYPES.items():
            writer.add_topic(f"/{topic}", kind)
        others = [
            writer.add_channel(topic, schema, encoding, {})
            for topic, schema, encoding in (
                ("/diagnostics", ("Other", "jsonschema", b"{}"), "json"),
                ("/wrench", ("other_msgs/msg/Force", "ros2msg", b"float64 x"), "cdr"),
                ("/camera/tool_pose", ("", "", b""), ""),
            )
        ]
        for k, message in enumerate(made.one_pass()):
            writer.write(f"/{message.topic}", message.data, 10**9 + k)
            if k % 50 == 0:
                for other in others:
                    writer.write_raw(other, b"{}", 10**9 + k, message.stamp, k)
    assert pass_from_recording(tmp_path / "r")[1].complete


# --- a robot with another clock ---


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """Two passes of the paper's cell with a driver at 4 ms and a sensor at 1 kHz, and the true passes."""
    cell = read_cell(find_file("paper.yaml"), ["compensation.method=learned"])
    protocol = CompensatorProtocol(cell, now=lambda: LATE)
    messages, true = made.messages(protocol.begin(path_of(cell).target)), []
    for number in range(2):
        true.append(simulate(cell, protocol.active.reference))
        for sample in foreign_pass(true[-1].result, number):
            name = "tool_pose" if isinstance(sample, PoseSample) else "wrench"
            messages.append(made.Message(name, to_bytes(sample), sample.stamp))
            messages += made.messages(getattr(protocol, "pose" if name == "tool_pose" else "wrench")(sample))
    return made.write(tmp_path_factory.mktemp("driven") / "r", messages, cell=cell_text(cell)), true


def test_a_pass_of_a_robot_with_another_clock_is_scored_at_its_stamps(driven):
    directory, true = driven
    passes = passes_from_recording(directory)
    assert [recorded.stamps for _, recorded in passes] == ["driver's"] * 2
    for (one, recorded), ran in zip(passes, true, strict=True):
        assert recorded.complete and 2 <= recorded.messages_lost < 20
        assert abs(one.scores.max_deviation - ran.scores.max_deviation) < 0.5e-6
        assert abs(one.scores.static_deviation - ran.scores.static_deviation) < 0.1e-6
        wrench = one.result.wrench[-100:, :3].mean(0)
        np.testing.assert_allclose(wrench, ran.result.wrench[-100:, :3].mean(0), atol=1.0)
    assert passes[1][0].scores.max_deviation < 1e-6 < 60e-6 < passes[0][0].scores.max_deviation


def test_a_pass_of_a_robot_with_another_clock_is_compared_along_its_reference_and_not_recomputed(driven, capsys):
    assert main(["compare", str(driven[0]), "paper.yaml", "--pass", "2", "--json"]) == 0
    channels = {one["name"]: one for one in json.loads(capsys.readouterr().out)["channels"]}
    assert abs(channels["deviation"]["gain"] - 1.0) < 0.02 and channels["deviation"]["residual_rms_um"] < 0.2
    with pytest.raises(RecordingError, match="its poses have the stamps of a driver"):
        recompute(driven[0])


def test_a_pass_that_breaks_off_and_one_off_the_reference_have_a_reason_and_the_others_are_scored(tmp_path, driven):
    """The first pass stops after 40 %; the second one is 8 mm from its reference in its last third."""
    directory, (first, second) = driven
    cell = read_cell(find_file("paper.yaml"), ["compensation.method=learned"])
    protocol = CompensatorProtocol(cell, now=lambda: LATE)
    messages = made.messages(protocol.begin(path_of(cell).target))
    for number, share in enumerate((0.4, 1.0, 1.0)):
        samples = foreign_pass(first.result, number)
        poses = [sample for sample in samples if isinstance(sample, PoseSample)]
        begin, end = (sample.stamp for sample in (poses[0], poses[-1]))
        for sample in samples:
            part = (sample.stamp - begin) / (end - begin)
            away = [0.0, 8e-3 * (number == 1 and part > 0.7), 0.0]
            if part <= share and isinstance(sample, PoseSample):
                sample = sample._replace(position=sample.position + away)
            if part <= share:
                name = "tool_pose" if isinstance(sample, PoseSample) else "wrench"
                messages.append(made.Message(name, to_bytes(sample), sample.stamp))
    ((ran, recorded),) = passes_from_recording(made.write(tmp_path / "r", messages, cell=cell_text(cell)))
    assert ran.name == "r_3" and recorded.complete
    assert "is over and is not used" in recorded.unused["r_1"]
    assert "so the pass is not used" in recorded.unused["r_2"]
