"""Columns of messages -> data frames of records: sentinels become null, stamps become wall_ns."""

from __future__ import annotations

import enum
import functools
import types
import typing
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
import polars as pl

from linkrover.messages.mapping import RENAMED
from linkrover.records import Record, Unknown

from .blocks import Topic
from .layout import CodedColumn, Columns, Indices, ListColumn
from .patterns import Meaning

Convert = Callable[[Columns, Indices], tuple[pl.DataFrame, int]]
_HEAD = ("wall_ns", "mono_ns", "unknown")


class FieldInfo(msgspec.Struct, frozen=True):
    """A record field as a column. kind: int, float, str, bool, enum, struct, or a container's dtype decides."""

    name: str
    kind: str
    optional: bool
    dtype: Any
    default: Any
    hint: Any


@functools.cache
def fields_of(struct: type[msgspec.Struct]) -> tuple[FieldInfo, ...]:
    """The columns of a record type, or of a struct within one."""
    hints = typing.get_type_hints(struct)
    found = []
    for field in msgspec.structs.fields(struct):
        hint, optional = hints[field.name], False
        if typing.get_origin(hint) in (typing.Union, types.UnionType):
            (hint,) = (arg for arg in typing.get_args(hint) if arg is not type(None))
            optional = True
        default = None if field.default is msgspec.NODEFAULT else field.default
        if field.default_factory is not msgspec.NODEFAULT:
            default = field.default_factory()
        kind, dtype = _dtype(field.name, hint)
        found.append(FieldInfo(field.name, kind, optional, dtype, plain(default), hint))
    return tuple(found)


def _dtype(name: str, hint: Any) -> tuple[str, Any]:
    if name == "unknown":
        return "unknown", pl.List(pl.String)
    simple = {int: ("int", pl.Int64), float: ("float", pl.Float64), str: ("str", pl.String), bool: ("bool", pl.Boolean)}
    if hint in simple:
        return simple[hint]
    if typing.get_origin(hint) is tuple:
        return "list", pl.List(_dtype("", typing.get_args(hint)[0])[1])
    if typing.get_origin(hint) is dict:
        return "list", pl.List(pl.Struct({"key": pl.String, "value": pl.String}))
    if issubclass(hint, enum.Enum):
        return "enum", pl.String
    return "struct", pl.Struct({field.name: field.dtype for field in fields_of(hint)})


@functools.cache
def schema_of(kind: type[Record]) -> dict[str, Any]:
    """Column types of a record type's frame: `end`, then the record's fields."""
    return {"end": pl.String} | {field.name: field.dtype for field in fields_of(kind)}


def plain(value: Any) -> Any:
    """A record's value as a column holds it."""
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, dict):
        return [{"key": key, "value": plain(one)} for key, one in value.items()]
    if isinstance(value, tuple):
        return [plain(one) for one in value]
    if isinstance(value, msgspec.Struct):
        return {name: plain(getattr(value, name)) for name in value.__struct_fields__}
    return value


def from_records(kind: type[Record], records: Sequence[Record], end: str) -> pl.DataFrame:
    """A frame of records, one by one."""
    columns: dict[str, Any] = {"end": [end] * len(records)}
    for field in fields_of(kind):
        if field.kind == "unknown":
            columns[field.name] = [[f"{k}={v.value}" for k, v in record.unknown.items()] for record in records]
        else:
            columns[field.name] = [plain(getattr(record, field.name)) for record in records]
    return pl.DataFrame(columns, schema=schema_of(kind))


def complete(kind: type[Record], end: str, known: dict[str, Any], rows: int) -> pl.DataFrame:
    """A frame of these columns; the record's defaults in all others."""
    columns: list[pl.Series] = []
    for name, dtype in schema_of(kind).items():
        value = known.get(name)
        if isinstance(value, pl.Series):
            columns.append(value.alias(name).cast(dtype))
        elif value is not None:
            columns.append(pl.Series(name, value, dtype=dtype))
        else:
            columns.append(repeated(name, _default(kind, name, end), dtype, rows))
    return pl.DataFrame(columns)


def _default(kind: type[Record], name: str, end: str) -> Any:
    if name == "end":
        return end
    return next(field.default for field in fields_of(kind) if field.name == name)


def repeated(name: str, value: Any, dtype: Any, rows: int) -> pl.Series:
    """A column of one value."""
    found: pl.Series = pl.Series(name, [value], dtype=dtype).new_from_index(0, rows)
    return found


def convert(topic: Topic, meaning: Meaning) -> Convert:
    """How a topic's columns become a frame. May keep what the next batch needs."""
    if meaning.native:
        return functools.partial(_native, meaning)
    from .columns_foreign import foreign

    return foreign(topic, meaning)


def stamps(columns: Columns) -> Indices:
    """header.stamp, ns since the epoch."""
    sec = number(columns, "header.stamp.sec")
    return sec.astype(np.int64) * 1_000_000_000 + number(columns, "header.stamp.nanosec").astype(np.int64)


def number(columns: Columns, path: str) -> npt.NDArray[Any]:
    """A numeric column; zeros where the batch had no message that fits."""
    column = columns.columns.get(path)
    return column if isinstance(column, np.ndarray) else np.zeros(columns.rows)


def texts(columns: Columns, path: str, *, empty: str | None = "") -> pl.Series:
    """A string column; `empty` stands where the message has an empty string."""
    column = columns.columns.get(path)
    if not isinstance(column, CodedColumn):
        return pl.Series([None] * columns.rows, dtype=pl.String)
    return gathered(column, [value or empty for value in column.values], pl.String)


def gathered(column: CodedColumn, values: Sequence[Any], dtype: Any) -> pl.Series:
    """The column with its codes replaced by these values; null where there is no code."""
    pool = pl.Series([*values, None], dtype=dtype)
    codes = np.where(column.codes < 0, len(values), column.codes)
    return pool.gather(pl.Series(codes, dtype=pl.UInt32))


def null_where(series: pl.Series, mask: npt.NDArray[np.bool_]) -> pl.Series:
    """The series with null where the mask is true."""
    if not mask.any():
        return series
    return pl.select(pl.when(pl.Series(~mask)).then(series)).to_series()


def _native(meaning: Meaning, columns: Columns, _: Indices) -> tuple[pl.DataFrame, int]:
    known: dict[str, Any] = {"wall_ns": stamps(columns), "mono_ns": number(columns, "mono_ns")}
    unfit = np.zeros(columns.rows, dtype=bool)
    for field in fields_of(meaning.kind):
        path = RENAMED.get(field.name, field.name)
        if field.name in _HEAD[:2]:
            continue
        found = _series(columns, path, field, unfit)
        if found is not None:
            known[field.name] = found
    frame = complete(meaning.kind, meaning.end, known, columns.rows)
    unfit &= ~columns.bad
    drop = columns.bad | unfit
    return (frame.filter(pl.Series(~drop)) if drop.any() else frame), int(unfit.sum())


def _series(columns: Columns, path: str, field: FieldInfo, unfit: npt.NDArray[np.bool_]) -> pl.Series | None:
    """One column; None where the messages do not have it. Marks rows that no record can be made of."""
    column = columns.columns.get(path)
    if field.kind == "struct":
        return _struct(columns, path, field, unfit)
    if column is None:
        return None
    if isinstance(column, ListColumn):
        return pl.Series([list(row or ()) for row in column.rows], dtype=field.dtype)
    if isinstance(column, CodedColumn):
        return _coded(column, field, unfit)
    return _numeric(column, field)


def _numeric(column: npt.NDArray[Any], field: FieldInfo) -> pl.Series | None:
    if field.kind == "int":
        if column.dtype.kind == "f":
            missing = ~(np.abs(column.astype(np.float64)) < 2.0**63)
            return null_where(pl.Series(np.where(missing, 0, column).astype(np.int64)), missing)
        found = pl.Series(column.astype(np.int64))
        return null_where(found, column == -1) if field.optional else found
    if field.kind == "float":
        found = pl.Series(column.astype(np.float64))
        return found.fill_nan(None) if field.optional else found
    if field.kind == "bool":
        found = pl.Series(column > 0)
        return null_where(found, column < 0) if field.optional else found
    return None


def _coded(column: CodedColumn, field: FieldInfo, unfit: npt.NDArray[np.bool_]) -> pl.Series:
    values: list[Any] = list(column.values)
    if field.kind == "enum":
        allowed = {one.value for one in field.hint} | ({""} if field.optional else set())
        _mark(column, [value not in allowed for value in values], unfit)
    elif field.kind == "unknown":
        reasons = {one.value for one in Unknown}
        _mark(column, [any(v.partition("=")[2] not in reasons for v in value) for value in values], unfit)
        # a reason said twice is said once, as in the record's dict
        values = [list(dict.fromkeys(value)) for value in values]
    elif field.kind == "list":
        values = [list(value) for value in values]
    if field.optional and field.kind in ("str", "enum"):
        values = [value or None for value in values]
    return gathered(column, values, field.dtype)


def _mark(column: CodedColumn, wrong: list[bool], unfit: npt.NDArray[np.bool_]) -> None:
    if any(wrong):
        unfit |= np.array([*wrong, False])[column.codes]


def _struct(columns: Columns, path: str, field: FieldInfo, unfit: npt.NDArray[np.bool_]) -> pl.Series | None:
    inner = [
        (one, _series(columns, f"{path}.{one.name}", one, unfit)) for one in fields_of(typing.cast("type", field.hint))
    ]
    if all(series is None for _, series in inner):
        return None
    known = columns.columns.get(f"{path}.known")
    frame = pl.DataFrame(
        [
            repeated(one.name, one.default, one.dtype, columns.rows) if series is None else series.alias(one.name)
            for one, series in inner
        ]
    )
    struct = frame.to_struct(field.name)
    return null_where(struct, known == 0) if isinstance(known, np.ndarray) else struct
