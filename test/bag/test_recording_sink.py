from __future__ import annotations

import os
import stat

import pytest

from kr270_milling.bag.errors import RecordingError
from kr270_milling.bag.sink import Sink, open_directory, plain_name, write_new


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "/etc/passwd", "../x", "a\0b", "x" * 300])
def test_names_that_lead_elsewhere_are_refused(tmp_path, name):
    with pytest.raises(RecordingError):
        plain_name(tmp_path, name)


def test_a_link_in_place_of_the_directory_is_refused(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RecordingError):
        open_directory(tmp_path / "out")


def test_neither_a_link_nor_a_file_in_place_of_the_recording_is_written_through(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / "link").symlink_to(victim)
    handle = open_directory(tmp_path)
    for name in ("link", "victim"):
        with pytest.raises(RecordingError, match="exists already"):
            Sink(handle, tmp_path / name)
    os.close(handle)
    assert victim.read_text() == "mine"


def test_a_small_file_replaces_a_link_and_not_what_it_points_to(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / "metadata.yaml").symlink_to(victim)
    handle = open_directory(tmp_path)
    write_new(handle, tmp_path, "metadata.yaml", b"new")
    os.close(handle)
    assert (tmp_path / "metadata.yaml").read_bytes() == b"new"
    assert victim.read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["metadata.yaml", "victim"]


def test_files_have_the_permissions_that_the_user_asks_for(tmp_path):
    old = os.umask(0o027)
    try:
        handle = open_directory(tmp_path / "out")
        Sink(handle, tmp_path / "out" / "a").close()
        os.close(handle)
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o750
    assert stat.S_IMODE((tmp_path / "out" / "a").stat().st_mode) == 0o640
