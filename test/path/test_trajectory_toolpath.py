"""The record of a tool path and its builder."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.path.toolpath import PathBuilder, Toolpath, ToolpathError


def corner() -> PathBuilder:
    """10 mm along x, then a quarter circle of 10 mm radius to the left in one chord."""
    builder = PathBuilder("here")
    builder.move((0.0, 0.0, 0.0), 0.0, True, 1)
    builder.move((0.01, 0.0, 0.0), 0.02, False, 2)
    builder.move((0.02, 0.01, 0.0), 0.02, False, 3, 100.0)
    return builder


def test_lengths_follow_the_arcs_and_not_their_chords():
    path = corner().build()
    np.testing.assert_allclose(path.block_length, [0, 0.01, 0.01 * np.pi / 2])


def test_points_on_the_path_lie_on_the_arc_with_its_tangent():
    path = corner().build()
    position, tangent, _ = path.on_path(np.array([0.0, 0.005, 0.01, 0.01 + 0.01 * np.pi / 6, path.length]))
    angle = np.pi / 6
    on_arc = [0.01 + 0.01 * np.sin(angle), 0.01 - 0.01 * np.cos(angle), 0]
    np.testing.assert_allclose(position[1:], [[0.005, 0, 0], [0.01, 0, 0], on_arc, [0.02, 0.01, 0]], atol=1e-17)
    np.testing.assert_allclose(tangent[2:], [[1, 0, 0], [np.cos(angle), np.sin(angle), 0], [0, 1, 0]], atol=1e-15)


def test_the_tangent_of_a_helix_climbs():
    builder = corner()
    builder.move((0.01, 0.02, 0.01), 0.02, False, 4, 100.0)
    _, tangent, _ = builder.build().on_path(np.array([0.01 + 0.01 * np.pi / 2 + 1e-9]))
    np.testing.assert_allclose(tangent[0, 2], 1 / np.hypot(1, np.pi / 2), rtol=1e-6)


def test_blocks_are_found_by_their_distance():
    path = corner().build()
    assert path.block_at([-1.0, 0.0, 0.0099, 0.0101, 9.0]).tolist() == [1, 1, 1, 2, 2]


def test_moves_to_where_the_tool_is_are_left_out():
    builder = corner()
    builder.move((0.02, 0.01, 0.0), 0.5, False, 9)
    assert len(builder.build()) == 3


def test_a_turn_on_the_spot_is_refused():
    builder = corner()
    builder.quaternion = (0.0, 1.0, 0.0, 0.0)
    with pytest.raises(InputError, match="line 7"):
        builder.move((0.02, 0.01, 0.0), 0.5, False, 7)


@pytest.mark.parametrize(
    ("change", "index"),
    [
        ({"feed": np.array([0.0, 0.1, 0.0])}, 2),
        ({"feed": np.array([0.0, 0.1, np.nan])}, 2),
        ({"curvature": np.array([0.0, np.inf, 0.0])}, 1),
        ({"line": np.zeros(2)}, None),
        ({"position": np.zeros((1, 3))}, None),
    ],
)
def test_a_path_that_cannot_be_run_is_refused_with_its_block(change, index):
    names = ("position", "feed", "rapid", "line", "feature", "features", "curvature", "spindle_speed", "quaternion")
    path = corner().build()
    with pytest.raises(ToolpathError) as caught:
        Toolpath(**{name: getattr(path, name) for name in names} | change)
    assert caught.value.index == index
