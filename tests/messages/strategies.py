"""Any record whatever, within what the messages can carry."""

from __future__ import annotations

import enum
import functools
import types
import typing

import msgspec
from hypothesis import strategies as st

from linkrover.messages import record_types
from linkrover.records import Record, Unknown

_WALL = st.integers(0, 2**31 * 10**9 - 1)
# integers that may be negative and unknown travel as float64
_EXACT = st.integers(-(2**53), 2**53)
SIGNED = {"rtt_ns", "middleware_ns", "release_error_median_ns", "release_error_max_ns", "offset_ns"}
_FLOAT = st.floats(allow_nan=False)
# an empty string stands for unknown; NUL ends a string for C++ readers
_TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1, max_size=5)


def _value(name: str, hint: object) -> st.SearchStrategy:
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        (inner,) = (arg for arg in typing.get_args(hint) if arg is not type(None))
        return st.none() | _value(name, inner)
    if typing.get_origin(hint) is tuple:
        return st.lists(_value(name, typing.get_args(hint)[0]), max_size=2).map(tuple)
    if typing.get_origin(hint) is dict:
        return st.dictionaries(_TEXT, _TEXT, max_size=2)
    if hint is bool:
        return st.booleans()
    if hint is int:
        return _EXACT if name in SIGNED else st.integers(0, 2**63 - 1)
    if hint is float:
        return _FLOAT
    if hint is str:
        return _TEXT
    assert isinstance(hint, type)
    if issubclass(hint, enum.Enum):
        return st.sampled_from(list(hint))
    return structs(hint)


@functools.cache
def structs(kind: type[msgspec.Struct]) -> st.SearchStrategy:
    hints = typing.get_type_hints(kind)
    fields = {name: _value(name, hints[name]) for name in kind.__struct_fields__}
    if issubclass(kind, Record):
        names = [n for n in kind.__struct_fields__ if n not in ("wall_ns", "mono_ns", "unknown")]
        fields["wall_ns"] = _WALL
        fields["mono_ns"] = st.integers(0, 2**63 - 1)
        fields["unknown"] = st.dictionaries(st.sampled_from(names), st.sampled_from(list(Unknown)), max_size=2)
    return st.builds(kind, **fields)


any_record = st.one_of([structs(kind) for kind in record_types()])
