from __future__ import annotations

import pytest

from linkrover.report.words import number, sentences

from .views import run_view


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "unknown"),
        (float("nan"), "unknown"),
        (0, "0"),
        (12.345, "12.3"),
        (0.01234, "0.0123"),
        (12345.6, "12,346"),
    ],
)
def test_a_number_has_three_significant_digits_and_none_is_unknown(value, text):
    assert number(value) == text


def test_the_sentences_name_the_outage_its_place_and_the_figures_with_units():
    text = " ".join(sentences(run_view()))
    assert "The link was out once, 8.00 s in all (2.7 % of the time)" in text
    assert "began 100 s into the run at x = 12.2 m, y = -3.27 m" in text
    assert "carried 12.3 Mbit/s on average [11.0, 13.5] (sent 12.0, received 0.300)" in text
    assert "4.40 ms at the median" in text
