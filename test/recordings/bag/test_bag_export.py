"""Export, summary and playback of recordings, also with several passes in one file."""

import csv
import io
import json

import numpy as np
import pytest
from mcap.writer import Writer
from samples import pass_recording as made
from samples import recording_samples as samples
from samples.recording_samples import (
    DIAGNOSTICS,
    PERIOD,
    POSE,
    TEXT,
    TOPICS,
    WRENCH,
    header,
    make,
    pose,
    raw,
    record,
    wrench,
)

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.version import __version__
from kr270_milling.cli import main
from kr270_milling.recordings.bag import export as module
from kr270_milling.recordings.bag.export import export
from kr270_milling.recordings.bag.info import info, info_text
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter


def rows(file) -> list[dict]:
    with open(file, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def exported(recording, directory, *topics: str) -> list:
    """The files of the chosen topics, or of all."""
    with Recording(recording) as opened:
        return export(opened, directory, topics or None)[0]


def summary(recording) -> dict:
    with Recording(recording) as opened:
        return info(opened)


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    directory = tmp_path_factory.mktemp("export")
    record(directory / "a", 5)
    return {file.stem: rows(file) for file in exported(directory / "a", directory / "csv")}


def test_every_topic_has_a_table_with_a_row_per_message_and_units_in_its_columns(tables):
    points = {"target_trajectory": 10}  # two points a message
    assert {k: len(v) for k, v in tables.items()} == {t[1:]: points.get(t[1:], 5) for t in TOPICS}
    head = ["log_time_ns", "stamp_ns", "frame_id"]
    assert list(tables["tool_pose"][0])[:6] == [*head, "position_x_m", "position_y_m", "position_z_m"]
    force, torque = ([f"{name}_{axis}_{unit}" for axis in "xyz"] for name, unit in (("force", "n"), ("torque", "n_m")))
    assert list(tables["wrench"][0]) == [*head, *force, *torque]
    assert list(tables["deflection"][0])[5:7] == ["linear_z_m", "angular_x_rad"]
    assert "velocity_joint_2_rad_per_s" in tables["joint_states"][0]
    assert [row["time_from_start_ns"] for row in tables["target_trajectory"]] == ["0", "1000000000"] * 5


def test_numbers_read_back_to_the_same_bits_and_lists_are_json(tables):
    for step, row in enumerate(tables["tool_pose"]):
        values = [float(row[k]) for k in list(row)[3:]]
        assert values == (step + 0.1 * np.arange(7)).tolist()
        assert (row["stamp_ns"], row["frame_id"]) == (str(step * PERIOD), "base_link")
    row, grid = tables["diagnostics"][2], tables["workpiece"][0]
    assert json.loads(row["status"])[0]["message"] == "äußerst gut" and row["header_stamp_nanosec"] == str(2 * PERIOD)
    assert json.loads(grid["data"]) == [i % 101 for i in range(1000)] and grid["info_width"] == "40"
    assert tables["robot_description"][1]["data"] == "<robot name='1'/>"


def test_a_new_file_begins_where_the_joints_change(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/joint_states", samples.JOINTS)
        for i, names in enumerate([["a", "b"], ["a", "b"], ["c"]]):
            writer.write("/joint_states", raw(samples.joints(i, [1.0] * len(names), names=names)), 0)
    files = exported(tmp_path / "a", tmp_path / "csv")
    assert [f.name for f in files] == ["joint_states.csv", "joint_states_2.csv"]
    assert [len(rows(f)) for f in files] == [2, 1]


def test_names_of_topics_do_not_lead_out_of_the_directory_and_do_not_collide(tmp_path):
    victim = tmp_path / "victim.csv"
    victim.write_text("mine")
    (tmp_path / "csv").mkdir()
    (tmp_path / "csv" / "a_b.csv").symlink_to(victim)
    with BagWriter(tmp_path / "a") as writer:
        for topic in ("/../victim", "/a/b", "/a_b", "/ä b", "/"):
            writer.add_topic(topic, POSE)
            writer.write(topic, raw(pose(0, np.zeros(7))), 0)
    files = exported(tmp_path / "a", tmp_path / "csv")
    assert sorted(f.name for f in files) == ["a_b.csv", "a_b_2.csv", "unnamed.csv", "victim.csv", "ä_b.csv"]
    assert all(f.parent == tmp_path / "csv" and len(rows(f)) == 1 for f in files)
    assert victim.read_text() == "mine"


def test_a_topic_that_cannot_be_decoded_is_named_and_the_others_are_written(tmp_path, capsys):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/thing", "json", writer.register_schema("Thing", "jsonschema", b"{}"))
        text = writer.register_channel("/text", "cdr", writer.register_schema(TEXT, "ros2msg", b"string data\n"))
        broken = writer.register_channel("/broken", "cdr", writer.register_schema(TEXT, "ros2msg", b"string data\n"))
        for step in range(3):
            writer.add_message(channel, 1, b"{}", 1)
            writer.add_message(text, 2, raw(make(TEXT, "notes")), 2)
            writer.add_message(broken, 3, raw(make(TEXT, "x")) if step < 2 else b"\0\1\0\0\xff\xff\xff\xff", 3)
        writer.finish()
    with Recording(tmp_path / "a.mcap") as recording:
        files, refused = export(recording, tmp_path / "csv")
    assert [file.name for file in files] == ["text.csv"] and len(rows(files[0])) == 3
    assert "only cdr with ros2msg" in refused["/thing"]
    assert "a message on /broken is not a std_msgs/msg/String" in refused["/broken"]
    assert [file.name for file in (tmp_path / "csv").iterdir()] == ["text.csv"]
    assert main(["export", str(tmp_path / "a.mcap"), "--csv", str(tmp_path / "again")]) == 1
    printed = capsys.readouterr()
    assert "text.csv" in printed.out and printed.err.count("not exported: ") == 2


def test_an_unknown_topic_is_named(tmp_path):
    record(tmp_path / "a", 5)
    with pytest.raises(RecordingError, match="has no topic /wrnch"):
        exported(tmp_path / "a", tmp_path / "csv", "/wrnch")


@pytest.mark.parametrize("steps", [30, 2000])
def test_nothing_stays_where_the_disk_is_full(tmp_path, steps):
    """The disk is full in the last bytes, which are written when the file is closed, or long before."""
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/tool_pose", POSE)
        for step in range(steps):
            writer.write("/tool_pose", raw(pose(step * PERIOD, np.full(7, 0.1 + step / 7))), 0)
    with samples.full_disk(4096), pytest.raises(RecordingError, match="the tables cannot be written"):
        exported(tmp_path / "a", tmp_path / "csv")
    assert list((tmp_path / "csv").iterdir()) == []


def test_info_counts_what_was_written(tmp_path):
    written = record(tmp_path / "a", 30, attachments={"cell.yaml": "a: 1\n"}, metadata={"seed": 7})
    data = summary(tmp_path / "a")
    assert json.loads(json.dumps(data)) == data
    assert (data["messages"], data["cut_off"], data["missing"]) == (30 * len(TOPICS), False, 0)
    assert data["duration_s"] == pytest.approx(29 * PERIOD / 1e9)
    for name, topic in data["topics"].items():
        assert topic["type"] == TOPICS[name]
        assert (topic["count"], topic["size_bytes"]) == (30, sum(len(d) for t, _, d in written if t == name))
        assert topic["rate_hz"] == pytest.approx(2000.0)
    assert data["attachments"] == [dict(name="cell.yaml", media_type="application/yaml", size_bytes=5)]
    assert data["metadata"]["kr270_milling"]["seed"] == "7"
    assert data["library"] == f"kr270_milling/{__version__}"
    BagWriter(tmp_path / "empty").close()
    data = summary(tmp_path / "empty")
    assert (data["messages"], data["start_ns"], data["duration_s"], data["topics"]) == (0, None, 0.0, {})
    assert not data["cut_off"] and "0 messages" in info_text(data)


STEPS = 200
ONE = STEPS * PERIOD  # [ns] from one pass to the next


@pytest.fixture
def three_passes(tmp_path):
    """A recording; in every pass a text, poses, wrenches, and reports with the stamp 0."""
    with BagWriter(tmp_path / "a", chunk_size=5000) as writer:
        for topic, kind in {"/tool_pose": POSE, "/wrench": WRENCH, "/diagnostics": DIAGNOSTICS}.items():
            writer.add_topic(topic, kind)
        writer.add_topic("/note", TEXT, [made.LATCHED])
        for number in range(3):
            for step in range(STEPS):
                stamp, received = step * PERIOD, number * ONE + step * PERIOD
                writer.write("/tool_pose", raw(pose(stamp, np.full(7, number * STEPS + step))), received)
                writer.write("/wrench", raw(wrench(stamp, np.full(6, number * STEPS + step))), received)
                if step == 5:
                    writer.write("/note", raw(make(TEXT, f"pass {number}")), received)
                if step % 20 == 0:
                    writer.write("/diagnostics", raw(make(DIAGNOSTICS, header(0), [])), received)
    with Recording(tmp_path / "a") as recording:
        yield recording


def test_an_offset_leads_into_a_later_pass_with_what_was_latched_last_before_it(three_passes):
    offset = str((ONE + 12 * PERIOD) * 1e-9)
    first, *actual = made.played(three_passes.path, "--start-offset", offset, "--playback-duration", "0.001")
    _, note, _ = (m.data for m in three_passes.messages(["/note"]))
    assert (first.topic, first.data) == ("/note", note)
    poses = [m.log_time for m in actual if m.topic == "/tool_pose"]
    assert poses == [ONE + step * PERIOD for step in (12, 13, 14)]


def test_messages_are_played_in_the_order_of_the_file(tmp_path):
    with BagWriter(tmp_path / "b") as writer:
        writer.add_topic("/tool_pose", POSE)
        for log_time in (5, 9, 7, 5, 8):
            writer.write("/tool_pose", raw(pose(0, np.zeros(7))), 1, log_time)
    assert [m.log_time for m in made.played(tmp_path / "b")] == [5, 9, 9, 9, 9]  # in the order of the file


def test_no_text_of_a_table_is_a_formula_for_a_spreadsheet():
    stream, texts = io.BytesIO(), ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1"]
    stream.close = lambda: None
    module._write_csv(stream, ["a", "b", "c"], [[text, "x=1", -1.5] for text in texts])
    _, *actual = csv.reader(io.StringIO(stream.getvalue().decode()))
    assert actual == [["'" + text, "x=1", "-1.5"] for text in texts]
