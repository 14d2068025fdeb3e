"""Text files: what is no text is refused with its line, what is written is written whole."""

from __future__ import annotations

import os

import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.base.text import read_lines, unended


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
