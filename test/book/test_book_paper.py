"""Checks against what [Klimchik2014] prints: Table 2 and the frequencies of section 6."""

from __future__ import annotations

import functools

import numpy as np
from book import check

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, mean_force, simulate
from kr270_milling.show.report.tables import TABLE_2

TABLE = "[Klimchik2014], Table 2"
ORIGINAL, LINEAR = TABLE_2["original"], TABLE_2["linear"]


@functools.cache
def _cell():
    return read_cell(find_file("paper.yaml"))


@functools.cache
def _pass(name: str):
    return simulate(_cell()) if name == "original" else compensated(_cell(), _pass("original"), name)


@check(
    "original pass: {score}", f"identified: a_p and the damping ratio are fitted to {TABLE}", "m",
    cases=("score share", [("static_deviation", 0.01), ("max_deviation", 0.02)]),
)  # fmt: skip
def test_original(score, share):
    expected, got = getattr(ORIGINAL, score), getattr(_pass("original").scores, score)
    return expected, got, share * expected


@check(
    "{method} pass: {score}", f"{TABLE}: not above the paper; the other methods, of the customer", "m", at_most=True,
    cases=("method score bound", [
        ("linear", "static_deviation", LINEAR.static_deviation), ("linear", "max_deviation", LINEAR.max_deviation),
        ("spline", "max_deviation", 1.1e-6), ("learned", "max_deviation", 0.5e-6)]),
)  # fmt: skip
def test_compensated(method, score, bound):
    return bound, abs(getattr(_pass(method).scores, score)), 0.0


@check("low frequency", TABLE, "Hz")
def test_low_frequency():
    return (
        ORIGINAL.low_frequency,
        _pass("original").scores.low_frequency,
        0.01 * ORIGINAL.low_frequency,
    )


@check("low frequency after compensation / before", f"{TABLE}: the ringing frequency stays")
def test_same_frequency():
    return 1.0, _pass("linear").scores.ringing_frequency / _pass("original").scores.ringing_frequency, 0.01


@check("high frequency of the force", "8000 rpm x 4 teeth = 533.3 Hz (the paper says about 700) [derived]", "Hz")
def test_tooth_passing():
    ran = _pass("original").result
    force = ran.wrench[ran.time > _cell().full_engagement, 1]
    spectrum = np.abs(np.fft.rfft((force - force.mean()) * np.hanning(force.size), 16 * force.size))
    peak = np.fft.rfftfreq(16 * force.size, _cell().exchange.period)[np.argmax(spectrum)]
    return 8000 / 60 * 4, peak, 0.5


@check("mean lateral force of the pass", "81 N: 58.1 um over 0.717 um/N [derived]", "N")
def test_lateral_force():
    return 81.0, mean_force(_pass("original").result)[1], 0.5
