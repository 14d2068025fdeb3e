"""One door for all files: the reader by the name, and no input that breaks it."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from budget import budget
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kr270_milling.base.errors import InputError
from kr270_milling.path.cam.readers import READERS, read_path_file, read_toolpath
from kr270_milling.path.toolpath import REACH, Toolpath
from kr270_milling.path.trajectory_csv import read_csv

VALID = {
    ".nc": b"G21 G90 (a)\nG0 X0 Y0 Z0\nG1 X1 F100\nG2 X5 Y4 I4 J0\nG3 X0 Y0 R6\nG91 G20 G1 X-.5\nM30\n",
    ".apt": b"UNITS/MM\nGOTO/0,0,0\nFEDRAT/100,MMPM\nRAPID\nGOTO/1,2,3,0,0,1\nGOTO/1,$\n5,3\n$$ a\nFINI\n",
    ".csv": b"x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,feed_mm_per_min\n0,0,0,0,0,180,1\n1,0,1,0,0,180,60\n",
}
WORDS = [b"G0", b"G1", b"G2", b"G3", b"G20", b"G91", b"X1", b"Y-2", b"Z.5", b"I1", b"J-1", b"R5", b"R-1e9", b"F100",
         b"F0", b"S1", b"M3", b"M30", b"\n", b" ", b"(a)", b"(", b";", b"%", b"GOTO/", b"0,0,0", b",1", b"FEDRAT/5",
         b"RAPID", b"$", b"$$ b", b"UNITS/INCHES", b"FINI", b"SPINDL/", b"nan", b"-inf", b"1e999", b"9" * 400,
         b"x_mm,y_mm,z_mm,feed_mm_per_min", b"\xff", b"\0", "\u0663".encode(), "\u2028".encode(), b"\r"]  # fmt: skip
quick = settings(deadline=10_000, max_examples=budget(300), suppress_health_check=[HealthCheck.function_scoped_fixture])


def check(path: Path, data: bytes) -> None:
    """The file is refused in one sentence, or is a path that a machine could run."""
    path.write_bytes(data)
    try:
        toolpath = read_toolpath(path)
    except InputError as error:
        assert str(error).isprintable() and len(str(error)) < 2000 + len(str(path))
        assert error.line is not None and 1 <= error.line <= data.count(b"\n") + data.count(b"\r") + 1
        return
    assert isinstance(toolpath, Toolpath) and np.abs(toolpath.position).max() <= REACH
    assert toolpath.length > 0 and np.all(toolpath.rapid[1:] | (toolpath.feed[1:] > 0))
    assert np.all(np.diff(toolpath.line) >= 0)


def test_the_whole_examples_are_read_under_every_name_of_their_kind(tmp_path):
    kinds = {READERS[suffix]: data for suffix, data in VALID.items()}
    for suffix, reader in READERS.items():
        if reader.recorded:
            continue
        (tmp_path / f"part{suffix.upper()}").write_bytes(kinds[reader])
        assert len(read_toolpath(tmp_path / f"part{suffix.upper()}")) >= 2


@pytest.mark.parametrize("suffix", VALID)
@quick
@given(data=st.binary(max_size=300))
def test_bytes_at_random_are_refused_or_read(tmp_path, suffix, data):
    check(tmp_path / f"x{suffix}", data)


@pytest.mark.parametrize("suffix", VALID)
@quick
@given(words=st.lists(st.sampled_from(WORDS), max_size=40))
def test_words_in_any_order_are_refused_or_read(tmp_path, suffix, words):
    check(tmp_path / f"x{suffix}", b"".join(words))


@pytest.mark.parametrize("suffix", VALID)
@quick
@given(data=st.data())
def test_a_file_with_a_spoilt_byte_or_a_missing_end_is_refused_or_read(tmp_path, suffix, data):
    whole = VALID[suffix]
    at = data.draw(st.integers(0, len(whole) - 1))
    check(tmp_path / f"x{suffix}", whole[:at] + data.draw(st.binary(max_size=2)) + whole[at + 1 :])
    check(tmp_path / f"y{suffix}", whole[:at])


@pytest.mark.parametrize("suffix", VALID)
def test_a_file_cut_off_within_a_line_is_never_taken_for_whole(tmp_path, suffix):
    whole = VALID[suffix].rstrip(b"\n")
    ending = whole.rindex(b"\n")  # the last line of G-code and APT only says that the program ends
    for at in range(1, ending if suffix != ".csv" else len(whole)):
        if whole[at - 1 : at] == b"\n":
            continue
        (tmp_path / f"x{suffix}").write_bytes(whole[:at])
        with pytest.raises(InputError):
            read_toolpath(tmp_path / f"x{suffix}")


@quick
@given(data=st.binary(max_size=200))
def test_a_trajectory_file_of_random_bytes_is_refused(tmp_path, data):
    (tmp_path / "x.csv").write_bytes(data)
    with pytest.raises(InputError):
        read_csv(tmp_path / "x.csv")


@pytest.mark.parametrize("suffix", VALID)
@pytest.mark.parametrize("line", [b"(" * 50_000, b"X1" * 25_000, b"9" * 250_000, b" " * 250_000 + b"x", b"$\n" * 9999])
def test_long_lines_take_no_time(tmp_path, suffix, line):
    began = time.process_time()
    check(tmp_path / f"x{suffix}", line + b"\n")
    assert time.process_time() - began < 5  # a reader that backtracks would take hours


def test_another_kind_of_file_is_refused_by_its_name(tmp_path):
    with pytest.raises(InputError, match=r"\.nc"):
        read_toolpath(tmp_path / "part.step")


def test_a_tool_of_a_file_without_tools_and_a_recording_as_a_program_are_refused(tmp_path):
    with pytest.raises(InputError, match="a CSV of points has no tools, so T1 cannot be chosen"):
        read_path_file(tmp_path / "points.csv", tool="T1")
    with pytest.raises(InputError, match="a recording has no tools"):
        read_path_file(tmp_path / "run.mcap", tool="T1")
    with pytest.raises(InputError, match="is a recording, not a program"):
        read_toolpath(tmp_path / "run.mcap")
