"""One CSV file of the 2021 data as numbers: columns by name, every mending of a row or cell on a list."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from linkrover.errors import ParseError

if TYPE_CHECKING:
    import numpy as np
    import polars as pl
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Times = NDArray[np.int64]

NOTHING_YET = -2.0  # what the 2021 writer put before a topic's first message
ODOMETRY_HZ = 50
MAX_STEPS = 100 * 3600 * ODOMETRY_HZ
FAMILY = ("time_stamp", "network_delay")
_NEEDED = "a CSV file of the 2021 measurements (columns time_stamp, network_delay and c_* or s_*)"
_MAX_BYTES = 2 << 30


@dataclass(frozen=True, slots=True)
class Sheet:
    """The sound rows of a file. `columns` are float64 without gaps; `summary` holds cells of appended rows."""

    file: str
    wall_ns: Times
    columns: dict[str, Floats]
    rows_read: int
    summary: dict[str, list[float]] = field(default_factory=dict)
    repairs: tuple[str, ...] = ()


def read_sheet(path: str | Path) -> Sheet:
    """Read one file of the family, whatever its column order, padding, separators and number format.

    Raises ParseError for any other file, naming what was looked for.
    """
    path = Path(path)
    name = str(path)
    try:
        size = path.stat().st_size
        data = path.read_bytes() if size <= _MAX_BYTES else b""
    except OSError as error:
        raise ParseError(name, "file", "a readable CSV file", error.strerror or str(error)) from error
    if size > _MAX_BYTES:
        raise ParseError(name, "file", "at most 2 GiB", f"{size} bytes")
    return parse_sheet(data, name)


def parse_sheet(data: bytes, file: str) -> Sheet:
    """The same from bytes; pure. Only ParseError escapes."""
    repairs: list[str] = []
    if not data.strip():
        raise ParseError(file, "byte 0", _NEEDED, "an empty file")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        data = data.decode("utf-16", errors="replace").encode()
        repairs.append("file was UTF-16")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\0" in data:
        raise ParseError(file, f"byte {data.index(0)}", _NEEDED, "a binary file")
    separator, names = _header(data, file)
    columns = _numbers(_cells(data, separator, names, file), repairs)
    return _sound_rows(columns, file, repairs)


def _header(data: bytes, file: str) -> tuple[str, list[str]]:
    """The separator and the column names of the first line."""
    end = data.find(b"\n")
    line = data[: end if end >= 0 else len(data)][:65536].decode("utf-8", errors="replace").rstrip("\r")
    separator = max((",", ";", "\t"), key=line.count)
    try:
        cells = next(csv.reader(io.StringIO(line), delimiter=separator), [])
    except csv.Error as error:
        raise ParseError(file, "line 1", _NEEDED, str(error)) from error
    names = [name.strip().lower() for name in cells]
    missing = [name for name in FAMILY if name not in names]
    if missing or not any(name.startswith(("c_", "s_")) for name in names):
        got = ", ".join(filter(None, names))[:100] or "no column names"
        raise ParseError(file, "line 1", _NEEDED, f"{got}{' ...' if len(names) > 8 else ''}")
    doubled = sorted({name for name in names if name and names.count(name) > 1})
    if doubled:
        raise ParseError(file, "line 1", "every column once", f"twice: {', '.join(doubled)}")
    return separator, names


def _cells(data: bytes, separator: str, names: list[str], file: str) -> pl.DataFrame:
    """Every named column: the time stamp as text, the others as numbers (null = no number there)."""
    import polars as pl

    # no number holds a blank, so padding can go before anything is parsed
    data = data.replace(b" ", b"")
    if separator == ";":
        data = data.replace(b",", b".")
    if data.count(b'"') % 2:  # polars panics on some of these
        raise ParseError(file, "line 2 or later", "every quotation mark closed", "one that stays open")
    labels = [name or f"#{i}" for i, name in enumerate(names)]
    head = separator.join(f'"{label}"' for label in labels).encode()
    try:
        return pl.read_csv(
            io.BytesIO(head + data[data.find(b"\n") :]),
            separator=separator,
            schema_overrides={label: pl.String if label == "time_stamp" else pl.Float64 for label in labels},
            columns=[label for label in labels if not label.startswith("#")],
            ignore_errors=True,
            truncate_ragged_lines=True,
            encoding="utf8-lossy",
        )
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise ParseError(file, "line 2", "rows of numbers", str(error).splitlines()[0]) from error


def _numbers(frame: pl.DataFrame, repairs: list[str]) -> dict[str, Floats | Times]:
    """Columns as float64 (NaN = no number there); `time_stamp` in integer nanoseconds (-1 = none)."""
    import numpy as np
    import polars as pl

    exact = pl.col("time_stamp").cast(pl.Int64, strict=False)
    rounded = pl.col("time_stamp").cast(pl.Float64, strict=False)
    rounded = pl.when(rounded.is_between(0, 9e18)).then(rounded).round().cast(pl.Int64, strict=False)
    stamps = frame.select(pl.coalesce(exact, rounded).fill_null(-1).alias("ns"), exact.is_null().alias("inexact"))
    lost = int((stamps["inexact"] & (stamps["ns"] >= 0)).sum())
    if lost:
        repairs.append(f"{lost} time stamps printed in exponent form: digits lost, kept as printed (about 10 us)")
    out: dict[str, Floats | Times] = {"time_stamp": stamps["ns"].to_numpy()}
    for column in frame.drop("time_stamp").iter_columns():
        values = column.to_numpy()  # null becomes NaN
        out[column.name] = np.where(np.isinf(values), np.nan, values)
    return out


def _sound_rows(columns: dict[str, Floats | Times], file: str, repairs: list[str]) -> Sheet:
    """Drop what is no row, put the clock right, fill single holes; say all of it."""
    import numpy as np

    wall = columns.pop("time_stamp").astype(np.int64)
    read = len(wall)
    step = columns.get("time_step")
    is_row = (wall > 0) & (np.isfinite(step) if step is not None else True)
    summary: dict[str, list[float]] = {}
    if not is_row.all():
        dropped = np.flatnonzero(~is_row)
        for name, values in columns.items():
            kept = values[dropped][np.isfinite(values[dropped])]
            if len(kept):
                summary[name] = [float(v) for v in kept]
        lines = ", ".join(str(i + 2) for i in dropped[:5])
        repairs.append(
            f"{len(dropped)} rows without time stamp dropped (summary or broken rows; lines {lines}"
            f"{', ...' if len(dropped) > 5 else ''}); their cells are kept in the manifest's notes"
        )
        wall = wall[is_row]
        columns = {name: values[is_row] for name, values in columns.items()}
    if len(wall) < 2:
        raise ParseError(file, "line 2", "at least two rows with a time stamp", f"{len(wall)}")
    wall, columns = _put_clock_right(wall, columns, repairs)
    holes = {n: int(np.isnan(v).sum()) for n, v in columns.items()}
    empty = sorted(n for n, count in holes.items() if count == len(wall))
    for name in empty:
        del columns[name]
    if empty:
        repairs.append(f"columns without any number left out: {', '.join(empty)}")
    for name, count in holes.items():
        if count and name in columns:
            columns[name] = _fill(columns[name])
            repairs.append(f"{name}: {count} cells without a number took the value of the row before")
    return Sheet(file, wall, columns, read, summary, tuple(repairs))  # type: ignore[arg-type]


def _put_clock_right(
    wall: Times, columns: dict[str, Floats | Times], repairs: list[str]
) -> tuple[Times, dict[str, Floats | Times]]:
    """Strictly increasing stamps: sort, drop doubles, rebuild from the odometry sequence where digits are gone."""
    import numpy as np

    step = columns.get("time_step")
    coarse = len(np.unique(wall)) < 0.9 * len(wall)
    if step is not None and coarse and (np.diff(step) > 0).all() and np.ptp(step) < MAX_STEPS:
        repairs.append(
            f"time stamps too coarse ({len(np.unique(wall))} distinct in {len(wall)} rows): times rebuilt from the "
            f"odometry sequence at {ODOMETRY_HZ} Hz; the absolute time is that of the first stamp"
        )
        return wall[0] + ((step - step[0]) * (1_000_000_000 // ODOMETRY_HZ)).astype(np.int64), columns
    backwards = int((np.diff(wall) < 0).sum())
    if backwards:
        order = np.argsort(wall, kind="stable")
        wall = wall[order]
        columns = {name: values[order] for name, values in columns.items()}
        repairs.append(f"{backwards} rows out of time order: sorted by time stamp")
    fresh = np.concatenate(([True], np.diff(wall) > 0))
    if not fresh.all():
        repairs.append(f"{int((~fresh).sum())} rows with the stamp of the row before dropped")
        wall = wall[fresh]
        columns = {name: values[fresh] for name, values in columns.items()}
    return wall, columns


def _fill(values: Floats | Times) -> Floats:
    """Carry the last number forward; before the first one nothing had been received."""
    import numpy as np

    known = np.isfinite(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.where(last >= 0, values[np.maximum(last, 0)], NOTHING_YET)
