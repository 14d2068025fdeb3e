"""Several passes in one recording, as when the nodes are started again while the recorder runs."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from player_listener import options
from test_recording_samples import DIAGNOSTICS, PERIOD, POSE, TEXT, WRENCH, header, make, pose, raw, record, wrench

from kr270_milling.recordings.bag.export import export
from kr270_milling.recordings.bag.info import info
from kr270_milling.recordings.bag.playback import opening, pass_spans, passage, span
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import series
from kr270_milling.recordings.bag.writer import BagWriter

STEPS = 200
LATCHED = [{"durability": "transient_local", "depth": 1}]


def status(stamp: int) -> bytes:
    return raw(make(DIAGNOSTICS, header(stamp), []))


def write(directory, passes: int = 2, dropped=(), chunk_size: int = 5000) -> Recording:
    """Every pass: a text, then poses and wrenches, numbered on; dropped: (pass, step) of wrenches that are not there.

    A node that keeps no time of its own reports with the stamp 0 all the while.
    """
    with BagWriter(directory, chunk_size=chunk_size) as writer:
        for topic, kind in {"/tool_pose": POSE, "/wrench": WRENCH, "/diagnostics": DIAGNOSTICS}.items():
            writer.add_topic(topic, kind)
        writer.add_topic("/said", TEXT, LATCHED)
        for number in range(passes):
            for step in range(STEPS):
                stamp = step * PERIOD
                writer.write("/tool_pose", raw(pose(stamp, np.full(7, number * STEPS + step))), 1)
                if (number, step) not in dropped:
                    writer.write("/wrench", raw(wrench(stamp, np.full(6, number * STEPS + step))), 1)
                if step == 5:
                    writer.write("/said", raw(make(TEXT, f"pass {number}")), 1)
                if step % 20 == 0:
                    writer.write("/diagnostics", status(0), 1)
        report = writer.report()
    recording = Recording(directory)
    assert report["/wrench"]["missing"] == len(dropped)
    return recording


def played(recording: Recording, *words: str) -> list:
    topics = set(recording.topics())
    start, end = span(recording, options(str(recording.path), *words))
    return [*opening(recording, start, topics), *passage(recording, start, end, topics)]


def test_what_is_missing_in_the_second_pass_is_counted_also_where_the_first_has_it(tmp_path):
    dropped = {(1, step) for step in range(50, 150)}
    with write(tmp_path / "a", dropped=dropped) as recording:
        found = info(recording)
    assert found["missing"] == 100
    about = found["topics"]["/wrench"]
    assert (about["gaps"]["gaps"], about["gaps"]["backwards"], about["gaps"]["repeated"]) == (1, 0, 0)


def test_the_rate_of_a_topic_is_that_of_each_pass(tmp_path):
    with write(tmp_path / "a", 3) as recording:
        assert info(recording)["topics"]["/tool_pose"]["rate_hz"] == pytest.approx(2000.0)


def test_a_text_of_the_second_pass_has_the_time_of_the_second_pass(tmp_path):
    with write(tmp_path / "a") as recording:
        assert [m.log_time for m in recording.messages(["/said"])] == [5 * PERIOD, 5 * PERIOD]


def test_series_and_tables_hold_one_pass_after_the_other(tmp_path):
    with write(tmp_path / "a") as recording:
        assert series(recording, "/wrench").values[:, 0].tolist() == list(range(2 * STEPS))
        (file,) = export(recording, tmp_path / "csv", ["/said"]).files
    with open(file, newline="") as stream:
        assert [row["data"] for row in csv.DictReader(stream)] == ["pass 0", "pass 1"]


def test_passes_are_played_one_after_the_other_at_their_pace(tmp_path):
    with write(tmp_path / "a", 3) as recording:
        found = [m for m in played(recording) if m.topic != "/diagnostics"]
        assert len(pass_spans(recording)) == 3
        sent = [m.data for m in recording.messages(["/tool_pose"], as_written=True)]
    poses = [m for m in found if m.topic == "/tool_pose"]
    assert [m.data for m in poses] == sent
    times = [m.log_time for m in found]
    assert times == sorted(times)
    one = (STEPS - 1) * PERIOD + 1  # a pass begins right behind the one before
    assert [m.log_time for m in poses] == [number * one + step * PERIOD for number in range(3) for step in range(STEPS)]


def test_an_offset_leads_into_a_later_pass_with_what_was_latched_before_it(tmp_path):
    one = (STEPS - 1) * PERIOD + 1
    with write(tmp_path / "a") as recording:
        found = played(recording, "--start-offset", str((one + 2 * PERIOD) * 1e-9), "--playback-duration", "0.001")
        said = [m.data for m in recording.messages(["/said"], as_written=True)]
    poses = [m for m in found if m.topic == "/tool_pose"]
    assert (found[0].topic, found[0].data) == ("/said", said[0])
    assert [m.log_time for m in poses] == [one + step * PERIOD for step in (2, 3, 4)]


def test_a_recording_on_another_clock_or_of_one_pass_is_one_part(tmp_path):
    record(tmp_path / "a", 30)
    with Recording(tmp_path / "a") as recording:
        assert len(pass_spans(recording)) == 1
        assert [m.data for m in played(recording)] == [m.data for m in recording.messages()]
    with BagWriter(tmp_path / "b") as writer:
        writer.add_topic("/tool_pose", POSE)
        for log_time in (5, 9, 7, 5, 8):
            writer.write("/tool_pose", raw(pose(0, np.zeros(7))), 1, log_time)
    with Recording(tmp_path / "b") as recording:
        assert [m.log_time for m in played(recording)] == [5, 5, 7, 8, 9]


def test_a_cut_off_file_of_two_passes_is_played_in_their_order(tmp_path):
    write(tmp_path / "a").close()
    whole = (tmp_path / "a" / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    with Recording(tmp_path / "cut.mcap") as recording:
        assert recording.cut_off and len(pass_spans(recording)) == 2
        sent = [m.data for m in recording.messages(["/tool_pose"])]
        assert [m.data for m in played(recording) if m.topic == "/tool_pose"] == sent and len(sent) > STEPS
