"""Arcs to chords."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kr270_milling.path.cam.arcs import ArcError, arc_points, centre_from_radius

finite = st.floats(-0.2, 0.2)


@given(finite, finite, st.floats(1e-4, 0.2), st.floats(0, 6.28), st.floats(0.01, 6.27), st.booleans())
def test_chords_lie_within_the_tolerance_of_the_arc_and_end_on_it(x, y, radius, first, sweep, clockwise):
    sign = -1 if clockwise else 1
    start, end = ((x + radius * math.cos(a), y + radius * math.sin(a), 0.0) for a in (first, first + sign * sweep))
    points, curvature = arc_points(start, end, (x, y), clockwise, 1e-9, 2e-6)
    corners = np.vstack([start, points]) - [x, y, 0]
    middles = (corners[1:] + corners[:-1]) / 2
    assert np.abs(np.hypot(*corners[:, :2].T) - radius).max() < 1e-12
    assert (radius - np.hypot(*middles[:, :2].T)).max() <= 2e-6 + 1e-15  # of a chord the middle lies furthest inside
    half = np.hypot(*np.diff(corners[:, :2], axis=0).T) / 2
    length = np.sum(2 * radius * np.arcsin(np.minimum(half / radius, 1)))
    assert length == pytest.approx(radius * sweep, rel=1e-6, abs=1e-9)
    assert curvature == pytest.approx(sign / radius) and tuple(points[-1]) == end


@given(finite, finite, finite, finite, st.floats(0.6, 3), st.booleans(), st.booleans())
def test_the_centre_found_from_a_radius_is_as_far_from_both_ends_and_gives_the_right_one_of_the_arcs(
    x0, y0, x1, y1, factor, clockwise, longer
):
    chord = math.hypot(x1 - x0, y1 - y0)
    if chord < 1e-3:
        return
    radius = factor * chord * (-1 if longer else 1)
    centre = centre_from_radius((x0, y0), (x1, y1), radius, clockwise, 1e-9)
    assert math.dist(centre, (x0, y0)) == pytest.approx(abs(radius)) == math.dist(centre, (x1, y1))
    points, _ = arc_points((x0, y0, 0.0), (x1, y1, 0.0), centre, clockwise, 1e-9, 1e-6)
    path = np.vstack([(x0, y0, 0.0), points])
    length = np.hypot(*np.diff(path[:, :2], axis=0).T).sum()
    minor = 2 * abs(radius) * math.asin(chord / 2 / abs(radius))
    assert length == pytest.approx(2 * math.pi * abs(radius) - minor if longer else minor, rel=2e-2)


def test_equal_start_and_end_mean_a_full_circle_in_either_sense():
    for clockwise in (True, False):
        points, _ = arc_points((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0), clockwise, 1e-9, 1e-6)
        turn = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
        assert turn[-1] - turn[0] == pytest.approx((-1 if clockwise else 1) * 2 * math.pi * (1 - 1 / len(points)))


def test_a_helix_climbs_evenly():
    points, _ = arc_points((1.0, 0.0, 0.0), (-1.0, 0.0, -0.1), (0.0, 0.0), False, 1e-9, 1e-5)
    np.testing.assert_allclose(points[:, 2], -0.1 * np.arange(1, len(points) + 1) / len(points))


@pytest.mark.parametrize("end", [(1.0, 0.1, 0.0), (0.9, 0.0, 0.0)])
def test_an_arc_whose_ends_differ_in_radius_does_not_close(end):
    with pytest.raises(ArcError, match="does not close"):
        arc_points((1.0, 0.0, 0.0), end, (0.0, 0.0), False, 1e-5, 1e-6)


def test_an_arc_longer_than_its_diameter_does_not_close():
    with pytest.raises(ArcError, match="does not close"):
        centre_from_radius((0.0, 0.0), (0.1, 0.0), 0.0499, True, 10e-6)
    centre_from_radius((0.0, 0.0), (0.1, 0.0), 0.049995, True, 10e-6)
