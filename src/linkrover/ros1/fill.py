"""Field names and plain values to genpy messages and back."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from typing import Any

from genpy.rostime import Duration, Time

from .types import message_class

_ARRAY = re.compile(r"\[\d*\]$")


@functools.cache
def _slot_types(cls: Any) -> dict[str, str]:
    return dict(zip(cls.__slots__, cls._slot_types, strict=True))


def fill(message: Any, fields: Mapping[str, Any]) -> Any:
    """Set the fields of a message; nested messages from mappings, times from integer nanoseconds or {sec, nanosec}.

    Raises:
        KeyError: a field the message does not have.
    """
    types = _slot_types(message.__class__)
    for name, value in fields.items():
        setattr(message, name, _value(types[name], getattr(message, name), value))
    return message


def _value(slot_type: str, current: Any, value: Any) -> Any:
    if slot_type in ("time", "duration"):
        kind = Time if slot_type == "time" else Duration
        if isinstance(value, Mapping):
            return kind(value["sec"], value["nanosec"])
        return kind(*divmod(value, 1_000_000_000)) if isinstance(value, int) else value
    if isinstance(value, Mapping):
        return fill(current, value)
    if isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping):
        cls = message_class(_ARRAY.sub("", slot_type))
        return [fill(cls(), item) for item in value]
    return value


def build(type_name: str, fields: Mapping[str, Any]) -> Any:
    """A new message of this type."""
    return fill(message_class(type_name)(), fields)


def plain(message: Any) -> dict[str, Any]:
    """The opposite of fill()."""
    return {name: _plain(getattr(message, name)) for name in message.__slots__}


def _plain(value: Any) -> Any:
    if isinstance(value, (Time, Duration)):
        return value.to_nsec()
    if hasattr(value, "_slot_types"):
        return plain(value)
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value
