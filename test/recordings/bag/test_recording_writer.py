from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from test_recording_samples import PERIOD, POSE, TEXT, make, pose, raw, record

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.version import __version__
from kr270_milling.recordings.bag.export import export
from kr270_milling.recordings.bag.info import info
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import recover
from kr270_milling.recordings.bag.verify import findings
from kr270_milling.recordings.bag.writer import BagWriter, MessageRefused

ROOT = str(Path(__file__).parents[3])


def child(code: str, *args) -> subprocess.Popen:
    """Another Python process with this package and these samples on its path."""
    env = dict(os.environ, PYTHONPATH=os.pathsep.join([ROOT, ROOT + "/test", ROOT + "/test/recordings/messages"]))
    return subprocess.Popen([sys.executable, "-c", code, *map(str, args)], env=env, stdout=subprocess.PIPE, text=True)


def test_configuration_version_and_command_line_are_in_the_file(tmp_path):
    cell = "/**:\n  ros__parameters: {}\n"
    record(tmp_path / "a", 2, attachments={"cell.yaml": cell}, metadata={"seed": 7, "command_line": "run x"})
    with Recording(tmp_path / "a") as recording:
        assert recording.attachment("cell.yaml") == cell.encode()
        about = recording.metadata()["kr270_milling"]
        assert about == {"kr270_milling_version": __version__, "seed": "7", "command_line": "run x"}
        assert recording.profile == "ros2"


def test_log_time_is_the_stamp_and_else_the_latest_stamp(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/p", POSE)
        writer.add_topic("/s", TEXT)
        writer.write("/s", raw(make(TEXT, "first")), publish_time=10**18)
        writer.write("/p", raw(pose(700, np.zeros(7))), publish_time=10**18)
        writer.write("/s", raw(make(TEXT, "second")), publish_time=10**18 + 1)
        writer.write("/s", raw(make(TEXT, "third")), publish_time=10**18 + 2, log_time=701)
    with Recording(tmp_path / "a") as recording:
        times = [(m.topic, m.log_time, m.publish_time - 10**18) for m in recording.messages()]
    assert times == [("/s", 700, 0), ("/p", 700, 0), ("/s", 700, 1), ("/s", 701, 2)]


def test_gaps_are_counted_per_topic_and_stand_in_the_file(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        for name in ("/holes", "/whole"):
            writer.add_topic(name, POSE)
        for step in range(100):
            data = raw(pose(step * PERIOD, np.zeros(7)))
            for name in ("/holes", "/whole"):
                if name == "/whole" or step not in (1, 40, 41, 42, 77):
                    writer.write(name, data, 0)
    counts = writer.report()
    assert [counts[n]["missing"] for n in ("/holes", "/whole")] == [5, 0]
    assert [counts[n]["gaps"] for n in ("/holes", "/whole")] == [3, 0]
    with Recording(tmp_path / "a") as recording:
        assert {k: json.loads(v) for k, v in recording.metadata()["kr270_milling.counts"].items()} == counts


def test_metadata_yaml_is_what_rosbag2_of_jazzy_writes(tmp_path):
    record(tmp_path / "a", 3, topics=["/tool_pose", "/clock"])
    text = (tmp_path / "a" / "metadata.yaml").read_text()
    about = yaml.safe_load(text)["rosbag2_bagfile_information"]
    # the keys in the order of a file written by ros2 bag record (Jazzy, version 9)
    assert list(about) == ["version", "storage_identifier", "duration", "starting_time", "message_count",
                           "topics_with_message_count", "compression_format", "compression_mode",
                           "relative_file_paths", "files", "custom_data", "ros_distro"]  # fmt: skip
    assert (about["version"], about["message_count"], about["relative_file_paths"]) == (9, 6, ["a.mcap"])
    assert about["duration"] == {"nanoseconds": 2 * PERIOD}
    assert "&id" not in text  # anchors are legal YAML that other readers need not know


def test_an_empty_recording_is_whole(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/tool_pose", POSE)
    with Recording(tmp_path / "a") as recording:
        assert (recording.count, recording.cut_off, list(recording.messages())) == (0, False, [])
        assert recording.topics()["/tool_pose"].type == POSE


def test_nothing_is_overwritten(tmp_path):
    record(tmp_path / "a", 1)
    before = (tmp_path / "a" / "a.mcap").read_bytes()
    with pytest.raises(RecordingError, match="not overwritten"):
        BagWriter(tmp_path / "a")
    (tmp_path / "a" / "metadata.yaml").unlink()
    with pytest.raises(RecordingError, match="not overwritten"):
        BagWriter(tmp_path / "a")
    assert (tmp_path / "a" / "a.mcap").read_bytes() == before


@pytest.mark.parametrize("name", ["../b", "b/c", ""])
def test_a_name_does_not_lead_out_of_the_directory(tmp_path, name):
    if name:
        with pytest.raises(RecordingError, match="file name"):
            BagWriter(tmp_path / "a", name)
    assert not list(tmp_path.glob("**/*.mcap"))


def test_wrong_use_is_one_sentence(tmp_path):
    writer = BagWriter(tmp_path / "a")
    writer.add_topic("/p", POSE)
    for call in (
        lambda: writer.write("/q", b"", 0),
        lambda: writer.add_topic("/p", TEXT),
        lambda: writer.write("/p", b"", -1, -1),
        lambda: writer.add_topic("/z", "no_such_msgs/msg/Thing"),
    ):
        with pytest.raises(RecordingError):
            call()
    writer.close()
    with pytest.raises(RecordingError, match="closed"):
        writer.write("/p", raw(pose(0, np.zeros(7))), 0)


def test_a_refused_message_is_counted_and_the_recording_goes_on(tmp_path):
    """A publish time before 1970 or behind 2262 ended the recording, though nothing was wrong with the file."""
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/p", POSE)
        for step, publish_time in enumerate([0, -1, 2**63, 5, 2**64, 7]):
            data = raw(pose(step * PERIOD, np.zeros(7)))
            if 0 <= publish_time < 2**63:
                writer.write("/p", data, publish_time)
                continue
            with pytest.raises(MessageRefused, match=f"the time {publish_time} ns"):
                writer.write("/p", data, publish_time)
        with pytest.raises(MessageRefused, match="not added"):
            writer.write("/q", b"", 0)
        assert writer.output.error is None and writer.report()["/p"]["refused"] == 3
    with Recording(tmp_path / "a") as recording:
        assert [m.publish_time for m in recording.messages()] == [0, 5, 7]
        assert json.loads(recording.metadata()["kr270_milling.counts"]["/p"])["refused"] == 3


def test_a_chunk_is_closed_by_the_clock(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/p", POSE)
        sizes = []
        for step in range(10):
            writer.write("/p", raw(pose(step, np.zeros(7))), 0)
            writer.tick(100 + 0.125 * step)
            with Recording(tmp_path / "a") as recording:
                sizes.append(recording.count)
    assert sizes == [0, 0, 3, 3, 5, 5, 7, 7, 9, 9]  # at the first tick 0.2 s or more after the last chunk


KILLED = """
import sys, time
import numpy as np
from test_recording_samples import POSE, pose, raw
from kr270_milling.recordings.bag.writer import BagWriter
writer = BagWriter(sys.argv[1], attachments={"cell.yaml": "a: 1"})
writer.add_topic("/tool_pose", POSE)
data = [raw(pose(i * 200_000, np.arange(7) + i)) for i in range(50_000)]
print("ready", flush=True)
begin = time.monotonic()
for i, message in enumerate(data):  # 5,000 messages a second
    while time.monotonic() - begin < i * 2e-4:
        time.sleep(1e-3)
        writer.tick(time.monotonic())
    writer.write("/tool_pose", message, i)
    writer.tick(time.monotonic())
    if i % 100 == 0:
        print(i, flush=True)
"""


def test_a_killed_writer_loses_less_than_a_second_and_the_rest_is_read_exported_and_recovered(tmp_path):
    with child(KILLED, tmp_path / "a") as process:
        process.stdout.readline()
        begin, lines = time.monotonic(), []
        while time.monotonic() - begin < 1.5:
            lines.append(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        lines += process.stdout.read().splitlines()
    last = int(lines[-1])
    with Recording(tmp_path / "a") as recording:
        messages = list(recording.messages())
        assert recording.cut_off
        assert last - 5000 < len(messages)  # 5,000 are one second
        assert [m.log_time for m in messages] == [i * 200_000 for i in range(len(messages))]
        assert messages[-1].data == raw(pose((len(messages) - 1) * 200_000, np.arange(7) + len(messages) - 1))
        assert recording.last_log_time == messages[-1].log_time
        assert info(recording)["cut_off"] and info(recording)["missing"] == 0
        [table] = export(recording, tmp_path / "csv").files
    assert len(table.read_text().splitlines()) == len(messages) + 1
    result = recover(tmp_path / "a")
    assert result.messages == len(messages) and not result.whole and result.attachments == ["cell.yaml"]
    with Recording(result.directory) as whole:
        assert not whole.cut_off
        assert [m[:4] for m in whole.messages()] == [m[:4] for m in messages]
        assert findings(whole) == []


LIMITED = """
import resource, sys
import numpy as np
from test_recording_samples import GRID, make, header, raw, sample
from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.writer import BagWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))
writer = BagWriter(sys.argv[1])
writer.add_topic("/workpiece", GRID)
rng = np.random.default_rng(1)
errors = []
for i in range(100):
    grid = sample("/workpiece", i)
    grid.data = rng.integers(-128, 127, 100_000, np.int8)  # cannot be packed
    try:
        writer.write("/workpiece", raw(grid), i)
    except RecordingError as error:
        errors.append(str(error))
        size = (writer.path).stat().st_size
writer.close()
assert writer.path.stat().st_size == size, "it wrote on"
print(writer.output.saved, len(set(errors)), errors[0])
"""


def test_a_full_disk_is_told_once_and_what_was_written_stays_readable(tmp_path):
    process = child(LIMITED, tmp_path / "a")
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    kept, sentences, sentence = output.split(maxsplit=2)
    assert sentences == "1" and "File too large" in sentence and "are safe" in sentence
    with Recording(tmp_path / "a") as recording:
        assert recording.cut_off
        assert [m.log_time for m in recording.messages()] == [i * PERIOD for i in range(int(kept))]
        assert 20 <= int(kept) < 30  # 3 MB hold not more than 29 of 0.1 MB
    assert recover(tmp_path / "a").messages == int(kept)


def test_a_chunk_that_fits_only_in_part_is_taken_back(tmp_path, monkeypatch):
    room = [30_000]
    write = os.write

    def limited(file, data):
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        done = write(file, data[: room[0]])
        room[0] -= done
        return done

    with BagWriter(tmp_path / "a", chunk_size=4000) as writer:
        writer.add_topic("/p", POSE)
        rng = np.random.default_rng(6)  # numbers that cannot be packed
        monkeypatch.setattr("kr270_milling.recordings.bag.output.os.write", limited)
        with pytest.raises(RecordingError, match="No space left on device") as error:
            for step in range(10_000):
                writer.write("/p", raw(pose(step, rng.normal(size=7))), 0)
        with pytest.raises(RecordingError) as again:
            writer.add_metadata("more", {})
    assert again.value is error.value
    assert f"{writer.output.saved} messages" in str(error.value) and 0 < writer.output.saved < writer.count
    assert not (tmp_path / "a" / "metadata.yaml").exists()
    with Recording(tmp_path / "a") as recording:
        assert recording.cut_off and recording.count == writer.output.saved


def test_the_disk_is_full_from_the_first_byte(tmp_path):
    code = """
import resource, sys
from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.writer import BagWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (4, 4))
try:
    BagWriter(sys.argv[1])
except RecordingError as error:
    print(error)
"""
    output, _ = child(code, tmp_path / "a").communicate(timeout=60)
    assert "File too large" in output and output.count("\n") == 1
