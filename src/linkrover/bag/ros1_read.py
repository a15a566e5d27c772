"""ROS 1 bags (format 2.0, wiki.ros.org/Bags/Format/2.0), indexed or not, whole or damaged, read from the beginning."""

from __future__ import annotations

import bz2
import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

from linkrover.errors import LinkRoverError, ParseError

from .blocks import Block, Problems, Raw, Topic

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG_HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_MAX_CHUNK = 1 << 30
_MAX_HEADER = 1 << 20


class Ros1File:
    """Reads one ROS 1 bag; the index at its end is not needed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[int, Topic] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self._problems = Problems()

    @property
    def problems(self) -> list[str]:
        """What was damaged or missing, as far as the file has been read."""
        return self._problems.all()

    def read_summary(self) -> bool:
        """Topics from the index at the end; False if the bag has none (it was not closed)."""
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                return False
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped, memoryview(mapped) as data:
                try:
                    header, _, _, _ = _record(data, len(MAGIC))
                    at = int.from_bytes(header[b"index_pos"], "little")
                    if not len(MAGIC) < at < len(data):
                        return False
                    while at < len(data):
                        header, start, end, at = _record(data, at)
                        if _op(header) == _CONNECTION:
                            self._connection(header, data[start:end])
                except (ParseError, KeyError):
                    return False
        return bool(self.topics)

    def blocks(self) -> Iterator[Block]:
        """All blocks there are. Raises LinkRoverError if this is no ROS 1 bag."""
        self._problems = Problems()
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise LinkRoverError(f"{self.path} is not a ROS 1 bag (format 2.0)")
            whole = file.read() if self.path.stat().st_size < (1 << 26) else None
            if whole is not None:
                yield from self._file(memoryview(whole), 0)
                return
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped, memoryview(mapped) as data:
                yield from self._file(data, len(MAGIC))

    def _file(self, data: memoryview, at: int) -> Iterator[Block]:
        indexed = False
        promised: int | None = None
        chunks = 0
        while at < len(data):
            try:
                header, start, end, following = _record(data, at)
                op = _op(header)
            except ParseError:
                good = _resync(data, at + 1)
                if good is None:
                    self._problems.add(f"cut off: the last {len(data) - at} bytes are no whole record")
                    break
                self._problems.add(f"{good - at} bytes at {at} are damaged and were left out")
                at = good
                continue
            at = following
            if op == _CHUNK:
                chunks += 1
                block = self._chunk(header, data[start:end])
                if block is not None:
                    yield block
            elif op == _CONNECTION:
                self._connection(header, data[start:end])
            elif op == _BAG_HEADER:
                indexed = int.from_bytes(header.get(b"index_pos", b""), "little") > 0
                promised = int.from_bytes(header.get(b"chunk_count", b""), "little")
            elif op == _MESSAGE:  # a bag without chunks
                bare = bytes(data[start:end])
                raw = self._raw(header, 0, len(bare))
                if raw is not None:
                    yield Block(bare, lambda raw=raw: iter((raw,)))  # type: ignore[misc]
        if not indexed:
            self._problems.add("not closed: it has no index (the recorder was killed)")
        elif promised is not None and chunks < promised:
            self._problems.add(f"{promised - chunks} of {promised} chunks are missing")

    def _chunk(self, header: dict[bytes, bytes], payload: memoryview) -> Block | None:
        compression = header.get(b"compression", b"none")
        size = int.from_bytes(header.get(b"size", b""), "little")
        try:
            data = _decompress(bytes(payload), compression, size)
        except ParseError as error:
            self._problems.add(f"a chunk of {size} bytes is damaged: {error}")
            return None
        # the connections first: a reader of one topic must know it before the first message
        view = memoryview(data)
        for op, fields, start, end in self._records(view):
            if op == _CONNECTION:
                self._connection(fields, view[start:end])
        return Block(data, lambda: self._messages(data))

    def _messages(self, data: bytes) -> Iterator[Raw]:
        for op, header, start, end in self._records(memoryview(data), report=True):
            if op == _MESSAGE:
                raw = self._raw(header, start, end)
                if raw is not None:
                    yield raw

    def _raw(self, header: dict[bytes, bytes], start: int, end: int) -> Raw | None:
        try:
            connection = int.from_bytes(header[b"conn"], "little")
            sec, nanosec = struct.unpack("<II", header[b"time"])
        except (KeyError, struct.error):
            self._problems.count("messages with a damaged header")
            return None
        if connection not in self.topics:
            self._problems.count("messages of a topic that is not declared")
            return None
        return Raw(connection, sec * 1_000_000_000 + nanosec, start, end)

    def _records(self, data: memoryview, *, report: bool = False) -> Iterator[tuple[int, dict[bytes, bytes], int, int]]:
        at = 0
        while at < len(data):
            try:
                header, start, end, following = _record(data, at)
                op = _op(header)
            except ParseError:
                good = _resync(data, at + 1)
                if report:
                    left = (len(data) if good is None else good) - at
                    self._problems.add(f"{left} bytes within a chunk are damaged and were left out")
                if good is None:
                    return
                at = good
                continue
            yield op, header, start, end
            at = following

    def _connection(self, header: dict[bytes, bytes], body: memoryview) -> None:
        try:
            number = int.from_bytes(header[b"conn"], "little")
            fields = _fields(body)
            self.topics.setdefault(
                number,
                Topic(
                    number,
                    fields.get(b"topic", header[b"topic"]).decode(),
                    fields[b"type"].decode(),
                    fields.get(b"message_definition", b"").decode("utf-8", "replace"),
                    ros1=True,
                    encoding="ros1",
                ),
            )
        except (KeyError, UnicodeDecodeError, ParseError):
            self._problems.count("connections that cannot be read")


def _op(header: dict[bytes, bytes]) -> int:
    op = header.get(b"op", b"")
    if len(op) != 1 or not _MESSAGE <= op[0] <= _CONNECTION:
        raise ParseError("ROS 1 bag", "record", "an operation from 2 to 7", op.hex())
    return op[0]


def _record(data: memoryview, at: int) -> tuple[dict[bytes, bytes], int, int, int]:
    """(header fields, data start, data end, next record)."""
    try:
        (length,) = struct.unpack_from("<I", data, at)
        if length > _MAX_HEADER or at + 4 + length + 4 > len(data):
            raise ParseError("ROS 1 bag", f"byte {at}", "a record header")
        header = _fields(data[at + 4 : at + 4 + length])
        start = at + 8 + length
        (size,) = struct.unpack_from("<I", data, start - 4)
    except struct.error:
        raise ParseError("ROS 1 bag", f"byte {at}", "a whole record") from None
    if start + size > len(data):
        raise ParseError("ROS 1 bag", f"byte {at}", "a whole record")
    return header, start, start + size, start + size


def _fields(data: memoryview) -> dict[bytes, bytes]:
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(data):
        if at + 4 > len(data):
            raise ParseError("ROS 1 bag", "header", "a field length")
        (length,) = struct.unpack_from("<I", data, at)
        at += 4
        if length == 0 or at + length > len(data):
            raise ParseError("ROS 1 bag", "header", "a whole field")
        name, separator, value = bytes(data[at : at + length]).partition(b"=")
        if not separator:
            raise ParseError("ROS 1 bag", "header", "name=value")
        fields[name] = value
        at += length
    return fields


def _resync(data: memoryview, at: int) -> int | None:
    """The next record: a header holding op=, found by trying the few bytes before each such text."""
    while True:
        found = _find(data, b"op=", at)
        if found is None:
            return None
        for start in range(max(at, found - 200), found - 7 + 1):
            if _begins_at(data, start):
                return start
        at = found + 1


def _begins_at(data: memoryview, at: int) -> bool:
    try:
        header, _, _, _ = _record(data, at)
        return _op(header) != _BAG_HEADER
    except ParseError:
        return False


def _find(data: memoryview, what: bytes, at: int) -> int | None:
    step = 1 << 20
    while at < len(data):
        place = bytes(data[at : at + step + len(what)]).find(what)
        if place >= 0:
            return at + place
        at += step
    return None


def _decompress(payload: bytes, compression: bytes, size: int) -> bytes:
    if size > _MAX_CHUNK:
        raise ParseError("chunk", "size", f"at most {_MAX_CHUNK} bytes", str(size))
    if compression == b"none":
        return payload
    try:
        if compression == b"bz2":
            return bz2.BZ2Decompressor().decompress(payload, max_length=size)
        if compression == b"lz4":
            import lz4.frame  # type: ignore[import-untyped]

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(payload, max_length=size))
    except (OSError, ValueError, RuntimeError, EOFError) as error:
        raise ParseError("chunk", "content", compression.decode(), str(error)) from None
    raise ParseError("chunk", "compression", "none, bz2 or lz4", repr(compression))
