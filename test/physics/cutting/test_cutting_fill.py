"""Clearing of polygons, against a point-in-polygon test by crossing numbers."""

from __future__ import annotations

import numpy as np
import pytest
from budget import budget
from cuttings import PAPER_LAW
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kr270_milling.physics.cutting import Stock, Tool, make_params, make_state
from kr270_milling.physics.cutting.fill import clear_quad

SIZE = 30
STOCK = Stock(min=np.zeros(3), max=np.array([3e-3, 3e-3, 1e-3]), grid_step=1e-4)
PARAMS = make_params(Tool(diameter=1e-3, teeth=1, spindle_speed=1.0), PAPER_LAW, STOCK, np.radians(10.0))
corner = st.floats(-10.0, 40.0)


def cleared(xs, ys):
    state = make_state(PARAMS, STOCK, 4096)
    clear_quad(state, xs, ys, SIZE, SIZE, 7)
    return state.pool[: 256 * SIZE].reshape(SIZE, 256)[:, :SIZE] == 7


def inside(xs, ys):
    """Even number of sides to the right of a node: outside. And the distance of the node to the nearest side."""
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    odd, near = np.zeros((SIZE, SIZE), bool), np.full((SIZE, SIZE), np.inf)
    for a, b, c, d in zip(xs, ys, np.roll(xs, -1), np.roll(ys, -1), strict=True):
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            odd ^= ((b > y) != (d > y)) & (x < a + (y - b) / (d - b) * (c - a))
            at = np.clip(np.nan_to_num(((x - a) * (c - a) + (y - b) * (d - b)) / ((c - a) ** 2 + (d - b) ** 2)), 0, 1)
        near = np.minimum(near, np.hypot(x - a - at * (c - a), y - b - at * (d - b)))
    return odd, near


@settings(max_examples=budget(200), deadline=None)
@example((0.0, 0.0, 0.0, 2.2e-309), (0.0, 0.0, 0.0, 1.0))
@given(st.tuples(*[corner] * 4), st.tuples(*[corner] * 4))
def test_a_quadrilateral_is_cleared_inside_and_nowhere_else(xs, ys):
    odd, near = inside(xs, ys)
    sure = near > 1e-6
    assert np.array_equal(cleared(xs, ys)[sure], odd[sure])


def test_a_bow_tie_is_cleared_in_both_halves():
    found = cleared((2.5, 2.5, 22.5, 22.5), (2.5, 20.5, 2.5, 20.5))
    assert found[4, 5:19].all() and found[21, 5:19].all()
    assert not found[12, :9].any() and not found[12, 15:].any()
    assert found.sum() == pytest.approx(2 * 18 * 10 / 2, rel=0.1)
