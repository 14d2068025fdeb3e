from __future__ import annotations

import os
import stat

import pytest

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.output import plain_name
from kr270_milling.recordings.bag.writer import BagWriter


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "/etc/passwd", "../x", "a\0b", "x" * 300])
def test_names_that_lead_elsewhere_are_refused(tmp_path, name):
    with pytest.raises(RecordingError):
        plain_name(tmp_path, name)


def test_a_link_in_place_of_the_directory_is_refused(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RecordingError):
        BagWriter(tmp_path / "out")
    assert not list((tmp_path / "elsewhere").iterdir())


def test_neither_a_link_nor_a_file_in_place_of_the_recording_is_written_through(tmp_path):
    victim = tmp_path / "victim.mcap"
    victim.write_text("mine")
    (tmp_path / "link.mcap").symlink_to(victim)
    for name in ("link", "victim"):
        with pytest.raises(RecordingError, match="exists already"):
            BagWriter(tmp_path, name)
    assert victim.read_text() == "mine"


def test_metadata_replaces_a_link_and_not_what_it_points_to(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    writer = BagWriter(tmp_path / "a")
    (tmp_path / "a" / "metadata.yaml").symlink_to(victim)
    writer.close()
    assert "rosbag2_bagfile_information" in (tmp_path / "a" / "metadata.yaml").read_text()
    assert victim.read_text() == "mine"
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["a.mcap", "metadata.yaml"]


def test_files_have_the_permissions_that_the_user_asks_for(tmp_path):
    old = os.umask(0o027)
    try:
        BagWriter(tmp_path / "out", "a").close()
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o750
    assert stat.S_IMODE((tmp_path / "out" / "a.mcap").stat().st_mode) == 0o640
    assert stat.S_IMODE((tmp_path / "out" / "metadata.yaml").stat().st_mode) == 0o640
