from __future__ import annotations

import json

import numpy as np
import pytest
from test_recording_samples import PERIOD, POSE, TOPICS, pose, raw, record

from kr270_milling.base.version import __version__
from kr270_milling.recordings.bag.info import info, info_text
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter


def test_info_counts_what_was_written(tmp_path):
    written = record(tmp_path / "a", 30, attachments={"cell.yaml": "a: 1\n"}, metadata={"seed": 7})
    with Recording(tmp_path / "a") as recording:
        data = info(recording)
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


def test_info_counts_gaps(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/tool_pose", POSE)
        for step in (s for s in range(200) if s not in (60, 61, 150)):
            writer.write("/tool_pose", raw(pose(step * PERIOD, np.zeros(7))), 0)
    with Recording(tmp_path / "a") as recording:
        data = info(recording)
    assert data["missing"] == 3 and data["topics"]["/tool_pose"]["gaps"]["gaps"] == 2
    assert "3 missing in 2 gaps" in info_text(data)


def test_text_says_that_a_file_was_cut_off(tmp_path):
    record(tmp_path / "a", 30, chunk_size=5000)
    whole = (tmp_path / "a" / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 4])
    with Recording(tmp_path / "cut.mcap") as recording:
        data = info(recording)
    assert 0 < data["messages"] < 300
    assert "cut off" in info_text(data)


def test_an_empty_recording_has_no_times(tmp_path):
    BagWriter(tmp_path / "a").close()
    with Recording(tmp_path / "a") as recording:
        data = info(recording)
    assert (data["messages"], data["start_ns"], data["duration_s"], data["topics"]) == (0, None, 0.0, {})
    assert "0 messages" in info_text(data)


def test_text_of_a_foreign_file_does_not_steer_the_terminal(tmp_path):
    with BagWriter(tmp_path / "a", metadata={"note": "\x1b[2Jgone\nsecond"}) as writer:
        writer.add_metadata("\x07bell", {"a": "b"})
    with Recording(tmp_path / "a") as recording:
        text = info_text(info(recording))
    assert "\x1b" not in text and "\x07" not in text and "\\x1b[2Jgone\\nsecond" in text
