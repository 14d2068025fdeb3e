"""Writing recordings: files, log times, gaps, QoS profiles and memory."""

import contextlib
import json
import os
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos
from samples.recording_samples import (
    DIAGNOSTICS,
    PATH,
    PERIOD,
    POSE,
    TEXT,
    full_disk,
    header,
    make,
    path,
    pose,
    profile,
    raw,
    record,
)

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.version import __version__
from kr270_milling.recordings.bag.files import QOS, qos_text, read_qos
from kr270_milling.recordings.bag.info import GapCounter, info, info_text
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import recover
from kr270_milling.recordings.bag.writer import BagWriter, MessageRefused
from kr270_milling.recordings.messages.cdr import stamp_of


def test_gaps_are_counted_per_topic_by_the_writer_and_by_a_reader(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        for name in ("/holes", "/whole"):
            writer.add_topic(name, POSE)
        for step in range(100):
            data = raw(pose(step * PERIOD, np.zeros(7)))
            for name in ("/holes", "/whole"):
                if name == "/whole" or step not in (1, 40, 41, 42, 77):
                    writer.write(name, data, 0)
    counts = writer.report()
    with Recording(tmp_path / "a") as recording:
        assert {k: json.loads(v) for k, v in recording.metadata()["kr270_milling.counts"].items()} == counts
        read = info(recording)
    for gaps in (counts, {name: topic["gaps"] for name, topic in read["topics"].items()}):
        assert [(gaps[n]["missing"], gaps[n]["gaps"]) for n in ("/holes", "/whole")] == [(5, 3), (0, 0)]
    assert read["missing"] == 5 and "5 missing in 3 gaps" in info_text(read) and "counts" not in info_text(read)


def test_metadata_yaml_is_what_rosbag2_of_jazzy_writes_and_the_file_has_configuration_and_version(tmp_path):
    metadata = {"seed": 7, "command_line": "run x"}
    record(tmp_path / "a", 3, ["/tool_pose", "/clock"], attachments={"cell.yaml": "ä: 1\n"}, metadata=metadata)
    with Recording(tmp_path / "a") as recording:
        assert recording.attachment("cell.yaml") == "ä: 1\n".encode() and recording.profile == "ros2"
        expected = {"kr270_milling_version": __version__, "seed": "7", "command_line": "run x"}
        assert recording.metadata()["kr270_milling"] == expected
    text = (tmp_path / "a" / "metadata.yaml").read_text()
    about = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert (about["version"], about["message_count"], about["relative_file_paths"]) == (9, 6, ["a.mcap"])
    assert about["duration"] == {"nanoseconds": 2 * PERIOD}
    assert "&id" not in text  # anchors are legal YAML that other readers need not know


def test_a_refused_message_is_counted_and_the_recording_continues(tmp_path):
    """A publish time before 1970 or after 2262 ended the recording, though nothing was wrong with the file."""
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/p", POSE)
        for step, publish_time in enumerate([0, -1, 2**63, 5, 2**64, 7]):
            refused = pytest.raises(MessageRefused, match=f"the time {publish_time} ns")
            with contextlib.nullcontext() if 0 <= publish_time < 2**63 else refused:
                writer.write("/p", raw(pose(step * PERIOD, np.zeros(7))), publish_time)
        with pytest.raises(MessageRefused, match="not added"):
            writer.write("/q", b"", 0)
        assert writer.output.error is None and writer.report()["/p"]["refused"] == 3
    with Recording(tmp_path / "a") as recording:
        assert [m.publish_time for m in recording.messages()] == [0, 5, 7]
        assert json.loads(recording.metadata()["kr270_milling.counts"]["/p"])["refused"] == 3
        assert '/p = {"count": 3' in info_text(info(recording))


KILLED = """
import sys, time
from kr270_milling.recordings.bag.writer import BagWriter
writer = BagWriter(sys.argv[1], attachments={"cell.yaml": "a: 1"})
writer.add_topic("/tool_pose", "geometry_msgs/msg/PoseStamped")
body = bytes.fromhex(sys.argv[2])
for i in range(100_000):
    now = time.time_ns()
    writer.write("/tool_pose", body[:8] + (i * 10_000).to_bytes(4, "little") + body[12:], now)
    writer.tick(time.monotonic())
    if i % 100 == 99:
        print(now, flush=True)
        time.sleep(0.02)
"""


def test_a_killed_writer_loses_less_than_a_second_and_the_rest_is_read_and_recovered(tmp_path):
    command = [sys.executable, "-c", KILLED, str(tmp_path / "a"), posed(0).hex()]
    env = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[3]))
    with subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True) as process:
        lines, begin = [process.stdout.readline()], time.monotonic()
        while time.monotonic() - begin < 1.5:
            lines.append(process.stdout.readline())
        process.kill()
        lines += process.stdout.read().splitlines()
    with Recording(tmp_path / "a") as recording:
        messages = list(recording.messages())
        assert recording.cut_off
        assert int(lines[-1]) - messages[-1].publish_time < 10**9  # [ns]
        assert [stamp_of(m.data) for m in messages] == [i * 10_000 for i in range(len(messages))]
        assert messages[-1].data == posed(10_000 * (len(messages) - 1))
        assert recording.last_log_time == messages[-1].log_time
        assert info(recording)["missing"] == 0 and "cut off" in info_text(info(recording))
    result = recover(tmp_path / "a")
    assert result.messages == len(messages) and not result.whole and result.attachments == ["cell.yaml"]


def test_a_full_disk_ends_the_file_after_its_last_whole_chunk(tmp_path):
    with full_disk(4), pytest.raises(RecordingError, match="File too large"):
        BagWriter(tmp_path / "none")
    rng, writer = np.random.default_rng(6), BagWriter(tmp_path / "a", chunk_size=4000)  # numbers that cannot be packed
    writer.add_topic("/p", POSE)
    with full_disk(30_000), pytest.raises(RecordingError, match="File too large") as caught:
        for step in range(10_000):
            writer.write("/p", raw(pose(step, rng.normal(size=7))), 0)
    writer.close()
    with Recording(tmp_path / "a") as recording:
        assert recording.cut_off
        saved, lost = recording.count, writer.count - recording.count
    assert saved > 0 and f"{saved} messages are safe, the last {lost} are lost" in str(caught.value)
    assert not (tmp_path / "a" / "metadata.yaml").exists()


def test_nothing_is_written_elsewhere_through_a_link_or_over_a_file(tmp_path):
    victim = tmp_path / "victim.mcap"
    victim.write_text("mine")
    (tmp_path / "link.mcap").symlink_to(victim)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    for directory, name in ((tmp_path, "link"), (tmp_path, "victim"), (tmp_path / "out", None)):
        with pytest.raises(RecordingError, match="exists already|symbolic link"):
            BagWriter(directory, name)
    for name, reason in (("x" * 300, "cannot be created"), *((n, "not the name") for n in ("../x", "a/b", "/tmp/x"))):
        with pytest.raises(RecordingError, match=reason):
            BagWriter(tmp_path, name)
    writer = BagWriter(tmp_path / "a")
    (tmp_path / "a" / "metadata.yaml").symlink_to(victim)
    writer.close()
    assert "rosbag2_bagfile_information" in (tmp_path / "a" / "metadata.yaml").read_text()
    assert victim.read_text() == "mine" and not list((tmp_path / "elsewhere").iterdir())
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["a.mcap", "metadata.yaml"]
    with pytest.raises(RecordingError, match="not overwritten"):
        BagWriter(tmp_path / "a", "other")


WALL = 1_800_000_000 * 10**9  # [ns], in 2027
KINDS = {"/p": POSE, "/q": POSE, "/s": TEXT, "/t": PATH, "/d": DIAGNOSTICS}
AT_ONCE = raw(path(0, [0, 10**9], np.zeros((2, 1, 3)), [[[0, 0, 0, 1]]] * 2))


def text(words: str) -> bytes:
    return raw(make(TEXT, words))


def report(stamp: int) -> bytes:
    return raw(make(DIAGNOSTICS, header(stamp), []))


def posed(stamp: int) -> bytes:
    return raw(pose(stamp, np.arange(7)))


def opened(directory, *topics: str) -> BagWriter:
    made = BagWriter(directory)
    for topic in topics:
        made.add_topic(topic, KINDS[topic])
    return made


def log_times(directory) -> list[tuple[str, int]]:
    with Recording(directory) as recording:
        return [(m.topic, m.log_time) for m in recording.messages()]


def test_the_log_time_is_the_time_of_receipt_and_the_header_keeps_the_stamp(tmp_path):
    sent = [("/s", text("description")), ("/t", AT_ONCE), ("/p", posed(500)), ("/d", report(WALL)), ("/p", posed(0))]
    with opened(tmp_path / "a", *KINDS) as writer:
        for k, (topic, data) in enumerate(sent):
            writer.write(topic, data, WALL + k, WALL + k + 1000)
        writer.write("/s", text("without a time of receipt"), WALL + 99)
    assert log_times(tmp_path / "a") == [*((t, WALL + k + 1000) for k, (t, _) in enumerate(sent)), ("/s", WALL + 99)]
    with Recording(tmp_path / "a") as recording:
        assert [m.publish_time - WALL for m in recording.messages()] == [*range(len(sent)), 99]
        assert [stamp_of(m.data) for m in recording.messages(["/p"])] == [500, 0]


def count(stamps, period=None) -> GapCounter:
    counter = GapCounter()
    counter.period_ns = period
    for stamp in stamps:
        counter.add(stamp)
    return counter.finish()


DROPPED = st.sets(st.integers(1, 398), max_size=150)


@given(st.lists(DROPPED, min_size=1, max_size=3), st.integers(1_000, 10**8), st.integers(0, 10**18))
def test_missing_messages_of_a_known_period_are_counted_exactly_in_every_pass(passes, period, begin):
    begin = begin if len(passes) == 1 else 0  # a second pass of simulated time begins at 0 again
    counter = count([begin + i * period for dropped in passes for i in range(400) if i not in dropped], period)
    holes = sum(i - 1 not in dropped for dropped in passes for i in dropped)
    assert (counter.missing, counter.gaps, counter.backwards) == (sum(map(len, passes)), holes, 0)


@given(st.sets(st.integers(1, 398), max_size=30), st.integers(1_000, 10**8))
def test_a_learned_period_counts_the_same_also_for_what_was_missing_while_learning(dropped, period):
    counter = count([i * period for i in range(400) if i not in dropped])
    singles = [i for i in range(400) if i not in dropped][:21]
    if sum(b - a == 1 for a, b in zip(singles, singles[1:], strict=False)) > 10:  # most are the period itself
        assert (counter.period_ns, counter.missing) == (period, len(dropped))


JITTER = [i * 1000 + (i * 7919) % 240 for i in range(200)]


@pytest.mark.parametrize(("stamps", "period", "missing", "gaps"), [
    (JITTER, 1000, 0, 0),  # below half a period
    ([s for i, s in enumerate(JITTER) if i not in (50, 120, 121)], 1000, 3, 2),
    ([i**3 for i in range(100)], None, 0, 0),  # no period
    *[([i * 10 for i in range(number)], None, 0, 0) for number in range(4)],  # too few differences for a period
    ([0, 10, 20, 30, 60], None, 2, 1),
])  # fmt: skip
def test_only_what_is_left_out_of_an_even_series_is_missing(stamps, period, missing, gaps):
    counter = count(stamps, period)
    assert (counter.missing, counter.gaps) == (missing, gaps)


def test_repeated_and_backward_stamps_are_counted_on_their_own_and_latched_ones_are_not():
    counter = count([0, 10, 20, 20, 10, 30, 40, 70], 10)
    assert (counter.repeated, counter.backwards, counter.missing, counter.gaps) == (1, 1, 2, 1)
    latched = GapCounter(latched=True)
    for stamp in (5, 5, 5, 9, 9):
        latched.add(stamp)
    assert latched.finish().repeated == 0


FOREVER = QosTime(9223372036, 854775807)
ONE_LATCHED = Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, FOREVER, FOREVER,
                  QosLiveliness.AUTOMATIC, FOREVER, False)  # fmt: skip


def test_a_profile_is_what_rosbags_writes_and_reads():
    assert read_qos(qos_text([profile(1, "TRANSIENT_LOCAL")])) == dump_qos_v9([ONE_LATCHED])
    assert parse_qos(qos_text([profile(1, "TRANSIENT_LOCAL")])) == [ONE_LATCHED]


def test_a_profile_object_of_rclpy_is_described():
    qos = pytest.importorskip("rclpy.qos", reason="rclpy is not installed")
    (actual,) = read_qos(qos_text([qos.QoSProfile(depth=7, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)]))
    assert list(actual) == list(QOS) and actual["deadline"] == dict(sec=0, nsec=0)
    assert (actual["history"], actual["depth"], actual["durability"]) == ("keep_last", 7, "transient_local")


def test_profiles_of_other_versions_of_rosbag2_are_read_and_foreign_text_is_none():
    deadline = "deadline:\n    sec: 9223372036\n    nsec: 854775807"
    older = f"- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  {deadline}"
    assert read_qos(older)[0]["deadline"] == dict(sec=9223372036, nsec=854775807)
    for text in ("", "3", "[1, 2]", "a: b", "{", "!!python/object:os.system x", "[" * 2000):
        assert read_qos(text) == []


def test_memory_of_the_writer_stays_flat(tmp_path):
    peaks = []
    with opened(tmp_path / "a", "/s") as writer:
        tracemalloc.start()
        for part in range(3):
            for i in range(1500):
                writer.write("/s", text("x" * 10_000), 0, log_time=part * 10**9 + i)
            peaks.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert peaks[2] - peaks[1] < 2_000_000  # between zero and one chunk of 1 MB and its index are waiting
