"""Many messages of one type -> columns, by numpy.

Messages whose lengths agree in every string and array have every field at the same place. So messages are grouped
by length, a group's layout is found by walking the type's fields once, and a group whose length words do not all
agree is split. Each column is then one strided copy.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from linkrover.messages.schema import PRIMITIVES, STRINGS, Definitions

Bytes = npt.NDArray[np.uint8]
Indices = npt.NDArray[np.int64]
_DTYPES = {
    "?": "u1", "B": "u1", "b": "i1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8",
    "f": "<f4", "d": "<f8",
}  # fmt: skip
_CDR_BASE = 4


class CodedColumn:
    """Strings, or tuples of strings, as codes into what was met; codes are -1 where nothing was."""

    def __init__(self, rows: int) -> None:
        self.codes = np.full(rows, -1, dtype=np.int32)
        self.values: dict[str | tuple[str, ...], int] = {}

    def code(self, value: str | tuple[str, ...]) -> int:
        """The code of a value."""
        return self.values.setdefault(value, len(self.values))


class ListColumn:
    """A variable number of numbers a row."""

    def __init__(self, rows: int) -> None:
        self.rows: list[tuple[object, ...] | None] = [None] * rows


Column = npt.NDArray[np.generic] | CodedColumn | ListColumn


class UnfitTypeError(Exception):
    """The type holds arrays of messages or wide strings: its messages are decoded one by one."""


class Columns:
    """Columns by field path ("header.stamp.sec"), and which messages could not be decoded."""

    def __init__(self, rows: int) -> None:
        self.rows = rows
        self.columns: dict[str, Column] = {}
        self.bad = np.zeros(rows, dtype=bool)

    def numbers(self, path: str, dtype: str, shape: tuple[int, ...] = ()) -> npt.NDArray[np.generic]:
        """The numeric column of this path."""
        column = self.columns.get(path)
        if column is None:
            column = self.columns[path] = np.zeros((self.rows, *shape), dtype=dtype)
        assert isinstance(column, np.ndarray)
        return column

    def coded(self, path: str) -> CodedColumn:
        """The column of strings, or tuples of them, of this path."""
        column = self.columns.setdefault(path, CodedColumn(self.rows))
        assert isinstance(column, CodedColumn)
        return column

    def lists(self, path: str) -> ListColumn:
        """The list column of this path."""
        column = self.columns.setdefault(path, ListColumn(self.rows))
        assert isinstance(column, ListColumn)
        return column


class Layout:
    """Decoder of one message type into columns.

    skip: paths of fields that are walked over but not kept. Raises UnfitTypeError.
    """

    def __init__(
        self, name: str, definitions: Definitions, *, ros1: bool = False, skip: frozenset[str] = frozenset()
    ) -> None:
        self._ros1 = ros1
        self._base = 0 if ros1 else _CDR_BASE
        # (path, what, detail, kept): the type with its nested structs flattened
        self._fields = [(path, kind, count, path not in skip) for path, kind, count in _flat(name, definitions, "")]

    def decode(self, data: Bytes, starts: Indices, ends: Indices) -> Columns:
        """Columns of the messages data[start:end]. A message that does not fit its type is marked bad."""
        out = Columns(len(starts))
        lengths = ends - starts
        for length in np.unique(lengths):
            rows = np.flatnonzero(lengths == length)
            if length < self._base:
                out.bad[rows] = True
                continue
            windows = np.lib.stride_tricks.sliding_window_view(data, int(length))
            messages = windows[starts[rows]]
            if not self._ros1:
                fit = (messages[:, 0] == 0) & (messages[:, 1] == 1)
                if not fit.all():
                    out.bad[rows[~fit]] = True
                    messages, rows = messages[fit], rows[fit]
            if len(rows):
                self._group(messages, rows, out)
        return out

    def _group(self, messages: Bytes, rows: Indices, out: Columns) -> None:
        """Decode messages of one length, splitting them where a length word differs."""
        at = self._base
        todo: list[tuple[str, str, int, list[tuple[int, int]]]] = []
        for path, kind, count, kept in self._fields:
            if kind in PRIMITIVES and count is None:
                code = PRIMITIVES[kind]
                at = self._aligned(at, _size(code))
                todo.append((path, code if kept else "", at, []))
                at += _size(code)
                continue
            number = count if count is not None else 1
            if number == -1:
                at = self._aligned(at, 4)
                words = self._words(messages, at)
                if words is None or self._split(messages, rows, words, out):
                    self._spoiled(words, rows, out)
                    return
                number = int(words[0])
                at += 4
            if number > messages.shape[1]:
                out.bad[rows] = True
                return
            if kind in PRIMITIVES:
                code = PRIMITIVES[kind]
                at = self._aligned(at, _size(code)) if number else at
                todo.append((path, ("*" if count == -1 else "#") + code if kept else "", at, [(at, number)]))
                at += number * _size(code)
                continue
            places = []
            for _ in range(number):
                at = self._aligned(at, 4)
                words = self._words(messages, at)
                if words is None or self._split(messages, rows, words, out):
                    self._spoiled(words, rows, out)
                    return
                length = int(words[0])
                places.append((at + 4, at + 4 + length - (0 if self._ros1 else min(length, 1))))
                at += 4 + length
                if at > messages.shape[1]:
                    break
            todo.append((path, ("s" if count is None else "S") if kept else "", at, places))
        if at > messages.shape[1]:
            out.bad[rows] = True
            return
        for path, code, place, places in todo:
            if code:
                _keep(messages, rows, out, path, code, place, places)

    def _spoiled(self, words: npt.NDArray[np.uint32] | None, rows: Indices, out: Columns) -> None:
        if words is None:
            out.bad[rows] = True

    def _split(self, messages: Bytes, rows: Indices, words: npt.NDArray[np.uint32], out: Columns) -> bool:
        if (words == words[0]).all():
            return False
        for word in np.unique(words):
            mine = words == word
            self._group(messages[mine], rows[mine], out)
        return True

    def _words(self, messages: Bytes, at: int) -> npt.NDArray[np.uint32] | None:
        if at + 4 > messages.shape[1]:
            return None
        return np.ascontiguousarray(messages[:, at : at + 4]).view("<u4").ravel()

    def _aligned(self, at: int, size: int) -> int:
        return at if self._ros1 else at + -(at - _CDR_BASE) % size


def _keep(
    messages: Bytes, rows: Indices, out: Columns, path: str, code: str, place: int, places: list[tuple[int, int]]
) -> None:
    if code == "s":
        column = out.coded(path)
        column.codes[rows] = _codes(messages[:, places[0][0] : places[0][1]], column)
    elif code == "S":
        column = out.coded(path)
        column.codes[rows] = _tuple_codes([messages[:, start:end] for start, end in places], len(rows), column)
    elif code[0] in "*#":
        number = places[0][1]
        size = _size(code[1])
        part = np.ascontiguousarray(messages[:, place : place + number * size]).view(_DTYPES[code[1]])
        if code[0] == "#":
            out.numbers(path, _DTYPES[code[1]], (number,))[rows] = part
        else:
            found = out.lists(path).rows
            for row, values in zip(rows.tolist(), part.tolist(), strict=True):
                found[row] = tuple(values)
    else:
        part = np.ascontiguousarray(messages[:, place : place + _size(code)]).view(_DTYPES[code]).ravel()
        out.numbers(path, _DTYPES[code])[rows] = part


def _tuple_codes(parts: list[Bytes], rows: int, column: CodedColumn) -> npt.NDArray[np.int32]:
    """Codes of tuples whose n-th string is in the n-th part."""
    combined = np.zeros(rows, dtype=np.int64)
    for part in parts:
        texts = CodedColumn(0)
        codes = _codes(part, texts)
        # renumbered after every part, so that the product cannot overflow
        combined = np.unique(combined * len(texts.values) + codes, return_inverse=True)[1]
    first = np.unique(combined, return_index=True)[1]
    codes = np.empty(len(first), dtype=np.int32)
    for number, row in enumerate(first.tolist()):
        codes[number] = column.code(tuple(_decoded(part[row].tobytes()) for part in parts))
    return codes[combined]


def _codes(part: Bytes, column: CodedColumn) -> npt.NDArray[np.int32]:
    """Codes of the strings in these columns of bytes."""
    if part.shape[1] == 0:
        return np.full(len(part), column.code(""), dtype=np.int32)
    part = np.ascontiguousarray(part)
    if (part == part[0]).all():
        return np.full(len(part), column.code(_decoded(part[0].tobytes())), dtype=np.int32)
    keys = part.view(f"V{part.shape[1]}").ravel()
    found, inverse = np.unique(keys, return_inverse=True)
    codes = np.array([column.code(_decoded(key.tobytes())) for key in found], dtype=np.int32)
    return codes[inverse]


def _decoded(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _size(code: str) -> int:
    return int(np.dtype(_DTYPES[code]).itemsize)


def _flat(name: str, definitions: Definitions, prefix: str) -> Iterator[tuple[str, str, int | None]]:
    if not definitions[name]:
        raise UnfitTypeError(name)
    for field in definitions[name]:
        path = prefix + field.name
        if "/" not in field.type:
            if field.type in STRINGS and field.type != "string":
                raise UnfitTypeError(path)
            yield path, field.type, field.count
        elif field.count is None:
            yield from _flat(field.type, definitions, path + ".")
        else:
            raise UnfitTypeError(path)
