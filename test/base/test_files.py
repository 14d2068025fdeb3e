"""Output directories and text files appear as a whole or not at all; input that is no text is refused with its line."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import staged, write_files
from kr270_milling.base.text import read_lines, unended


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


# --- Text files ---
@pytest.mark.parametrize(
    ("data", "line", "word"),
    [
        (b"", 1, "empty"),
        (b" \r\n\t\n", 1, "empty"),
        ("G0 X1\nG1 X2\n".encode("utf-16"), 1, "UTF-16"),
        ("G0 X1\nG1 X2\n".encode("utf-16-be"), 1, "zero byte"),
        (b"G0 X1\r\nG1 X2 (Gr\xf6\xdfe)\r\n", 2, "0xf6"),
        (b"G0\n\n\nG1 \x00\n", 4, "zero byte"),
        (b"\x7fELF\x02\x01\x01\x00", 1, "zero byte"),
    ],
)
def test_what_is_no_text_is_refused_with_its_first_bad_line(tmp_path, data, line, word):
    path = tmp_path / "x.nc"
    path.write_bytes(data)
    with pytest.raises(InputError, match=word) as caught:
        read_lines(path)
    assert caught.value.line == line and "\n" not in str(caught.value)


def test_every_kind_of_line_end_and_a_byte_order_mark_are_read(tmp_path):
    path = tmp_path / "x.nc"
    path.write_bytes(b"\xef\xbb\xbfa\r\nb\rc\nd\n")
    assert read_lines(path) == ["a", "b", "c", "d", ""]


def test_a_missing_file_a_directory_and_a_pipe_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "none.nc", tmp_path, tmp_path / "pipe", "a\0b"):
        with pytest.raises(InputError):
            read_lines(path)


def test_a_last_line_without_an_end_is_taken_for_a_cut_off_file():
    assert "cut off" in unended(["G0 X0", "G1 X1"])
    assert unended(["G0 X0", ""]) == ""


def test_a_set_of_files_appears_whole_or_not_at_all(tmp_path):
    def breaks():
        yield "first line\n"
        raise OSError(28, "No space left on device")

    (tmp_path / "b").write_text("old")
    with pytest.raises(InputError, match="No space left"):
        write_files({tmp_path / "a": ["new\n"], tmp_path / "b": breaks()})
    assert [p.name for p in tmp_path.iterdir()] == ["b"] and (tmp_path / "b").read_text() == "old"
    write_files({tmp_path / "a": ["1\n", "2\n"], tmp_path / "b": ["new\n"]}, newline="\r\n")
    assert (tmp_path / "a").read_bytes() == b"1\r\n2\r\n" and len(list(tmp_path.iterdir())) == 2


def test_written_files_have_ordinary_permissions(tmp_path):
    write_files({tmp_path / "a": ["x"]})
    (tmp_path / "plain").write_text("x")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_directory_that_does_not_exist_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_files({tmp_path / "none" / "a": ["x"]})
