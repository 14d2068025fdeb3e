"""Paths at random, written in every dialect and read back: the same points, feeds, arcs and features."""

from __future__ import annotations

import math

import numpy as np
import pytest
from budget import budget
from dialect_writers import DIALECTS, SPEED, Move, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kr270_milling.path.cam.gcode.reader import read_gcode

GRID = st.integers(-40_000, 40_000).map(lambda n: n / 1000)  # [mm]
HEIGHT = st.integers(-5_000, 10_000).map(lambda n: n / 1000)
FEED = st.sampled_from([100.0, 400.0, 1250.0])
quick = settings(
    deadline=None,
    max_examples=budget(25),
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@st.composite
def paths(draw) -> list[Move]:
    """A start, then straight moves, rapids and half circles (also helical ones), each to another place."""
    at = (draw(GRID), draw(GRID), 10.0)
    moves = [Move(at)]
    for k in range(draw(st.integers(2, 12))):
        kind = draw(st.sampled_from(["line", "line", "rapid", "arc"])) if k else "line"
        name = draw(st.sampled_from(["", "", "2D Pocket1", "Contour 2"])) if kind == "line" else ""
        x, y, z = draw(GRID), draw(GRID), draw(HEIGHT)
        if kind == "arc":
            reach = draw(st.integers(1, 20)) * (1 if draw(st.booleans()) else -1)
            end = (at[0] + 2 * reach, at[1], z)
            move = Move(end, draw(FEED), (at[0] + reach, at[1]), draw(st.booleans()))
        else:
            move = Move((x, y, z), 0.0 if kind == "rapid" else draw(FEED), name=name)
        end = tuple(round(v, 3) for v in move.end)
        if math.dist(end, at) > 1e-3:
            moves.append(Move(end, move.feed, move.centre, move.clockwise, move.name))
            at = end
    return moves if len(moves) > 1 and any(move.feed for move in moves) else [*moves, Move((99.0, 0.0, 0.0), 100.0)]


@pytest.mark.parametrize("dialect", DIALECTS)
@quick
@given(moves=paths())
def test_a_path_written_in_a_dialect_is_read_back(tmp_path, dialect, moves):
    text, lines = write(moves, DIALECTS[dialect])
    (tmp_path / "part.nc").write_text(text)
    path = read_gcode(tmp_path / "part.nc")
    last = {line: k for k, line in enumerate(path.line.tolist())}  # the last chord of each move
    for move, line in zip(moves, lines, strict=True):
        k = last[line]
        np.testing.assert_allclose(1e3 * path.position[k], move.end, atol=2e-6 * 25.4)
        assert path.rapid[k] == (not move.feed)
        if move.feed:
            assert 6e4 * path.feed[k] == pytest.approx(move.feed, rel=1e-6)
            assert path.spindle_speed[k] * 30 / math.pi == pytest.approx(SPEED)
        if move.centre is not None:
            radius = math.dist(move.centre, move.end[:2])
            bend = -1 / radius if move.clockwise else 1 / radius
            assert path.curvature[k] / 1e3 == pytest.approx(bend, rel=1e-4)
            chords = path.position[path.line == line][:, :2]
            np.testing.assert_allclose(np.linalg.norm(1e3 * chords - move.centre, axis=1), radius, atol=1e-3)
    named = [move.name for move in moves if move.name and move.feed]
    assert set(named) <= set(path.features)
