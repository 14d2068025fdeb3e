from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kr270_milling.recordings.bag.stamps import GapCounter


def count(stamps, period=None) -> GapCounter:
    counter = GapCounter()
    counter.period_ns = period
    for stamp in stamps:
        counter.add(stamp)
    return counter.finish()


@given(st.sets(st.integers(1, 398), max_size=150), st.integers(1_000, 10**8), st.integers(0, 10**18))
def test_missing_messages_of_a_known_period_are_counted_exactly(dropped, period, begin):
    counter = count([begin + i * period for i in range(400) if i not in dropped], period)
    holes = sum(i - 1 not in dropped for i in dropped)
    assert (counter.missing, counter.gaps) == (len(dropped), holes)


@given(st.sets(st.integers(1, 398), max_size=30), st.integers(1_000, 10**8))
def test_a_learned_period_counts_the_same_also_for_what_was_missing_while_learning(dropped, period):
    counter = count([i * period for i in range(400) if i not in dropped])
    singles = [i for i in range(400) if i not in dropped][:21]
    if sum(b - a == 1 for a, b in zip(singles, singles[1:], strict=False)) > 10:  # most are the period itself
        assert (counter.period_ns, counter.missing) == (period, len(dropped))


def test_jitter_below_half_a_period_is_no_gap():
    stamps = [i * 1000 + (i * 7919) % 240 for i in range(200)]
    assert count(stamps, 1000).missing == 0
    assert count([s for i, s in enumerate(stamps) if i not in (50, 120, 121)], 1000).missing == 3


def test_a_series_without_period_has_no_gaps():
    counter = count([i**3 for i in range(100)])
    assert (counter.missing, counter.gaps, counter.as_dict()["period_ns"]) == (0, 0, None)


def test_repeated_and_backward_stamps_are_counted_on_their_own():
    counter = count([0, 10, 20, 20, 10, 30, 40, 70], 10)
    assert (counter.repeated, counter.backwards, counter.missing, counter.gaps) == (1, 1, 2, 1)


@pytest.mark.parametrize("number", range(4))
def test_fewer_than_three_differences_say_nothing(number):
    assert count([i * 10 for i in range(number)]).period_ns in (None, 0)
    assert count([0, 10, 20, 30, 60]).missing == 2


@given(st.sets(st.integers(1, 398), max_size=150), st.sets(st.integers(1, 398), max_size=150))
def test_a_second_pass_is_counted_like_the_first(first, second):
    stamps = [i * 10 for dropped in (first, second) for i in range(400) if i not in dropped]
    counter = count(stamps, 10)
    assert (counter.missing, counter.backwards) == (len(first) + len(second), 0)
