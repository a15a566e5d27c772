"""Recordings as data frames, fast: one column a record field, `end` beside them, null where unknown.

The same figures as `Recording.entries` gives one by one (a test holds them together), by numpy over many messages
at once. Needs the `report` extra.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from linkrover.errors import LinkRoverError, ParseError
from linkrover.records import Record

from .blocks import Block, Problems, Topic
from .columns import convert, from_records
from .interpret import Interpreter, checked_definitions, interpreter
from .layout import Indices, Layout, UnfitTypeError
from .patterns import DEFAULT_PATTERNS, Meaning, TopicPattern, meanings
from .reading import open_container, recording_files, topics_of

BATCH_BYTES = 32 * 1024 * 1024
Frames = dict[type[Record], pl.DataFrame]
_HEAD = 31  # bytes of an MCAP message record before the message


def read_frames(
    path: Path,
    *,
    kinds: Sequence[type[Record]] = (),
    patterns: Sequence[TopicPattern] = DEFAULT_PATTERNS,
    problems: list[str] | None = None,
) -> Frames:
    """All records of a recording (see `read_recording` for what `path` may be), by type, in the order of wall_ns.

    kinds: only these. problems: is appended what was damaged or missing. A type with no record is not in the result.
    Raises LinkRoverError if there is no recording.
    """
    parts: dict[type[Record], list[pl.DataFrame]] = {}
    for frames in iter_frames(path, kinds=kinds, patterns=patterns, problems=problems):
        for kind, frame in frames.items():
            parts.setdefault(kind, []).append(frame)
    return {
        kind: pl.concat(frames, rechunk=True).sort("wall_ns", maintain_order=True) for kind, frames in parts.items()
    }


def iter_frames(
    path: Path,
    *,
    kinds: Sequence[type[Record]] = (),
    patterns: Sequence[TopicPattern] = DEFAULT_PATTERNS,
    batch_bytes: int = BATCH_BYTES,
    problems: list[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Frames]:
    """As `read_frames`, in batches of about `batch_bytes` of messages in file order: memory stays bounded."""
    files = recording_files(path)
    total = sum(file.stat().st_size for file in files) or 1
    before = 0
    for file in files:
        container = open_container(file)
        known = meanings(topics_of(container), patterns)
        decoder = _Decoder(known, frozenset(kinds))
        blocks: list[Block] = []
        held = 0
        for block in container.blocks():
            blocks.append(block)
            held += len(block.data)
            if held >= batch_bytes:
                yield decoder.decode(blocks, container.topics)
                blocks, held = [], 0
        if blocks:
            yield decoder.decode(blocks, container.topics)
        before += file.stat().st_size
        if progress is not None:
            progress(before / total)
        if problems is not None:
            problems += container.problems
            problems += decoder.problems.all()


class _Decoder:
    """Decodes batches of one file; keeps per topic what a rate needs from the batch before."""

    def __init__(self, known: dict[int, Meaning], kinds: frozenset[type[Record]]) -> None:
        self.problems = Problems()
        self._known = {t: m for t, m in known.items() if not kinds or m.kind in kinds}
        self._kinds = kinds
        self._readers: dict[int, _Vectorised | Interpreter | None] = {}

    def decode(self, blocks: list[Block], topics: dict[int, Topic]) -> Frames:
        data = np.frombuffer(b"".join(block.data for block in blocks), dtype=np.uint8)
        parts: dict[type[Record], list[pl.DataFrame]] = {}
        for topic_id, (times, starts, ends) in _places(blocks, data, self._known).items():
            meaning = self._known[topic_id]
            reader = self._reader(topics[topic_id], meaning)
            if isinstance(reader, _Vectorised):
                frames = reader.frames(data, times, starts, ends, self.problems)
            elif reader is not None:
                frames = self._one_by_one(reader, data, times, starts, ends)
            else:
                continue
            for kind, frame in frames.items():
                if len(frame) and (not self._kinds or kind in self._kinds):
                    parts.setdefault(kind, []).append(frame)
        return {kind: pl.concat(frames) for kind, frames in parts.items()}

    def _reader(self, topic: Topic, meaning: Meaning) -> _Vectorised | Interpreter | None:
        if topic.id not in self._readers:
            self._readers[topic.id] = self._new_reader(topic, meaning)
        return self._readers[topic.id]

    def _new_reader(self, topic: Topic, meaning: Meaning) -> _Vectorised | Interpreter | None:
        found = interpreter(topic, meaning)
        if isinstance(found, LinkRoverError):
            self.problems.add(f"{topic.name} cannot be read: {found}")
            return None
        try:
            return _Vectorised(topic, meaning)
        except UnfitTypeError:
            return found

    def _one_by_one(
        self, reader: Interpreter, data: np.ndarray, times: Indices, starts: Indices, ends: Indices
    ) -> Frames:
        found: dict[type[Record], list[Record]] = {}
        view = memoryview(data)  # type: ignore[arg-type]
        for log_ns, start, end in zip(times.tolist(), starts.tolist(), ends.tolist(), strict=True):
            for record in self._read(reader, view[start:end], log_ns):
                found.setdefault(type(record), []).append(record)
        return {kind: from_records(kind, records, reader.meaning.end) for kind, records in found.items()}

    def _read(self, reader: Interpreter, data: memoryview, log_ns: int) -> tuple[Record, ...]:
        try:
            return reader.records(data, log_ns)
        except ParseError:
            self.problems.count(f"messages on {reader.topic.name} cannot be decoded")
            return ()


class _Vectorised:
    """Decodes one topic's messages at once."""

    def __init__(self, topic: Topic, meaning: Meaning) -> None:
        self.topic = topic
        self.meaning = meaning
        skip = frozenset(("pose.covariance", "twist.covariance"))
        definitions = checked_definitions(topic, native=meaning.native)
        self._layout = Layout(topic.type, definitions, ros1=topic.ros1, skip=skip)
        self._convert = convert(topic, meaning)

    def frames(self, data: np.ndarray, times: Indices, starts: Indices, ends: Indices, problems: Problems) -> Frames:
        columns = self._layout.decode(data, starts, ends)
        bad = int(columns.bad.sum())
        if bad:
            problems.count(f"messages on {self.topic.name} cannot be decoded", bad)
        frame, unfit = self._convert(columns, times)
        if unfit:
            problems.count(f"messages on {self.topic.name} cannot be decoded", unfit)
        return {self.meaning.kind: frame}


def _places(
    blocks: list[Block], data: np.ndarray, known: dict[int, Meaning]
) -> dict[int, tuple[Indices, Indices, Indices]]:
    """By topic: log times, and where in `data` its messages begin and end, in file order."""
    found: dict[int, list[tuple[Indices, Indices, Indices]]] = {}
    base = 0
    for block in blocks:
        size = len(block.data)
        indexed = None if block.index is None else _from_index(block.index, data[base : base + size], known)
        for topic, (times, starts, ends) in (indexed if indexed is not None else _from_walk(block, known)).items():
            found.setdefault(topic, []).append((times, starts + base, ends + base))
        base += size
    return {
        topic: (
            np.concatenate([times for times, _, _ in parts]),
            np.concatenate([starts for _, starts, _ in parts]),
            np.concatenate([ends for _, _, ends in parts]),
        )
        for topic, parts in found.items()
    }


def _from_index(
    index: dict[int, bytes], data: np.ndarray, known: dict[int, Meaning]
) -> dict[int, tuple[Indices, Indices, Indices]] | None:
    """From the chunk's own message index; None if it does not fit the chunk."""
    found = {}
    for topic, entries in index.items():
        if topic not in known:
            continue
        if len(entries) % 16:
            return None
        pairs = np.frombuffer(entries, dtype="<u8").reshape(-1, 2)
        pairs = pairs[np.argsort(pairs[:, 1], kind="stable")]
        offsets = pairs[:, 1].astype(np.int64)
        if len(offsets) == 0:
            continue
        if offsets[0] < 0 or offsets[-1] + _HEAD > len(data):
            return None
        heads = np.lib.stride_tricks.sliding_window_view(data, _HEAD)[offsets]
        lengths = np.ascontiguousarray(heads[:, 1:9]).view("<u8").ravel().astype(np.int64)
        channels = np.ascontiguousarray(heads[:, 9:11]).view("<u2").ravel()
        ends = offsets + 9 + lengths
        if (heads[:, 0] != 5).any() or (channels != topic).any() or (lengths < 22).any() or (ends > len(data)).any():
            return None
        found[topic] = (pairs[:, 0].astype(np.int64), offsets + _HEAD, ends)
    return found


def _from_walk(block: Block, known: dict[int, Meaning]) -> dict[int, tuple[Indices, Indices, Indices]]:
    found: dict[int, tuple[list[int], list[int], list[int]]] = {}
    for raw in block.walk():
        if raw.topic not in known:
            continue
        entry = found.setdefault(raw.topic, ([], [], []))
        entry[0].append(raw.log_ns)
        entry[1].append(raw.start)
        entry[2].append(raw.end)
    return {
        topic: (np.array(times, dtype=np.int64), np.array(starts, dtype=np.int64), np.array(ends, dtype=np.int64))
        for topic, (times, starts, ends) in found.items()
    }
