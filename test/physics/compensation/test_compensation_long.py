"""The arm on a long path: pieces of the path identify it, and blocks of segments are one path."""

from __future__ import annotations

import numpy as np
import pytest
from arms import one_mode

from kr270_milling.physics.compensation import arm_fit, response
from kr270_milling.physics.compensation.arm_fit import Evidence, fit_arm
from kr270_milling.physics.compensation.lifted import KnotConditions, Lifted
from kr270_milling.physics.compensation.response import Segments

COUNT = 9000
SEGMENTS = Segments(np.arange(COUNT + 1) * 12_000_000, 4)
MODEL = one_mode().cut(np.zeros(COUNT, int))
PATH = np.zeros((COUNT, 4, 3))


def test_pieces_of_a_long_path_identify_the_arm():
    """A hundred seconds of random wrenches; the pieces have 4096 of the 9000 segments."""
    assert COUNT > arm_fit.MOST_FITTED
    true = MODEL.scaled(1.1, 0.8, 1.0, 1.15)
    wrench = np.random.default_rng(3).normal(0.0, 0.1, (COUNT, 4, 6))
    passes = (Evidence(PATH, true.deflect(SEGMENTS, wrench), wrench),)
    fitted, found = fit_arm(MODEL, SEGMENTS, PATH, np.zeros(3), passes, np.ones((COUNT, 4)), 0.0)
    assert len(fitted.frequency) == COUNT
    assert found.frequency_hz[0] * 2 * np.pi == pytest.approx(true.frequency[0, 0], rel=1e-3)
    assert found.damping_ratio[0] == pytest.approx(true.damping[0, 0], rel=0.02)
    assert found.compliance_factor == pytest.approx(1.15, rel=1e-3)


def test_blocks_of_segments_are_one_path(monkeypatch):
    rows = slice(0, 90)
    arm, segments = MODEL.cut(rows), SEGMENTS.cut(rows)
    random = np.random.default_rng(4)
    wrench, deviation = random.normal(0.0, 0.1, (90, 4, 6)), random.normal(0.0, 1e-5, (90, 4, 3))
    cubic = random.normal(0.0, 1e-5, (90, 4, 3))
    weight = np.broadcast_to(np.eye(3), (90, 4, 3, 3))

    def results() -> list[np.ndarray]:
        solved = []
        for smooth in (True, False):
            conditions = KnotConditions(smooth, np.arange(91) % 40 == 0, np.zeros(90, bool))
            solved += vars(Lifted(arm, segments, conditions).least_squares(deviation, weight, 1e-6)).values()
        return [arm.deflect(segments, wrench), arm.swing(segments, cubic, np.ones(3)), *solved]

    at_once = results()
    monkeypatch.setattr(response, "BLOCK", 7)
    for whole, in_blocks in zip(at_once, results(), strict=True):
        np.testing.assert_allclose(in_blocks, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())
