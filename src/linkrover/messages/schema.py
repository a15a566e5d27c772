"""ROS message texts -> fields. Reads ROS 1 and ROS 2 texts, ours and those embedded in foreign recordings."""

from __future__ import annotations

import re

import msgspec

from linkrover.errors import ParseError


class Field(msgspec.Struct, frozen=True):
    """One field. `type` is a primitive or "package/Name"; count: None = one value, -1 = any number, n = exactly n."""

    name: str
    type: str
    count: int | None = None


Definitions = dict[str, tuple[Field, ...]]

# struct code of every primitive; char and byte are uint8 in ROS 2 and in ROS 1 bags alike
PRIMITIVES = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
STRINGS = ("string", "wstring")
_MAX_FIELDS = 10_000

_LINE = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?P<bound><=\d+)?(?P<array>\[(?P<count><=\d+|\d+)?\])?\s+(?P<name>[A-Za-z]\w*)(?P<rest>.*)"
)
_ROS1_TIME = {"time": "ros1/Time", "duration": "ros1/Duration"}
# what a ROS 1 primitive time is made of; named as in ROS 2 so that one mapping reads both
ROS1_TIMES: Definitions = {
    "ros1/Time": (Field("sec", "uint32"), Field("nanosec", "uint32")),
    "ros1/Duration": (Field("sec", "int32"), Field("nanosec", "int32")),
}


def parse_text(text: str, name: str) -> tuple[Field, ...]:
    """Fields of one message text; `name` is its "package/Name". Raises ParseError."""
    package = name.partition("/")[0]
    fields: list[Field] = []
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.partition("#")[0].strip()
        if not line:
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            if re.match(r"[\w/<=]+\s+\w+\s*=", line):  # a string constant may hold anything
                continue
            raise ParseError(f"definition of {name}", f"line {number}", "a field or constant", repr(raw[:80]))
        if match["rest"].lstrip().startswith("="):
            continue  # a constant is not on the wire
        count = None if match["array"] is None else -1
        if match["count"] and match["count"].isdigit():
            count = int(match["count"])
            if count > _MAX_FIELDS:
                raise ParseError(
                    f"definition of {name}", f"line {number}", f"an array of at most {_MAX_FIELDS}", raw[:80]
                )
        fields.append(Field(match["name"], _full_name(match["type"], package), count))
    return tuple(fields)


def _full_name(type_name: str, package: str) -> str:
    if type_name in PRIMITIVES or type_name in STRINGS:
        return type_name
    if type_name in _ROS1_TIME:
        return _ROS1_TIME[type_name]
    if type_name == "Header":
        return "std_msgs/Header"
    if "/" not in type_name:
        return f"{package}/{type_name}"
    return short_name(type_name)


def short_name(type_name: str) -> str:
    """The ROS 1 spelling "package/Name" of "package/msg/Name"."""
    head, _, tail = type_name.partition("/")
    return f"{head}/{tail.rpartition('/')[2]}"


def parse_definitions(text: str, name: str) -> Definitions:
    """A definition as bags embed it: the root's text, then `MSG: package/Name` parts under lines of "=".

    Every type that is used must be there or be a part of this package (some writers leave std_msgs out).
    Raises ParseError.
    """
    root = short_name(name)
    sections: dict[str, list[str]] = {root: []}
    current = root
    lines = text.splitlines()
    for number, line in enumerate(lines):
        if len(line) >= 20 and not line.strip("="):
            if number + 1 >= len(lines) or not lines[number + 1].startswith("MSG:"):
                raise ParseError(f"definition of {name}", f"line {number + 2}", "MSG: package/Name")
            continue
        if line.startswith("MSG:") and number and lines[number - 1].startswith("=="):
            current = short_name(line[4:].strip())
            sections[current] = []
            continue
        sections[current].append(line)
    found: Definitions = dict(ROS1_TIMES)
    for section, body in sections.items():
        found[section] = parse_text("\n".join(body), section)
    _check(found, root)
    return found


def _check(found: Definitions, root: str) -> None:
    """Every type is there and none contains itself: a made-up definition must not send us round for ever."""
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> None:
        if name in above:
            raise ParseError(f"definition of {root}", name, "a type that does not contain itself")
        if name in done:
            return
        if name not in found:
            raise ParseError(f"definition of {root}", name, "the definition of this type")
        for field in found[name]:
            if "/" in field.type:
                visit(field.type, (*above, name))
        done.add(name)

    visit(root, ())
