"""Records <-> `linkrover_msgs` messages, by field name.

A message is a dict of its fields (nested messages are dicts); `assign` puts it into an object with attributes, such
as a rospy message, and `from_message` reads dicts and such objects alike. How each field travels follows from the
record's annotation and the type in the message text:

- unknown: float64 NaN; int64 (never negative in the record) -1; string empty; int8 (a bool) -1
- an integer that may be negative and unknown travels as float64
- an enum travels as its value, a dict as KeyValue[], a nested struct as a message with `bool known`
"""

from __future__ import annotations

import enum
import functools
import math
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from linkrover import records
from linkrover.errors import LinkRoverError, ParseError
from linkrover.records import Record, Unknown

from . import texts
from .schema import Field
from .wire import Message

PACKAGE = "linkrover_msgs"
_INT64_END = 2**63
# `case` is a C++ keyword, so that no message can have a field of that name
RENAMED = {"case": "case_name"}

T = typing.TypeVar("T", bound=msgspec.Struct)
_Convert = Callable[[Any], Any]


def record_types() -> tuple[type[Record], ...]:
    """Every record there is a message for."""
    found = [getattr(records, name) for name in records.__all__]
    return tuple(t for t in found if isinstance(t, type) and issubclass(t, Record) and t is not Record)


def type_name(record_type: type[Record]) -> str:
    """The message type of a record type, such as "linkrover_msgs/WirelessLink"."""
    return f"{PACKAGE}/{record_type.__name__}"


@functools.cache
def record_type(message_type: str) -> type[Record] | None:
    """The record type of a message type of `linkrover_msgs`; None if it is not one."""
    return next((t for t in record_types() if type_name(t) == message_type), None)


def header(wall_ns: int, frame_id: str) -> Message:
    """A std_msgs/Header."""
    sec, nanosec = divmod(wall_ns, 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


def stamp_ns(message: Any) -> int:
    """The header stamp of a message (dict, ROS 1 or ROS 2 object) in ns since the epoch."""
    stamp = get(get(message, "header"), "stamp")
    if isinstance(stamp, Mapping) or hasattr(stamp, "sec"):
        return int(get(stamp, "sec")) * 1_000_000_000 + int(get(stamp, "nanosec"))
    return int(stamp.secs) * 1_000_000_000 + int(stamp.nsecs)


def get(message: Any, name: str) -> Any:
    """A field of a dict or of an object."""
    return message[name] if isinstance(message, Mapping) else getattr(message, name)


def to_message(record: Record, end: str) -> Message:
    """The record as a message of `type_name(type(record))`; `end` is the frame_id where there is no interface."""
    struct = _struct(type(record))
    message: Message = {
        "header": header(record.wall_ns, getattr(record, "iface", None) or end),
        "mono_ns": record.mono_ns,
    }
    for field, wire, convert, _ in struct:
        value = getattr(record, field)
        message[wire] = value if convert is None else convert(value)
    message["unknown"] = [f"{field}={reason.value}" for field, reason in record.unknown.items()]
    return message


def from_message(wanted: type[T], message: Any) -> T:
    """The record in a message. A field the message does not have keeps its default. Raises ParseError."""
    values: dict[str, Any] = {}
    try:
        for field, wire, _, convert in _struct(wanted):
            try:
                value = get(message, wire)
            except (KeyError, AttributeError):
                continue  # written before this field was thought of
            values[field] = value if convert is None else convert(value)
        if issubclass(wanted, Record):
            values["wall_ns"] = stamp_ns(message)
            values["mono_ns"] = int(get(message, "mono_ns"))
            values["unknown"] = _unknown(get(message, "unknown"))
        return wanted(**values)
    except (KeyError, AttributeError, TypeError, ValueError, OverflowError) as error:
        raise ParseError(f"{PACKAGE}/{wanted.__name__}", "message", "a message of this type", str(error)) from None


def assign(target: Any, message: Message, make: Callable[[str], Any], message_type: str) -> Any:
    """Set the fields of `target`, an object of `message_type`; make("package/Name") gives an empty nested one."""
    for field in texts.definitions(message_type)[message_type]:
        value = message[field.name]
        if "/" not in field.type:
            setattr(target, field.name, list(value) if isinstance(value, tuple) else value)
        elif field.count is not None:
            setattr(target, field.name, [assign(make(field.type), one, make, field.type) for one in value])
        elif field.type == "std_msgs/Header":
            _assign_header(target.header, value)
        else:
            assign(getattr(target, field.name), value, make, field.type)
    return target


def _assign_header(target: Any, value: Message) -> None:
    ros2 = hasattr(target.stamp, "sec")
    setattr(target.stamp, "sec" if ros2 else "secs", value["stamp"]["sec"])
    setattr(target.stamp, "nanosec" if ros2 else "nsecs", value["stamp"]["nanosec"])
    target.frame_id = value["frame_id"]


def _unknown(entries: Any) -> dict[str, Unknown]:
    pairs = (str(entry).partition("=") for entry in entries)
    return {field: Unknown(reason) for field, _, reason in pairs}


@functools.cache
def _struct(struct: type[msgspec.Struct]) -> tuple[tuple[str, str, _Convert | None, _Convert | None], ...]:
    """(record field, message field, to the message, from the message), compiled once; None = as it is."""
    name = f"{PACKAGE}/{struct.__name__}"
    on_wire = {field.name: field for field in texts.definitions(name)[name]}
    hints = typing.get_type_hints(struct)
    compiled = []
    for field in struct.__struct_fields__:
        if issubclass(struct, Record) and field in ("wall_ns", "mono_ns", "unknown"):
            continue
        wire = RENAMED.get(field, field)
        if wire not in on_wire:
            continue  # a test holds texts and records together; a running agent must not die of a missing line
        compiled.append((field, wire, *_converters(f"{name}.{wire}", hints[field], on_wire[wire])))
    return tuple(compiled)


def _converters(name: str, hint: Any, wire: Field) -> tuple[_Convert | None, _Convert | None]:
    optional = typing.get_origin(hint) in (typing.Union, types.UnionType)
    if optional:
        (hint,) = (arg for arg in typing.get_args(hint) if arg is not type(None))
    kind = _kind(hint)
    found = _TABLE.get((kind, optional, wire.type if "/" not in wire.type else "struct", wire.count))
    if found is None:
        raise LinkRoverError(f"{name}: no rule for {hint}{' | None' if optional else ''} as {wire.type}")
    return found(hint)


def _kind(hint: Any) -> str:
    origin = typing.get_origin(hint)
    if origin is tuple:
        element = typing.get_args(hint)[0]
        return f"tuple of {_kind(element)}"
    if origin is dict:
        return "dict"
    if issubclass(hint, enum.Enum):
        return "enum"
    if issubclass(hint, msgspec.Struct):
        return "struct"
    return str(hint.__name__)


def _nan_to_none(value: Any) -> float | None:
    return None if math.isnan(value) else float(value)


def _int_or_none(value: Any) -> int | None:
    return None if value == -1 else int(value)


def _float_to_int(value: Any) -> int | None:
    return int(value) if abs(value) < _INT64_END else None  # NaN is less than nothing


def _nested(struct: type[msgspec.Struct]) -> tuple[_Convert, _Convert]:
    empty = {**_struct_to(struct, struct()), "known": False}

    def read(value: Any) -> Any:
        return from_message(struct, value) if get(value, "known") else None

    return lambda v: empty if v is None else {**_struct_to(struct, v), "known": True}, read


def _struct_to(struct: type[msgspec.Struct], value: msgspec.Struct) -> Message:
    return {
        wire: getattr(value, field) if convert is None else convert(getattr(value, field))
        for field, wire, convert, _ in _struct(struct)
    }


def _structs(hint: Any) -> tuple[_Convert, _Convert]:
    struct = typing.get_args(hint)[0]
    return lambda v: [_struct_to(struct, one) for one in v], lambda v: tuple(from_message(struct, one) for one in v)


def _none_as(sentinel: Any) -> _Convert:
    return lambda v: sentinel if v is None else v


_NONE_AS_FLOAT = _none_as(math.nan)
_NONE_AS_INT = _none_as(-1)
_NONE_AS_STRING = _none_as("")
# (record kind, may be None, wire type, wire count) -> (to, from)
_TABLE: dict[tuple[str, bool, str, int | None], Callable[[Any], tuple[_Convert | None, _Convert | None]]] = {
    ("int", False, "int64", None): lambda _: (None, int),
    ("float", False, "float64", None): lambda _: (None, float),
    ("str", False, "string", None): lambda _: (None, str),
    ("bool", False, "bool", None): lambda _: (None, bool),
    ("int", True, "int64", None): lambda _: (_NONE_AS_INT, _int_or_none),
    ("int", True, "float64", None): lambda _: (lambda v: math.nan if v is None else float(v), _float_to_int),
    ("float", True, "float64", None): lambda _: (_NONE_AS_FLOAT, _nan_to_none),
    ("str", True, "string", None): lambda _: (_NONE_AS_STRING, lambda v: str(v) or None),
    ("bool", True, "int8", None): lambda _: (
        lambda v: -1 if v is None else int(v),
        lambda v: None if v < 0 else bool(v),
    ),
    ("enum", True, "string", None): lambda hint: (
        lambda v: "" if v is None else v.value,
        lambda v: hint(v) if v else None,
    ),
    ("enum", False, "string", None): lambda hint: (lambda v: v.value, hint),
    ("tuple of float", False, "float64", -1): lambda _: (None, lambda v: tuple(float(x) for x in v)),
    ("tuple of str", False, "string", -1): lambda _: (None, lambda v: tuple(str(x) for x in v)),
    ("tuple of struct", False, "struct", -1): _structs,
    ("struct", True, "struct", None): _nested,
    ("dict", False, "struct", -1): lambda _: (
        lambda v: [{"key": key, "value": value} for key, value in v.items()],
        lambda v: {str(get(one, "key")): str(get(one, "value")) for one in v},
    ),
}
