"""Colours that colour-blind readers can tell apart (Okabe and Ito, 2008), with one meaning each."""

from __future__ import annotations

ROBOT = "#0072B2"
STATION = "#D55E00"
TRUTH = "#7A7A7A"
OUTAGE = "#CC79A7"
GOOD = "#009E73"
INK = "#1b1f24"
CASES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6D1F", "#000000", "#6A51A3", "#7A7A7A")
DASHES = ("solid", "dash", "dot", "dashdot")
# Perceptually even and readable in grey: cividis for maps.
MAP_SCALE = "Cividis"


def end_colour(end: str) -> str:
    """The colour of an end: robot, station or, for anything else, the truth's grey."""
    return {"robot": ROBOT, "station": STATION}.get(end, TRUTH)


def case_colour(index: int) -> str:
    """The colour of the index-th case; repeats after ten."""
    return CASES[index % len(CASES)]
