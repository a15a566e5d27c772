from __future__ import annotations

from linkrover.cli._help import unwrapped

LONG = "a line that was wrapped for the source because it is longer than seventy characters,"


def test_a_wrapped_paragraph_becomes_one_line():
    assert unwrapped(f"{LONG}\ngoes on {LONG}\nand ends.") == f"{LONG} goes on {LONG} and ends."


def test_paragraphs_lists_and_indented_examples_stay_apart():
    text = f"{LONG}\n\nshort\nlines\n{LONG}\n- item\n{LONG}\n  indented {LONG}\n  more"
    assert unwrapped(text) == text
