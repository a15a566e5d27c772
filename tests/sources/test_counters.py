from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from linkrover.records import Continuity
from linkrover.sources.counters import increments

TOP = 2**32


def test_rising_counters_are_steady():
    assert increments((1, 2), (5, 2)) == (Continuity.STEADY, (4, 0))


def test_a_byte_counter_that_went_round_at_2_to_32_is_corrected():
    assert increments((TOP - 100, 7), (50, 9)) == (Continuity.WRAPPED, (150, 2))


def test_counters_that_all_fell_were_reset():
    assert increments((TOP - 100, 700), (50, 9)) == (Continuity.RESET, None)


def test_a_fall_from_the_middle_is_a_reset_even_if_another_counter_rose():
    assert increments((1000, 1), (10, 2)) == (Continuity.RESET, None)


def test_a_64_bit_counter_that_fell_was_reset():
    assert increments((TOP + 5, 1), (10, 2)) == (Continuity.RESET, None)


@given(st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=4), st.integers(0, 2**30 - 1))
def test_increments_are_never_negative(before, step):
    after = tuple((value + step) % TOP for value in before)
    _, steps = increments(tuple(before), after)
    assert steps is None or min(steps) >= 0
