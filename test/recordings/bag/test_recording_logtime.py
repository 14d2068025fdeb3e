"""Log times of a recording: one clock, whatever came first."""

from __future__ import annotations

import numpy as np
from test_recording_samples import DIAGNOSTICS, PATH, POSE, TEXT, make, path, pose, raw

from kr270_milling.recordings.bag import writer as module
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.stamps import YEAR, LogTimes
from kr270_milling.recordings.bag.writer import BagWriter

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


def found(directory) -> list[tuple[str, int]]:
    """In the order of the file."""
    with Recording(directory) as recording:
        recording.cut_off = True
        return [(m.topic, m.log_time) for m in recording.messages()]


def test_messages_from_before_the_first_stamp_take_that_stamp_and_stay_in_their_order(tmp_path):
    with opened(tmp_path / "a", *KINDS) as writer:
        writer.write("/s", text("description"), WALL)
        writer.write("/t", at_once(), WALL + 1)
        writer.write("/d", report(0), WALL + 2)
        writer.write("/s", text("again"), WALL + 3)
        assert writer.count == 0
        writer.write("/p", raw(pose(500, NUMBERS)), WALL + 4)
    assert found(tmp_path / "a") == [("/s", 500), ("/t", 500), ("/d", 0), ("/s", 500), ("/p", 500)]


def test_recording_of_wall_clock_stamps_begins_with_the_first_of_them(tmp_path):
    with opened(tmp_path / "a", *KINDS) as writer:
        writer.write("/d", report(0), WALL)  # that of the recorder itself, which knows no time
        writer.write("/t", at_once(), WALL)
        writer.write("/p", raw(pose(WALL + 7, NUMBERS)), WALL + 8)
        writer.write("/d", report(0), WALL + 9)
    assert found(tmp_path / "a") == [(topic, WALL + 7) for topic in ("/d", "/t", "/p", "/d")]


def test_stamp_of_another_clock_does_not_make_the_recording_last_for_decades(tmp_path):
    with opened(tmp_path / "a", *KINDS) as writer:
        writer.write("/d", report(WALL), WALL)  # of a driver that is none of ours
        writer.write("/p", raw(pose(0, NUMBERS)), WALL)
        writer.write("/q", raw(pose(WALL + 2, NUMBERS)), WALL)
        writer.write("/p", raw(pose(500, NUMBERS)), WALL)
        writer.write("/d", report(WALL + 3), WALL)
    assert found(tmp_path / "a") == [("/d", 0), ("/p", 0), ("/q", 0), ("/p", 500), ("/d", 500)]


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
        assert found(tmp_path / name) == [("/s", 0), ("/p", 0), ("/p", 600)]


def test_graph_without_any_stamps_is_recorded_by_the_wall_clock_and_a_kill_loses_little_of_it(tmp_path):
    writer = opened(tmp_path / "a", "/s")
    for tenth in range(11):
        writer.write("/s", text(str(tenth)), WALL + tenth)
        writer.tick(0.1 * tenth)
    times = [time for _, time in found(tmp_path / "a")]  # as it stands on the disk
    assert times == [WALL + tenth for tenth in range(len(times))] and len(times) >= 8
    writer.close()
    assert len(found(tmp_path / "a")) == 11


def test_what_waits_for_a_stamp_is_bounded_and_nothing_of_it_is_lost(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "HOLD_SIZE", 1000)
    with opened(tmp_path / "a", "/s") as writer:
        for number in range(40):
            writer.write("/s", text(f"{number:080}"), WALL + number)
        assert writer.count == 40
    assert found(tmp_path / "a") == [("/s", WALL + number) for number in range(40)]


def test_stamps_a_little_apart_are_of_one_clock_and_years_apart_of_two():
    times = LogTimes()
    assert times.of(POSE, 10, WALL) == 10
    assert times.of(POSE, 10 + YEAR - 1, WALL) == 9 + YEAR
    assert times.of(POSE, 10, WALL) == 10
    assert times.of(POSE, 3 * YEAR, WALL) == 9 + YEAR
