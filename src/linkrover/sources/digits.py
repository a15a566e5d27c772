"""Numbers in kernel text, read strictly."""

from __future__ import annotations

from linkrover.errors import ParseError

COUNTER_LIMIT = 1 << 64


def counter(field: bytes, file: str, place: str) -> int:
    """A counter: decimal digits only, below 2^64. int() alone would take '1_0', '+1' and ' 1'.

    Raises:
        ParseError: anything else.
    """
    if not field.isdigit() or len(field) > 20:
        raise ParseError(file, place, "a decimal counter", show(field))
    value = int(field)
    if value >= COUNTER_LIMIT:
        raise ParseError(file, place, "a counter below 2^64", show(field))
    return value


def show(data: bytes, limit: int = 40) -> str:
    """A short printable form of input for an error message."""
    return repr(data if len(data) <= limit else data[:limit] + b"...")[1:]
