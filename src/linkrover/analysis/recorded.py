"""Recordings on a disk to the tables of each end, batch by batch."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from linkrover import records
from linkrover.errors import LinkRoverError
from linkrover.records import LinkEvent, ScanSnapshot

from .columns import FIELDS, KEYS, SINGLES, TEXTS, RawEnd

if TYPE_CHECKING:
    import polars as pl

    from linkrover.bag import Recording

    from .run import Columns

KINDS = ("robot", "station", "truth")
MOST_SCANS = 2000  # each holds every network in reach
MOST_POSES = 500_000  # a week of odometry is not needed to the 20 ms: every k-th pose of more than this


def read_raw(path: Path, topics: Path | None = None) -> tuple[dict[str, RawEnd], list[str]]:
    """The tables of every end found at `path`, and what was damaged or could not be read.

    Raises LinkRoverError if nothing at all can be read.
    """
    from linkrover.bag import find_recordings

    raws: dict[str, RawEnd] = {}
    problems: list[str] = []
    errors: list[LinkRoverError] = []
    for place in find_recordings(path):
        try:
            found, said = read_ends(place, topics)
        except LinkRoverError as error:
            errors.append(error)
            problems.append(f"{place.name}: cannot be read: {error}")
            continue
        problems += [f"{place.name}: {problem}" for problem in said]
        for end, raw in found.items():
            if end not in KINDS:
                problems.append(f"{place.name}: topics of '{end}' are of neither end and left out")
            elif end in raws:
                problems.append(f"{place.name}: a second recording of the {end}; the first one is used")
            else:
                raws[end] = raw
    if not any(end in raws and raws[end].tables for end in ("robot", "station")):
        if errors:
            raise errors[0]
        raise LinkRoverError(f"{path}: no samples of a robot or a station in it; 'linkrover info {path}' shows what is")
    return raws, problems


def read_ends(place: Path, topics: Path | None = None) -> tuple[dict[str, RawEnd], list[str]]:
    """The ends in one recording (a bag may hold both) and its problems. Pure and picklable, for spreading over many."""
    from linkrover.bag import DEFAULT_PATTERNS, load_patterns, read_recording
    from linkrover.bag.frames import iter_frames

    patterns = load_patterns(topics) if topics is not None else DEFAULT_PATTERNS
    recording = read_recording(place, patterns=patterns)
    problems: list[str] = []
    parts: dict[tuple[str, str, tuple[str, ...]], list[Columns]] = {}
    kinds = [getattr(records, name) for name in KEYS]
    thin = _thinning(recording, "Pose", MOST_POSES)
    for batch in iter_frames(place, kinds=kinds, patterns=patterns, problems=problems):
        for kind, frame in batch.items():
            _collect(parts, kind.__name__, frame, thin)
    raws: dict[str, RawEnd] = {}
    for (end, name, key), pieces in parts.items():
        raw = raws.setdefault(end, RawEnd())
        raw.tables.setdefault(name, {})[key] = _joined(pieces)
    if recording.end == "truth":
        raws = {"truth": raws.get("truth", RawEnd())}
    ours = recording.manifest is not None
    for end, raw in raws.items():
        raw.published_2021 = not ours
        if ours and (end == recording.end or len(raws) == 1):
            raw.manifest = recording.manifest
    if ours and recording.end not in raws:
        raws[recording.end] = RawEnd(manifest=recording.manifest)
    _take_single(recording, raws)
    return raws, list(dict.fromkeys([*recording.problems, *problems]))


def _take_single(recording: Recording, raws: dict[str, RawEnd]) -> None:
    """Events and scans: few, and no tables."""
    there = {topic.record for topic in recording.topics if topic.count}
    kinds = [kind for kind in (LinkEvent, ScanSnapshot) if kind.__name__ in there]
    if not kinds:
        return
    keep, scans = _thinning(recording, "ScanSnapshot", MOST_SCANS), 0
    for end, record in recording.entries(*kinds):
        if end not in raws:
            continue
        if isinstance(record, LinkEvent):
            raws[end].events.append(record)
        elif isinstance(record, ScanSnapshot):
            if scans % keep == 0:
                raws[end].scans.append(record)
            scans += 1


def _thinning(recording: Recording, kind: str, most: int) -> int:
    count = sum(topic.count for topic in recording.topics if topic.record == kind)
    return max(1, -(-count // most))


def _collect(
    parts: dict[tuple[str, str, tuple[str, ...]], list[Columns]], kind: str, frame: pl.DataFrame, thin: int
) -> None:
    names = [name for name in FIELDS[kind] if name.partition(".")[0] in frame.columns]
    nested = [name for name in names if "." in name]
    if nested:
        frame = frame.with_columns(_nested(frame, name) for name in nested)
    keys = ["end", *KEYS[kind]]
    groups = frame.select([*dict.fromkeys([*keys, "wall_ns", "mono_ns", *names])]).partition_by(
        keys, as_dict=True, include_key=True, maintain_order=True
    )
    for key, group in groups.items():
        if kind == "Pose" and thin > 1:
            group = group.gather_every(thin)
        end, *rest = ("" if part is None else str(part) for part in key)
        table: Columns = {n: group[n].to_numpy() for n in ("wall_ns", "mono_ns")}
        for name in names:
            table[name] = _text(group[name]) if name in TEXTS else _number(group[name])
        parts.setdefault((end, kind, tuple(rest)), []).append(table)


def _nested(frame: pl.DataFrame, name: str) -> pl.Series:
    outer, _, inner = name.partition(".")
    return frame[outer].struct.field(inner).alias(name)


def _text(series: pl.Series) -> Any:
    """Few different words over many rows: one object each."""
    import numpy as np
    import polars as pl

    if series.dtype != pl.String:
        series = series.cast(pl.String)
    words = series.unique()
    index = {word: i for i, word in enumerate(words.to_list())}
    if len(index) == 1:
        return np.broadcast_to(np.array(next(iter(index)), object), len(series))  # takes no room
    codes = series.replace_strict(
        list(index), list(range(len(index))), return_dtype=pl.Int32, default=index.get(None, -1)
    )
    return np.array(list(index), object)[codes.to_numpy()]


def _number(series: pl.Series) -> Any:
    import polars as pl

    if series.dtype == pl.Struct:
        series = series.struct.field("rate_bps")
    kind = pl.Float32 if series.name in SINGLES else pl.Float64
    return series.cast(kind, strict=False).fill_null(float("nan")).to_numpy()


def _joined(pieces: list[Columns]) -> Columns:
    if len(pieces) == 1:
        return pieces[0]
    return {name: _chained([piece.pop(name) for piece in pieces]) for name in list(pieces[0])}


def _chained(columns: list[Any]) -> Any:
    import numpy as np

    if columns[0].dtype == object and all(c.strides == (0,) and c[0] == columns[0][0] for c in columns):
        return np.broadcast_to(columns[0][:1].reshape(()), sum(len(c) for c in columns))
    return np.concatenate(columns)
