"""The exchange period: whole micro-steps, counted stamps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kr270_milling.base.errors import ParameterError
from kr270_milling.physics.motion.exchange import Clock, Exchange

SPEED = 8000 * 2 * np.pi / 60


@pytest.mark.parametrize(("period_ms", "micro_steps"), [(0.5, 24), (1 / 48, 1), (0.25, 12), (7.5, 360), (0.125, 6)])
def test_a_period_of_whole_micro_steps_makes_a_clock(period_ms, micro_steps):
    assert Exchange(period_ms * 1e-3).clock(SPEED).micro_steps == micro_steps


@pytest.mark.parametrize(
    ("period_ms", "near"), [(0.51, "0.5, 0.520833333"), (0.01, "0.0208333333"), (1e-9, "0.0208333")]
)
def test_another_period_is_refused_with_the_nearest_ones(period_ms, near):
    with pytest.raises(ParameterError) as caught:
        Exchange(period_ms * 1e-3).clock(SPEED)
    assert near in str(caught.value) and caught.value.key == "exchange.period_ms"


def test_a_period_that_the_sentence_proposes_is_taken():
    for n in (1, 7, 24, 25):
        unit = 1 / 48 * n
        assert Exchange(float(f"{unit:.9g}") * 1e-3).clock(SPEED).micro_steps == n


@given(st.integers(1, 480), st.integers(0, 10**7))
def test_every_step_has_one_stamp_and_every_stamp_its_step(micro_steps, step):
    clock = Clock(micro_steps / 48 * 1e-3, micro_steps)
    stamp = int(clock.stamp(step))
    assert stamp == pytest.approx(step * micro_steps / 48 * 1e6, abs=0.51)
    assert clock.step(stamp) == step
    assert clock.step(stamp + 1) == clock.step(stamp - 1) == -1


def test_stamps_do_not_drift():
    """1 / 48 ms is no whole number of nanoseconds; after an hour the stamp is still the nearest one."""
    clock = Clock(1e-3 / 48, 1)
    hour = 48_000 * 3600
    assert int(clock.stamp(hour)) == 3600 * 10**9
    assert clock.stamp(np.arange(4)).tolist() == [0, 20833, 41667, 62500]


def test_no_stamp_before_the_start_belongs_to_a_step():
    clock = Clock(5e-4, 24)
    assert [clock.step(s) for s in (-500_000, -1, 0, 499_999, 500_000)] == [-1, -1, 0, -1, 1]


@pytest.mark.parametrize(("duration_ns", "steps"), [(0, 0), (1, 1), (500_000, 1), (500_001, 2), (1_200_000_000, 2400)])
def test_the_periods_cover_the_duration(duration_ns, steps):
    assert Clock(5e-4, 24).steps(duration_ns) == steps


def test_a_duration_of_rounded_stamps_takes_no_further_period():
    clock = Clock(1e-3 / 48, 1)
    for n in (1, 2, 3, 1000, 57_600):
        assert clock.steps(int(clock.stamp(n))) == n


@pytest.mark.parametrize(
    "wrong", [{"period": 0.0}, {"period": np.nan}, {"period": 0.021}, {"micro_step": 0.0}, {"iterations": 0},
              {"micro_step": np.radians(16.0)}, {"iterations": 21}, {"warn_correction": 0.0}],
)  # fmt: skip
def test_an_exchange_that_cannot_be_is_refused(wrong):
    with pytest.raises(ParameterError):
        Exchange(**wrong)
