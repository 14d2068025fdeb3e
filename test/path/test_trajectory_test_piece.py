"""The shipped test piece has the dimensions that its comments claim."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kr270_milling.path.cam.readers import read_toolpath
from kr270_milling.path.timing import Timing, time_path

FILE = Path(__file__).parents[2] / "config" / "test_piece.nc"
CUTTER = 10.0  # mm, radius
STOCK = 50.0  # mm, half of its side


@pytest.fixture(scope="module")
def piece():
    return read_toolpath(FILE)


def cuts(piece, feature: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts and ends [mm], (m, 3), and curvatures [1/mm] of the cutting blocks of a feature."""
    k = np.flatnonzero((piece.feature == piece.features.index(feature)) & ~piece.rapid)
    return piece.position[k - 1] * 1e3, piece.position[k] * 1e3, piece.curvature[k] * 1e-3


def lines(piece, feature: str) -> list[tuple[np.ndarray, float]]:
    """Outward normal, (2,), and distance from the origin of the wall [mm] that each straight cut leaves."""
    start, end, curvature = cuts(piece, feature)
    walls = []
    for a, b in zip(start[curvature == 0, :2], end[curvature == 0, :2], strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        left = np.array([-along[1], along[0]])  # the part is on the right of a tool that runs clockwise
        walls.append((left, left @ a - CUTTER))
    return walls


def test_the_square_is_80_mm_wide_and_its_sides_are_parallel_to_the_axes(piece):
    walls = lines(piece, "square")
    assert {tuple(np.round(n).astype(int)) for n, _ in walls} == {(1, 0), (-1, 0), (0, 1), (0, -1)}
    for normal, distance in walls:
        assert np.abs(normal).max() == pytest.approx(1, abs=1e-12) and distance == pytest.approx(40, abs=1e-9)
    assert set(cuts(piece, "square")[1][:, 2]) == {-1.2}


def test_the_corners_of_the_square_are_rolled_round_with_the_radius_of_the_cutter(piece):
    start, _, curvature = cuts(piece, "square")
    corners = start[curvature != 0, :2]
    np.testing.assert_allclose(np.linalg.norm(np.abs(corners) - 40, axis=1), CUTTER, atol=1e-9)
    np.testing.assert_allclose(curvature[curvature != 0], -1 / CUTTER)


def test_the_circle_has_a_diameter_of_54_mm_and_is_closed(piece):
    start, end, curvature = cuts(piece, "circle")
    arc = curvature != 0
    np.testing.assert_allclose(2 * (np.linalg.norm(start[arc, :2], axis=1) - CUTTER), 54, atol=1e-9)
    np.testing.assert_allclose(start[arc][0], end[arc][-1], atol=1e-12)
    assert set(end[:, 2]) == {-0.4}
    for normal, distance in lines(piece, "circle"):  # lead in and out along the tangent
        assert distance == pytest.approx(27, abs=1e-9) and abs(normal[0]) == 1


def test_the_diamond_is_the_square_over_the_middles_of_the_sides(piece):
    walls = lines(piece, "diamond")
    assert len(walls) == 4
    for normal, distance in walls:
        np.testing.assert_allclose(np.abs(normal), np.sqrt(0.5), atol=1e-5)
        assert distance == pytest.approx(40 / np.sqrt(2), abs=1e-4)  # four digits in the file
    assert set(cuts(piece, "diamond")[1][:, 2]) == {-0.8}


def test_the_inclined_side_leans_by_3_degrees_from_the_corner_of_the_square(piece):
    ((normal, distance),) = lines(piece, "inclined_side")
    assert np.degrees(np.arctan2(-normal[0], -normal[1])) == pytest.approx(3, abs=1e-4)
    assert normal @ [-40, -40] == pytest.approx(distance, abs=1e-4)
    assert set(cuts(piece, "inclined_side")[1][:, 2]) == {-1.6}


def test_every_feature_is_cut_clockwise_so_that_the_clockwise_spindle_mills_down(piece):
    assert np.all(piece.curvature <= 0) and len(piece.features) == 6
    np.testing.assert_allclose(piece.spindle_speed, 8000 * 2 * np.pi / 60)
    np.testing.assert_allclose(piece.feed[~piece.rapid], 4 / 60)


def test_rapid_moves_and_the_starts_of_cuts_keep_clear_of_the_material(piece):
    """Below the top of the stock the tool only plunges where all is air or was cut at a deeper level."""
    xyz = piece.position * 1e3
    down = np.flatnonzero(piece.rapid[1:] & (xyz[1:, 2] < 0)) + 1
    assert len(down) == 5
    cleared = {"clearing": 40.0, "circle": STOCK, "diamond": STOCK, "inclined_side": STOCK, "square": STOCK}
    for k in down:
        assert np.array_equal(xyz[k, :2], xyz[k - 1, :2])  # straight down
        half = cleared[piece.features[piece.feature[k]]]
        assert np.abs(xyz[k, :2]).max() >= half + CUTTER
    level = piece.rapid[1:] & (xyz[1:, 2] == xyz[:-1, 2])
    assert np.all(xyz[1:][level, 2] >= 5)


def test_nothing_but_the_part_and_the_base_is_left_standing(piece):
    """Everything outside of the diamond, within the square, is swept at the level of the diamond or below."""
    grid = np.stack(np.meshgrid(np.linspace(-40, 40, 161), np.linspace(-40, 40, 161)), -1).reshape(-1, 2)
    outside = grid[np.abs(grid).sum(axis=1) > 40.01]
    swept = np.zeros(len(outside), bool)
    timed = time_path(piece, Timing(controller_step=0.01))
    deep = timed.trajectory.position[:, 2] <= -0.8e-3
    for centre in timed.trajectory.position[deep, :2] * 1e3:
        swept |= np.linalg.norm(outside - centre, axis=1) <= CUTTER + 0.02
    assert swept.all()


def test_the_path_is_short_enough_to_be_simulated_at_leisure(piece):
    assert piece.length < 2.5
    assert time_path(piece, Timing()).trajectory.duration_ns < 40e9
