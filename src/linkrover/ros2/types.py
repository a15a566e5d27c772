"""ROS 2 message types for DDS, made at run time from the .msg texts: no ROS 2 installation, no generated code.

cyclonedds needs a class for a topic's type; its own (de)serialiser walks attributes in Python. The bytes are those of
`linkrover.messages.Codec` (a test holds both equal), so that a message stays a dictionary from end to end and a
sample that cannot be read is one bad sample, not a failed take().
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, ClassVar

from cyclonedds.idl import make_idl_struct, types

from linkrover.errors import LinkRoverError, ParseError
from linkrover.messages import Codec, Message, texts
from linkrover.messages.schema import STRINGS, Definitions, Field

_HEADER = Field("header", "std_msgs/Header")
_DIAGNOSTICS: Definitions = {
    "diagnostic_msgs/DiagnosticArray": (_HEADER, Field("status", "diagnostic_msgs/DiagnosticStatus", -1)),
    "diagnostic_msgs/DiagnosticStatus": (
        Field("level", "byte"),
        Field("name", "string"),
        Field("message", "string"),
        Field("hardware_id", "string"),
        Field("values", "diagnostic_msgs/KeyValue", -1),
    ),
    "diagnostic_msgs/KeyValue": (Field("key", "string"), Field("value", "string")),
}
"""What robots' tools know of diagnostic_msgs; its package is not one a recording of ours embeds."""

_PRIMITIVES: dict[str, Any] = {
    "bool": bool, "byte": types.uint8, "char": types.uint8, "int8": types.int8, "uint8": types.uint8,
    "int16": types.int16, "uint16": types.uint16, "int32": types.int32, "uint32": types.uint32,
    "int64": types.int64, "uint64": types.uint64, "float32": types.float32, "float64": types.float64,
}  # fmt: skip


def definitions(name: str) -> Definitions:
    """`name` ("package/Name") and all it is made of.

    Raises:
        LinkRoverError: a type that is not known here.
    """
    if name in _DIAGNOSTICS:
        return {**_DIAGNOSTICS, **texts.definitions("std_msgs/Header")}
    return texts.definitions(name)


def dds_name(name: str) -> str:
    """What ROS 2 calls "geometry_msgs/Twist" on the wire: "geometry_msgs::msg::dds_::Twist_"."""
    package, _, short = name.partition("/")
    return f"{package}::msg::dds_::{short}_"


def ros_name(dds: str) -> str | None:
    """The opposite, as ROS 2 tools print it: "geometry_msgs/msg/Twist"; None: no message of ROS 2."""
    parts = dds.split("::")
    if len(parts) < 4 or parts[-2] != "dds_" or not parts[-1].endswith("_"):
        return None
    return "/".join((*parts[:-2], parts[-1][:-1]))


def idl_class(name: str, found: Definitions) -> Any:
    """The cyclonedds class of a type, a dataclass with cyclonedds' own serialiser."""
    made: dict[str, Any] = {}

    def make(one: str) -> Any:
        if one not in made:
            made[one] = make_idl_struct(one.partition("/")[2], _dotted(one), _fields(found[one], make))
        return made[one]

    return make(name)


def _dotted(name: str) -> str:
    return dds_name(name).replace("::", ".")


def _fields(listed: tuple[Field, ...], make: Any) -> dict[str, Any]:
    annotations: dict[str, Any] = {}
    for field in listed:
        one = make(field.type) if "/" in field.type else str if field.type in STRINGS else _PRIMITIVES[field.type]
        if field.count is None:
            annotations[field.name] = one
        else:
            annotations[field.name] = types.sequence[one] if field.count < 0 else types.array[one, field.count]
    return annotations


class Sample:
    """A message on its way through DDS. message: its fields, or the ParseError of bytes that are not of this type.

    The classes cyclonedds sees have these methods in place of their own.
    """

    codec: ClassVar[Codec]
    message: Message | ParseError

    def __init__(self, message: Message | ParseError) -> None:
        self.message = message

    def serialize(self, *_: Any, **__: Any) -> bytes:
        """Called by cyclonedds' DataWriter."""
        assert not isinstance(self.message, ParseError)
        return self.codec.encode(self.message)

    @classmethod
    def deserialize(cls, data: bytes, *_: Any, **__: Any) -> Sample:
        """Called by cyclonedds' DataReader."""
        try:
            return cls(cls.codec.decode(data))
        except ParseError as error:
            return cls(error)

    @classmethod
    def deserialize_key(cls, _data: bytes, *_: Any, **__: Any) -> None:
        """Of a sample that only says that its writer went: ROS types have no keys."""
        return


@functools.cache
def sample_class(name: str) -> type[Sample]:
    """The class of a topic of this type, such as "network_analysis/NetworkDelay".

    Raises:
        LinkRoverError: a type that is not known here.
    """
    found = definitions(name)
    return sample_class_of(name, found, Codec(name, found))


def sample_class_of(name: str, found: Definitions, codec: Codec) -> type[Sample]:
    """The same from definitions."""
    made = idl_class(name, found)
    # not a base class: cyclonedds takes the first base of a type for its IDL parent
    for method in ("__init__", "serialize", "deserialize", "deserialize_key"):
        setattr(made, method, Sample.__dict__[method])
    made.codec = codec
    return made  # type: ignore[no-any-return]


_ZERO = {"bool": False, "float32": 0.0, "float64": 0.0, "string": "", "wstring": ""}


def complete(name: str, given: Mapping[str, Any], found: Definitions | None = None) -> Message:
    """`given` with zeros, as ROS has them, for all fields it leaves out.

    Raises:
        LinkRoverError: a field the type does not have, or a type that is not known here.
    """
    found = definitions(name) if found is None else found
    message = {field.name: _value(field, given.get(field.name), found) for field in found[name]}
    strange = [key for key in given if key not in message]
    if strange:
        raise LinkRoverError(f"{name} has no field '{strange[0]}' (it has: {', '.join(message)})")
    return message


def _value(field: Field, value: Any, found: Definitions) -> Any:
    if "/" not in field.type:
        if value is not None:
            return value
        zero = _ZERO.get(field.type, 0)
        return zero if field.count is None else [zero] * max(field.count, 0)
    if field.count is None:
        return complete(field.type, value or {}, found)
    return [complete(field.type, one, found) for one in value or [{}] * max(field.count, 0)]
