"""Output directories and text files appear as a whole or not at all; input that is no text is refused with its line."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import read_lines, staged, unended, write_failure, write_files


def names(folder) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def test_files_appear_when_the_block_has_ended_and_replace_older_ones(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "precious").write_text("precious")
    (out / "old.txt").write_text("stays")
    (out / "a.txt").symlink_to(tmp_path / "precious")  # a link is replaced, and its target is not
    with staged(out) as (draft, final):
        assert "out" in draft.parts  # its parent may be a place where the user may not write
        (draft / "a.txt").write_text("new")
        (draft / "sub").mkdir()
        (draft / "sub" / "b.txt").write_text("b")
        assert final(draft / "sub" / "b.txt") == out / "sub" / "b.txt"
        assert (out / "a.txt").read_text() == "precious" and not (out / "sub").exists()
    assert names(tmp_path) == ["out", "out/a.txt", "out/old.txt", "out/sub", "out/sub/b.txt", "precious"]
    assert (out / "a.txt").read_text() == "new" and (tmp_path / "precious").read_text() == "precious"


def test_ctrl_c_while_the_folder_is_made_leaves_nothing(tmp_path, monkeypatch):
    opened = os.open

    def interrupted(*_):
        monkeypatch.setattr(os, "open", opened)  # by which the draft is removed
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "open", interrupted)
    with pytest.raises(KeyboardInterrupt), staged(tmp_path / "out"):
        pass
    assert names(tmp_path) == []


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("before", [[], ["old.txt"]])
def test_after_an_error_everything_is_as_it_was(tmp_path, error, before):
    for name in before:
        (tmp_path / name).write_text("stays")
    with pytest.raises(error), staged(tmp_path if before else tmp_path / "out") as (draft, _):
        (draft / "half.txt").write_text("half")
        (draft / "old.txt").write_text("new")
        raise error
    assert names(tmp_path) == before and all((tmp_path / name).read_text() == "stays" for name in before)


def test_a_second_run_in_one_directory_is_refused_until_the_first_one_ends_or_is_killed(tmp_path):
    """The first run is another process, which SIGKILL ends: the system unlocks, no file remains."""
    out = tmp_path / "out"
    code = "import sys, time; from kr270_milling.base.files import staged\n"
    code += "with staged(sys.argv[1]): print(flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code, out], stdout=subprocess.PIPE) as first:
        first.stdout.readline()
        with pytest.raises(InputError, match="another run writes into it"), staged(out):
            pytest.fail("the block was entered")
        first.kill()
    with staged(out) as (draft, _):
        (draft / "a.txt").touch()
    assert names(out) == ["a.txt"]


@pytest.mark.skipif(not os.path.ismount("/dev/shm"), reason="no mount point that everybody may write into")
def test_mount_point_can_be_written_into():
    """A mounted stick, or the directory of a container: nothing can be renamed into it from outside."""
    place = Path("/dev/shm", f"kr270_milling_staging_{os.getpid()}.txt")
    try:
        with staged("/dev/shm") as (draft, _):
            (draft / place.name).write_text("whole")
        assert place.read_text() == "whole" and not draft.exists()
    finally:
        place.unlink(missing_ok=True)


def test_a_link_does_not_lead_out_of_the_directory(tmp_path):
    out = tmp_path / "out"
    for folder in (out, tmp_path / "elsewhere"):
        folder.mkdir()
    (out / "sub").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="not a link"), staged(out) as (draft, _):
        (draft / "sub").mkdir()
        (draft / "sub" / "a.txt").touch()
        (draft / "first.txt").touch()
    assert names(tmp_path) == ["elsewhere", "out", "out/sub"]


def test_a_full_disk_is_named_with_its_size_and_a_closed_folder_with_a_remedy(tmp_path):
    with (
        pytest.raises(InputError, match=r"No space left on device: [\d.]+ MB of [\d.]+ GB are free"),
        staged(tmp_path / "o"),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    closed = OSError(errno.EROFS, os.strerror(errno.EROFS))
    assert write_failure(closed, tmp_path / "o") == "Read-only file system; choose another folder with --out"


def test_a_set_of_files_appears_whole_or_not_at_all(tmp_path):
    def breaks():
        yield "first line\n"
        raise OSError(28, "No space left on device")

    (tmp_path / "b").write_text("old")
    with pytest.raises(InputError, match="No space left"):
        write_files({tmp_path / "a": ["new\n"], tmp_path / "b": breaks()})
    assert names(tmp_path) == ["b"] and (tmp_path / "b").read_text() == "old"
    (tmp_path / f".a.{os.getpid()}.part").symlink_to(tmp_path / "b")  # a link at the name of the draft
    write_files({tmp_path / "a": ["1\n", "2\n"]}, newline="\r\n")
    assert (tmp_path / "a").read_bytes() == b"1\r\n2\r\n" and (tmp_path / "b").read_text() == "old"
    assert names(tmp_path) == ["a", "b"]
    write_files({tmp_path / "new" / "a": ["x"]})
    assert (tmp_path / "new" / "a").read_text() == "x"
    with pytest.raises(InputError, match="cannot be written"):  # below a file
        write_files({tmp_path / "a" / "c": ["x"]})


@pytest.mark.parametrize(
    ("data", "line", "word"),
    [
        (b" \r\n\t\n", 1, "empty"),
        ("G0 X1\nG1 X2\n".encode("utf-16"), 1, "UTF-16"),
        ("G0 X1\nG1 X2\n".encode("utf-16-be"), 1, "zero byte"),
        (b"G0\n\n\nG1 \x00\n", 4, "zero byte"),
        (b"G0\n(" + 4096 * b"a" + b")\n", 2, "the line has 4098 characters, more than 4096"),
    ],
)
def test_what_is_no_text_is_refused_with_its_first_bad_line_and_every_line_end_is_read(tmp_path, data, line, word):
    path = tmp_path / "x.nc"
    path.write_bytes(data)
    with pytest.raises(InputError, match=word) as caught:
        read_lines(path)
    assert caught.value.line == line and "\n" not in str(caught.value)
    path.write_bytes(b"\xef\xbb\xbfa\r\nb\rc\nd\n")  # every kind of line end, and a byte order mark
    lines = read_lines(path)
    assert lines == ["a", "b", "c", "d", ""] and unended(lines) == ""
    for encoding in ("utf-8", "latin-1"):
        path.write_bytes("G0 X1 (Müller)\r\n".encode(encoding))
        assert read_lines(path) == ["G0 X1 (Müller)", ""]
    assert "cut off" in unended(["G0 X0", "G1 X1"])
