"""Bytes a parser may meet: anything, and real texts with damage."""

from __future__ import annotations

from hypothesis import strategies as st


def damaged(real: bytes) -> st.SearchStrategy[bytes]:
    """The real text cut, spliced, doubled and overwritten in one place; or any bytes at all."""

    def splice(start: int, end: int, put: bytes) -> bytes:
        start, end = sorted((start, end))
        return real[:start] + put + real[end:]

    places = st.integers(0, len(real))
    puts = st.one_of(
        st.binary(max_size=12), st.sampled_from([b"-1", b"1_0", b"+5", b" ", b"\n", b":", b"9" * 30, b"\x00"])
    )
    return st.one_of(
        st.binary(max_size=300), st.builds(splice, places, places, puts), st.builds(lambda n: real[:n], places)
    )
