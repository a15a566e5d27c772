from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.analysis.directions import share_lost_back


def drive(fates: str, *, stateless: bool = False, first: int = 1, judged: str = "lost"):
    """What a recording holds after these fates: a(nswered), f(orward loss), b(ack loss), n(ot sent)."""
    reflected, number = [], 0
    for place, fate in enumerate(fates):
        answered = number if fate == "a" else np.nan
        reflected.append(first + place if stateless and fate == "a" else answered)
        number += fate in "ab"
    words = {"a": "answered", "f": judged, "b": judged, "n": "not sent"}
    state = np.array([words[fate] for fate in fates], dtype=object)
    sequence = np.arange(first, first + len(fates), dtype=float)
    return share_lost_back(np.ones(len(fates)), sequence, np.array(reflected, dtype=float), state)


def test_a_gap_with_losses_both_ways_is_counted_exactly():
    share = drive("aafffbfaab" + "a")
    assert share[2:7].tolist() == [0.2] * 5
    assert share[9] == 1.0
    assert np.isnan(share[[0, 1, 7, 8, 10]]).all()


def test_losses_before_the_first_answer_count_from_the_reflectors_zero():
    assert drive("fba")[:2].tolist() == [0.5, 0.5]
    assert np.isnan(drive("fba", first=7)[:2]).all()


def test_nothing_is_known_after_the_last_answer():
    assert np.isnan(drive("aaffb")[2:]).all()


def test_a_stateless_reflector_tells_no_direction():
    assert np.isnan(drive("affba", stateless=True)).all()


def test_what_the_sender_knew_at_once_is_kept():
    assert drive("afa", judged="lost forward")[1] == 0.0
    assert drive("aba", judged="lost back")[1] == 1.0


def test_a_reflector_that_began_again_and_another_session_are_kept_apart():
    nan = np.nan
    state = np.array(["answered", "lost", "answered"] * 2, dtype=object)
    share = share_lost_back(
        np.array([1.0, 1, 1, 2, 2, 2]),
        np.array([1.0, 2, 3, 1, 2, 3]),
        np.array([50.0, nan, 0, 0, nan, 1]),
        state,
    )
    assert np.isnan(share[1])
    assert share[4] == 0.0


@given(st.text("aaafbn", max_size=80))
@settings(max_examples=150, deadline=None)
def test_the_sums_are_those_of_the_truth(fates):
    share = drive(fates)
    settled = fates[: fates.rfind("a") + 1]
    assert np.nansum(share) == pytest.approx(settled.count("b"))
    assert np.isfinite(share).sum() == settled.count("b") + settled.count("f")
