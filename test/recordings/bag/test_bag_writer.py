"""Writing recordings: files, log times, gaps, QoS profiles and memory."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from recording_samples import DIAGNOSTICS, PATH, PERIOD, POSE, TEXT, make, path, pose, raw, record
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.version import __version__
from kr270_milling.recordings.bag import writer as module
from kr270_milling.recordings.bag.bagmeta import DEFAULT_QOS, describe_qos, qos_text, read_qos
from kr270_milling.recordings.bag.export import export
from kr270_milling.recordings.bag.info import info
from kr270_milling.recordings.bag.output import plain_name
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import recover
from kr270_milling.recordings.bag.stamps import YEAR, GapCounter, LogTimes
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
from recording_samples import POSE, pose, raw
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


FULL = """
import resource, sys
import numpy as np
from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.writer import BagWriter
from recording_samples import POSE, pose, raw
limit = int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
rng, errors = np.random.default_rng(6), []  # numbers that cannot be packed
try:
    writer = BagWriter(sys.argv[1], chunk_size=4000)
    writer.add_topic("/p", POSE)
    for step in range(10_000):
        writer.write("/p", raw(pose(step, rng.normal(size=7))), 0)
except RecordingError as error:
    errors.append(error)
if limit > 1000:
    try:
        writer.add_metadata("more", {})
    except RecordingError as error:
        assert error is errors[0]
    writer.close()
    print(writer.output.saved, writer.count)
print(errors[0])
"""


@pytest.mark.parametrize("limit", [4, 30_000])
def test_a_full_disk_ends_the_file_after_its_last_whole_chunk(tmp_path, limit):
    output, _ = child(FULL, tmp_path / "a", limit).communicate(timeout=60)
    *counts, sentence = output.splitlines()
    assert "File too large" in sentence and not (tmp_path / "a" / "metadata.yaml").exists()
    for line in counts:
        saved, count = map(int, line.split())
        assert 0 < saved < count and f"{saved} messages are safe, the last {count - saved} are lost" in sentence
        with Recording(tmp_path / "a") as recording:
            assert recording.cut_off and recording.count == saved


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "/etc/passwd", "../x", "a\0b", "x" * 300])
def test_names_that_lead_elsewhere_are_refused(tmp_path, name):
    with pytest.raises(RecordingError):
        plain_name(tmp_path, name)


def test_nothing_is_written_through_a_link_or_over_a_file(tmp_path):
    victim = tmp_path / "victim.mcap"
    victim.write_text("mine")
    (tmp_path / "link.mcap").symlink_to(victim)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    for directory, name in ((tmp_path, "link"), (tmp_path, "victim"), (tmp_path / "out", None)):
        with pytest.raises(RecordingError, match="exists already|symbolic link"):
            BagWriter(directory, name)
    writer = BagWriter(tmp_path / "a")
    (tmp_path / "a" / "metadata.yaml").symlink_to(victim)
    writer.close()
    assert "rosbag2_bagfile_information" in (tmp_path / "a" / "metadata.yaml").read_text()
    assert victim.read_text() == "mine" and not list((tmp_path / "elsewhere").iterdir())
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["a.mcap", "metadata.yaml"]


WALL = 1_800_000_000 * 10**9  # [ns], in 2027
KINDS = {"/p": POSE, "/q": POSE, "/s": TEXT, "/t": PATH, "/d": DIAGNOSTICS}
NUMBERS = np.array([0, 0, 0, 0, 0, 0, 1.0])


def text(words: str) -> bytes:
    return raw(make(TEXT, words))


def report(stamp: int) -> bytes:
    header = pose(stamp, NUMBERS).header
    return raw(make(DIAGNOSTICS, header, []))


def at_once() -> bytes:
    return raw(path(0, [0, 10**9], np.zeros((2, 1, 3)), [[[0, 0, 0, 1]]] * 2))


def opened(directory, *topics: str) -> BagWriter:
    made = BagWriter(directory)
    for topic in topics:
        made.add_topic(topic, KINDS[topic])
    return made


def log_times(directory) -> list[tuple[str, int]]:
    with Recording(directory) as recording:
        return [(m.topic, m.log_time) for m in recording.messages()]


def test_messages_from_before_the_first_stamp_take_that_stamp_and_stay_in_their_order(tmp_path):
    with opened(tmp_path / "a", *KINDS) as writer:
        writer.write("/s", text("description"), WALL)
        writer.write("/t", at_once(), WALL + 1)
        writer.write("/d", report(0), WALL + 2)
        writer.write("/s", text("again"), WALL + 3)
        assert writer.count == 0
        writer.write("/p", raw(pose(500, NUMBERS)), WALL + 4)
    assert log_times(tmp_path / "a") == [("/s", 500), ("/t", 500), ("/d", 0), ("/s", 500), ("/p", 500)]


def test_recording_of_wall_clock_stamps_begins_with_the_first_of_them(tmp_path):
    with opened(tmp_path / "a", *KINDS) as writer:
        writer.write("/d", report(0), WALL)  # that of the recorder itself, which knows no time
        writer.write("/t", at_once(), WALL)
        writer.write("/p", raw(pose(WALL + 7, NUMBERS)), WALL + 8)
        writer.write("/d", report(0), WALL + 9)
    assert log_times(tmp_path / "a") == [(topic, WALL + 7) for topic in ("/d", "/t", "/p", "/d")]


def test_stamp_of_another_clock_does_not_make_the_recording_last_for_decades(tmp_path):
    with opened(tmp_path / "a", *KINDS) as writer:
        writer.write("/d", report(WALL), WALL)  # of a foreign driver
        writer.write("/p", raw(pose(0, NUMBERS)), WALL)
        writer.write("/q", raw(pose(WALL + 2, NUMBERS)), WALL)
        writer.write("/p", raw(pose(500, NUMBERS)), WALL)
        writer.write("/d", report(WALL + 3), WALL)
    assert log_times(tmp_path / "a") == [("/d", 0), ("/p", 0), ("/q", 0), ("/p", 500), ("/d", 500)]


def test_graph_that_is_silent_for_long_before_its_first_stamp_still_has_one_clock(tmp_path):
    for name, stamp in (("pass", 0), ("wall", WALL)):
        writer = opened(tmp_path / name, "/s", "/p")
        writer.write("/s", text("description"), WALL - 1)
        writer.tick(10.0)
        writer.tick(10.0 + module.HOLD_PERIOD)
        assert writer.count == 1
        for later in (0, 600):
            writer.write("/p", raw(pose(stamp + later, NUMBERS)), WALL)
        writer.close()
        assert log_times(tmp_path / name) == [("/s", 0), ("/p", 0), ("/p", 600)]


def test_graph_without_any_stamps_is_recorded_by_the_wall_clock_and_a_kill_loses_little_of_it(tmp_path):
    writer = opened(tmp_path / "a", "/s")
    for tenth in range(11):
        writer.write("/s", text(str(tenth)), WALL + tenth)
        writer.tick(0.1 * tenth)
    times = [time for _, time in log_times(tmp_path / "a")]  # on the disk before the end
    assert times == [WALL + tenth for tenth in range(len(times))] and len(times) >= 8
    writer.close()
    assert len(log_times(tmp_path / "a")) == 11


def test_what_waits_for_a_stamp_is_bounded_and_nothing_of_it_is_lost(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "HOLD_SIZE", 1000)
    with opened(tmp_path / "a", "/s") as writer:
        for number in range(40):
            writer.write("/s", text(f"{number:080}"), WALL + number)
        assert writer.count == 40
    assert log_times(tmp_path / "a") == [("/s", WALL + number) for number in range(40)]


def test_stamps_a_little_apart_are_of_one_clock_and_years_apart_of_two():
    times = LogTimes()
    assert times.of(POSE, 10, WALL) == 10
    assert times.of(POSE, 10 + YEAR - 1, WALL) == 9 + YEAR
    assert times.of(POSE, 10, WALL) == 10
    assert times.of(POSE, 3 * YEAR, WALL) == 9 + YEAR


def count(stamps, period=None) -> GapCounter:
    counter = GapCounter()
    counter.period_ns = period
    for stamp in stamps:
        counter.add(stamp)
    return counter.finish()


@given(st.sets(st.integers(1, 398), max_size=150), st.integers(1_000, 10**8), st.integers(0, 10**18))
def test_missing_messages_of_a_known_period_are_counted_exactly(dropped, period, begin):
    counter = count([begin + i * period for i in range(400) if i not in dropped], period)
    holes = sum(i - 1 not in dropped for i in dropped)
    assert (counter.missing, counter.gaps) == (len(dropped), holes)


@given(st.sets(st.integers(1, 398), max_size=30), st.integers(1_000, 10**8))
def test_a_learned_period_counts_the_same_also_for_what_was_missing_while_learning(dropped, period):
    counter = count([i * period for i in range(400) if i not in dropped])
    singles = [i for i in range(400) if i not in dropped][:21]
    if sum(b - a == 1 for a, b in zip(singles, singles[1:], strict=False)) > 10:  # most are the period itself
        assert (counter.period_ns, counter.missing) == (period, len(dropped))


def test_jitter_below_half_a_period_is_no_gap():
    stamps = [i * 1000 + (i * 7919) % 240 for i in range(200)]
    assert count(stamps, 1000).missing == 0
    assert count([s for i, s in enumerate(stamps) if i not in (50, 120, 121)], 1000).missing == 3


def test_a_series_without_period_has_no_gaps():
    counter = count([i**3 for i in range(100)])
    assert (counter.missing, counter.gaps, counter.as_dict()["period_ns"]) == (0, 0, None)


def test_repeated_and_backward_stamps_are_counted_on_their_own():
    counter = count([0, 10, 20, 20, 10, 30, 40, 70], 10)
    assert (counter.repeated, counter.backwards, counter.missing, counter.gaps) == (1, 1, 2, 1)


def test_a_latched_message_that_is_received_again_is_not_repeated():
    counter = GapCounter(latched=True)
    for stamp in (5, 5, 5, 9, 9):
        counter.add(stamp)
    assert counter.finish().repeated == 0


def test_a_gap_in_which_the_series_continues_belongs_to_another_publisher():
    """Stamps ahead, of a publisher with another period; then the series has a real gap of two."""
    own = [i * 10 for i in range(100) if i not in (60, 61)]
    mixed = [stamp for i, one in enumerate(own) for stamp in ([one, 5_000 + 37 * i] if 25 <= i < 80 else [one])]
    counter = count(mixed, 10)
    assert (counter.missing, counter.gaps) == (2, 1)


@pytest.mark.parametrize("number", range(4))
def test_fewer_than_three_differences_say_nothing(number):
    assert count([i * 10 for i in range(number)]).period_ns in (None, 0)
    assert count([0, 10, 20, 30, 60]).missing == 2


@given(st.sets(st.integers(1, 398), max_size=150), st.sets(st.integers(1, 398), max_size=150))
def test_a_second_pass_is_counted_like_the_first(first, second):
    stamps = [i * 10 for dropped in (first, second) for i in range(400) if i not in dropped]
    counter = count(stamps, 10)
    assert (counter.missing, counter.backwards) == (len(first) + len(second), 0)


FOREVER = QosTime(9223372036, 854775807)
ONE_LATCHED = Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, FOREVER, FOREVER,
                  QosLiveliness.AUTOMATIC, FOREVER, False)  # fmt: skip


def test_a_profile_is_what_rosbags_writes_and_reads():
    profile = {"depth": 1, "durability": "transient_local"}
    assert [describe_qos(profile)] == dump_qos_v9([ONE_LATCHED])
    assert parse_qos(qos_text([profile])) == [ONE_LATCHED]


def test_a_profile_object_of_rclpy_is_described():
    qos = pytest.importorskip("rclpy.qos", reason="rclpy is not installed")
    profile = qos.QoSProfile(depth=7, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
    actual = describe_qos(profile)
    assert (actual["history"], actual["depth"], actual["durability"]) == ("keep_last", 7, "transient_local")
    assert list(actual) == list(DEFAULT_QOS)
    assert actual["deadline"] == dict(sec=0, nsec=0)
    assert yaml.safe_load(qos_text([profile])) == [actual]


def test_a_misspelt_policy_is_refused():
    with pytest.raises(KeyError, match="durabilty"):
        describe_qos({"durabilty": "volatile"})


def test_durations_are_given_in_nanoseconds_or_as_they_stand():
    assert describe_qos({"deadline": 1_500_000_000})["deadline"] == dict(sec=1, nsec=500_000_000)
    assert describe_qos({"deadline": dict(sec=2, nsec=3)})["deadline"] == dict(sec=2, nsec=3)
    lease = SimpleNamespace(nanoseconds=4)
    assert describe_qos({"liveliness_lease_duration": lease})["liveliness_lease_duration"] == dict(sec=0, nsec=4)


@pytest.mark.parametrize("text", ["", "3", "[1, 2]", "a: b", "{", "!!python/object:os.system x", "[" * 5000])
def test_foreign_text_in_place_of_profiles_is_no_profile(text):
    assert read_qos(text) == []


def test_what_rosbag2_of_other_versions_writes_is_read():
    deadline = "deadline:\n    sec: 9223372036\n    nsec: 854775807"
    older = f"- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  {deadline}"
    assert read_qos(older)[0]["deadline"] == dict(sec=9223372036, nsec=854775807)


def test_memory_of_the_writer_stays_flat(tmp_path):
    import tracemalloc

    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/p", POSE)
        data = raw(pose(0, np.arange(7)))
        peaks = []
        tracemalloc.start()
        for part in range(3):
            for i in range(15_000):
                writer.write("/p", data, 0, log_time=part * 10**9 + i)
            peaks.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert peaks[2] - peaks[1] < 2_000_000  # between zero and one chunk of 1 MB and its index are waiting
