"""Tool paths from CSV."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.base.frames import rotation_from_abc, rotation_from_quaternion
from kr270_milling.path.cam.readers import read_points

HEADER = "x_mm,y_mm,z_mm,feed_mm_per_min\n"


@pytest.fixture
def read(tmp_path):
    def read(text: str):
        (tmp_path / "part.csv").write_text(text)
        return read_points(tmp_path / "part.csv")

    return read


def test_points_and_feeds_are_read_in_their_units(read):
    path = read(HEADER + "0,0,0,600\n\n1,2,3,1200\n")
    np.testing.assert_allclose(path.position, [[0, 0, 0], [0.001, 0.002, 0.003]])
    np.testing.assert_allclose(path.feed, [0.01, 0.02])
    assert path.line.tolist() == [2, 4] and path.rapid.tolist() == [True, False]
    other = read("feed_m_per_min, z_m, y_m, x_m\n0.6,0,0,0\n1.2,0.003,0.002,0.001\n")
    np.testing.assert_allclose(other.position, path.position)
    np.testing.assert_allclose(other.feed, path.feed)


def test_kuka_angles_turn_the_tool(read):
    path = read("x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,feed_mm_per_min\n0,0,0,0,0,180,60\n1,0,0,10,20,150,60\n")
    expected = rotation_from_abc(np.radians([[0, 0, 180], [10, 20, 150]]))
    np.testing.assert_allclose(rotation_from_quaternion(path.quaternion), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ("x,y,z,feed\n0,0,0,1\n", 1, "x_mm"),
        ("0,0,0,600\n1,0,0,600\n", 1, "not a known column"),
        ("x_mm;y_mm;z_mm;feed_mm_per_min\n0;0;0;1\n", 1, "not a known column"),
        ("x_mm,y_mm,z_mm\n0,0,0\n", 1, "header must be"),
        ("x_mm,x_mm,y_mm,z_mm,feed_mm_per_min\n", 1, "x_mm"),
        (HEADER + "0,0,0,600\n1,0,0\n", 3, "3 values"),
        (HEADER + "0,0,0,600\n1,0,nan,600\n", 3, "z_mm is not finite"),
        (HEADER + "0,0,0,600\n1,0,1_0,600\n", 3, "1_0"),
        (HEADER + "0,0,0,600\n1,0,0,0\n", 3, "zero feed"),
        (HEADER + "0,0,0,600\n1,0,0,-1\n", 3, "out of range"),
        (HEADER + "0,0,0,600\n1e9,0,0,600\n", 3, "wrong unit"),
        (HEADER + "0,0,0,600\n1,0,0,600", 3, "cut off"),
        (HEADER + "1,0,0,600\n1,0,0,600\n", 2, "never moves"),
        (HEADER, 1, "no row"),
    ],
)
def test_what_cannot_be_run_is_refused_with_line_and_word(read, text, line, word):
    with pytest.raises(InputError, match=word) as caught:
        read(text)
    assert caught.value.line == line
