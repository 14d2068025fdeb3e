"""Output directories appear as a whole or not at all."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import staged


def names(folder) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def test_files_appear_when_the_block_has_ended_and_replace_older_ones(tmp_path):
    out = tmp_path / "deep" / "out"
    out.mkdir(parents=True)
    (out / "old.txt").write_text("stays")
    (out / "a.txt").write_text("is replaced")
    with staged(out) as (draft, final):
        (draft / "a.txt").write_text("new")
        (draft / "sub").mkdir()
        (draft / "sub" / "b.txt").write_text("b")
        assert final(draft / "sub" / "b.txt") == out / "sub" / "b.txt"
        assert (out / "a.txt").read_text() == "is replaced" and not (out / "sub").exists()
    assert names(tmp_path) == ["deep", "deep/out", "deep/out/a.txt", "deep/out/old.txt", "deep/out/sub",
                               "deep/out/sub/b.txt"]  # fmt: skip
    assert (out / "a.txt").read_text() == "new"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, InputError])
def test_after_an_error_everything_is_as_it_was(tmp_path, error):
    with pytest.raises(error), staged(tmp_path / "out") as (draft, _):
        (draft / "half.txt").write_text("half")
        raise error("x", "y")
    assert names(tmp_path) == []


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_after_an_error_a_directory_that_was_there_is_as_it_was(tmp_path, error):
    (tmp_path / "old.txt").write_text("stays")
    with pytest.raises(error), staged(tmp_path) as (draft, _):
        (draft / "half.txt").write_text("half")
        (draft / "old.txt").write_text("new")
        raise error
    assert names(tmp_path) == ["old.txt"] and (tmp_path / "old.txt").read_text() == "stays"


@pytest.mark.skipif(not os.path.ismount("/dev/shm"), reason="no mount point that everybody may write into")
def test_mount_point_can_be_written_into():
    """A mounted stick, or the directory of a container: nothing can be renamed into it from outside."""
    place = Path("/dev/shm", f"kr270_milling_staging_{os.getpid()}.txt")
    try:
        with staged("/dev/shm") as (draft, final):
            (draft / place.name).write_text("whole")
            assert final(draft / place.name) == place and not place.exists()
        assert place.read_text() == "whole" and not draft.exists()
    finally:
        place.unlink(missing_ok=True)


def test_directory_in_a_place_that_is_not_ours_is_enough(tmp_path):
    """No draft beside it, where its owner may not be allowed to make one."""
    out = tmp_path / "out"
    out.mkdir()
    with staged(out) as (draft, _):
        (draft / "a.txt").touch()
        assert os.listdir(tmp_path) == ["out"]
    assert os.listdir(out) == ["a.txt"]


def test_permissions_are_those_of_ordinary_files(tmp_path):
    old = os.umask(0o022)
    try:
        with staged(tmp_path / "out") as (draft, _):
            (draft / "sub").mkdir()
            (draft / "sub" / "a.txt").touch()
    finally:
        os.umask(old)
    for path, mode in ((tmp_path / "out", 0o755), (tmp_path / "out/sub", 0o755), (tmp_path / "out/sub/a.txt", 0o644)):
        assert stat.S_IMODE(path.stat().st_mode) == mode


def test_a_link_does_not_lead_out_of_the_directory(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "sub").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="not a link"), staged(tmp_path / "out") as (draft, _):
        (draft / "sub").mkdir()
        (draft / "sub" / "a.txt").touch()
        (draft / "first.txt").touch()
    assert names(tmp_path) == ["elsewhere", "out", "out/sub"]


def test_a_linked_file_is_replaced_and_what_it_leads_to_is_not(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a.txt").symlink_to(tmp_path / "precious")
    with staged(tmp_path / "out") as (draft, _):
        (draft / "a.txt").write_text("new")
    assert (tmp_path / "precious").read_text() == "precious" and (tmp_path / "out" / "a.txt").read_text() == "new"


def test_a_file_or_a_forbidden_place_is_refused_before_any_work(tmp_path):
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "out", "/proc/no/such"):
        with pytest.raises((InputError, OSError)), staged(place):
            pytest.fail("the block was entered")
