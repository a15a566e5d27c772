"""Messages <-> bytes: CDR as ROS 2 writes it (XCDR1, little endian; OMG CDR 15.3) and ROS 1 serialisation.

A codec is compiled once per type into runs of fixed-size values, each packed by one struct call; no code is
generated, so a definition found in a file cannot become code.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Iterator
from typing import Any

from linkrover.errors import ParseError

from .schema import PRIMITIVES, STRINGS, Definitions, Field

CDR_HEADER = b"\x00\x01\x00\x00"  # plain CDR, little endian
_SIZES = {code: struct.calcsize(code) for code in PRIMITIVES.values()}

_PADDING = tuple(bytes(n) for n in range(8))

Message = dict[str, Any]
_Flatten = Callable[[Message, list[Any]], None]
_Build = Callable[[Iterator[Any]], Message]


# a recording repeats the same few strings
@functools.lru_cache(maxsize=1024)
def _cdr_string(value: str) -> bytes:
    # a lone surrogate (an undecodable SSID byte) must not cost the sample
    data = value.encode("utf-8", "replace")
    return (len(data) + 1).to_bytes(4, "little") + data + b"\0"


@functools.lru_cache(maxsize=1024)
def _ros1_string(value: str) -> bytes:
    data = value.encode("utf-8", "replace")
    return len(data).to_bytes(4, "little") + data


class _Run:
    """Consecutive fixed-size values. In CDR the padding depends on where the run begins, modulo eight."""

    def __init__(self, codes: str, aligned: bool, endian: str) -> None:
        self.count = len(codes)
        self.structs = [struct.Struct(endian + _padded(codes, start if aligned else None)) for start in range(8)]


def _padded(codes: str, start: int | None) -> str:
    if start is None:
        return codes
    text, position = [], start
    for code in codes:
        pad = -position % _SIZES[code]
        text.append("x" * pad + code)
        position += pad + _SIZES[code]
    return "".join(text)


class Codec:
    """Encoder and decoder of one message type.

    definitions: every type by its "package/Name"; name: the root; ros1: ROS 1 serialisation instead of CDR.
    """

    def __init__(self, name: str, definitions: Definitions, *, ros1: bool = False) -> None:
        self.name = name
        self.ros1 = ros1
        self._definitions = definitions
        self._plan = _Plan(name, definitions, ros1)

    def encode(self, message: Message) -> bytes:
        """The message's bytes. Raises struct.error where a number does not fit its field."""
        values: list[Any] = []
        self._plan.flatten(message, values)
        out = bytearray() if self.ros1 else bytearray(CDR_HEADER)
        try:
            self._plan.write(out, values, len(out))
        except OverflowError as error:
            raise struct.error(str(error)) from None
        return bytes(out)

    def decode(self, data: bytes | memoryview) -> Message:
        """The message in these bytes. Raises ParseError where they are too few or a count is impossible."""
        endian, start = "<", 0
        if not self.ros1:
            if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
                raise ParseError(self.name, "byte 0", "a plain CDR header", bytes(data[:4]).hex())
            endian, start = ("<" if data[1] else ">"), 4
        values: list[Any] = []
        try:
            self._plan.read(memoryview(data), start, start, values, endian)
            return self._plan.build(iter(values))
        except struct.error as error:
            raise ParseError(self.name, "message", "more bytes", f"{len(data)} ({error})") from None


class _Plan:
    """How one struct type is laid out. Nested single structs are flattened into it."""

    def __init__(self, name: str, definitions: Definitions, ros1: bool) -> None:
        self.name = name
        self.aligned = not ros1
        self.steps: list[tuple[str, Any, Any]] = []  # (kind, detail, element plan)
        self._codes = ""
        self.flatten, self.build = self._compile(name, definitions, ros1)
        self._end_run()
        if not self.steps and self.aligned:
            self.steps.append(("empty", None, None))  # ROS 2 gives an empty struct one byte
        self.minimum = sum({"run": 1, "string": 4, "empty": 1}.get(kind, 0) for kind, _, _ in self.steps)

    def _end_run(self) -> None:
        if self._codes:
            self.steps.append(
                ("run", (_Run(self._codes, self.aligned, "<"), _Run(self._codes, self.aligned, ">")), None)
            )
            self._codes = ""

    def _compile(self, name: str, definitions: Definitions, ros1: bool) -> tuple[_Flatten, _Build]:
        parts: list[tuple[str, _Flatten | None, _Build | None]] = []
        for field in definitions[name]:
            if "/" in field.type and field.count is None:
                flatten, build = self._compile(field.type, definitions, ros1)
                parts.append((field.name, flatten, build))
                continue
            parts.append((field.name, None, None))
            self._add_leaf(field, definitions, ros1)

        def flatten_all(message: Message, out: list[Any]) -> None:
            for key, inner, _ in parts:
                if inner is None:
                    out.append(message[key])
                else:
                    inner(message[key], out)

        def build_all(values: Iterator[Any]) -> Message:
            return {key: next(values) if inner is None else inner(values) for key, _, inner in parts}

        return flatten_all, build_all

    def _add_leaf(self, field: Field, definitions: Definitions, ros1: bool) -> None:
        if field.type in PRIMITIVES and field.count is None:
            self._codes += PRIMITIVES[field.type]
            return
        self._end_run()
        if field.count is None:
            self.steps.append((field.type, None, None))
        elif field.type in PRIMITIVES:
            self.steps.append(("values", (PRIMITIVES[field.type], field.count), None))
        elif field.type in STRINGS:
            self.steps.append(("strings", (field.type, field.count), None))
        else:
            self.steps.append(("structs", field.count, _Plan(field.type, definitions, ros1)))

    def write(self, out: bytearray, values: list[Any], base: int) -> None:
        position = 0
        for kind, detail, plan in self.steps:
            if kind == "run":
                run = detail[0]
                end = position + run.count
                out += run.structs[(len(out) - base) & 7].pack(*values[position:end])
                position = end
                continue
            if kind == "empty":
                out.append(0)
                continue
            value = values[position]
            position += 1
            if kind in STRINGS:
                self._write_string(out, value, base, kind)
                continue
            count = detail if kind == "structs" else detail[1]
            if count == -1:
                self._align(out, base, 4)
                out += len(value).to_bytes(4, "little")
            elif len(value) != count:
                raise struct.error(f"{count} elements wanted, {len(value)} given")
            if kind == "values" and len(value):
                code = detail[0]
                self._align(out, base, _SIZES[code])
                out += struct.pack(f"<{len(value)}{code}", *value)
            elif kind == "strings":
                for one in value:
                    self._write_string(out, one, base, detail[0])
            elif kind == "structs":
                for one in value:
                    flat: list[Any] = []
                    plan.flatten(one, flat)
                    plan.write(out, flat, base)

    def _align(self, out: bytearray, base: int, size: int) -> None:
        if self.aligned:
            out += _PADDING[-(len(out) - base) % size]

    def _write_string(self, out: bytearray, value: str, base: int, kind: str) -> None:
        if kind == "wstring":
            raise struct.error("wide strings are read, not written")
        if self.aligned:
            out += _PADDING[-(len(out) - base) & 3]
            out += _cdr_string(value)
        else:
            out += _ros1_string(value)

    def read(self, data: memoryview, at: int, base: int, values: list[Any], endian: str) -> int:
        """Append the values found at `at`; the position after them."""
        for kind, detail, plan in self.steps:
            if kind == "run":
                packed = detail[endian == ">"].structs[(at - base) & 7]
                values += packed.unpack_from(data, at)
                at += packed.size
            elif kind == "empty":
                at += 1
            elif kind in STRINGS:
                value, at = self._read_string(data, at, base, endian, kind)
                values.append(value)
            else:
                count = detail if kind == "structs" else detail[1]
                if count == -1:
                    count, at = self._read_count(data, at, base, endian)
                items: list[Any] | tuple[Any, ...]
                if kind == "values":
                    size = _SIZES[detail[0]]
                    self._room(data, at, count, size)
                    if count:
                        at += -(at - base) % size if self.aligned else 0
                    items = struct.unpack_from(f"{endian}{count}{detail[0]}", data, at)
                    at += count * size
                elif kind == "strings":
                    self._room(data, at, count, 4)
                    items = []
                    for _ in range(count):
                        value, at = self._read_string(data, at, base, endian, detail[0])
                        items.append(value)
                else:
                    self._room(data, at, count, max(plan.minimum, 1))
                    items = []
                    for _ in range(count):
                        flat: list[Any] = []
                        at = plan.read(data, at, base, flat, endian)
                        items.append(plan.build(iter(flat)))
                values.append(items)
        return at

    def _read_count(self, data: memoryview, at: int, base: int, endian: str) -> tuple[int, int]:
        if self.aligned:
            at += -(at - base) % 4
        return struct.unpack_from(endian + "I", data, at)[0], at + 4

    def _room(self, data: memoryview, at: int, count: int, size: int) -> None:
        if count * size > len(data) - at:
            raise ParseError(self.name, f"byte {at}", f"at most {max(len(data) - at, 0) // size} elements", str(count))

    def _read_string(self, data: memoryview, at: int, base: int, endian: str, kind: str) -> tuple[str, int]:
        length, at = self._read_count(data, at, base, endian)
        if kind == "wstring":
            self._room(data, at, length, 2)
            end = at + 2 * length
            return bytes(data[at:end]).decode("utf-16-le" if endian == "<" else "utf-16-be", "replace"), end
        self._room(data, at, length, 1)
        end = at + length
        text = bytes(data[at : end - 1] if self.aligned and length else data[at:end])
        return text.decode("utf-8", "replace"), end
