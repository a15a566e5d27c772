"""MCAP files, finished or journals, whole or damaged: every whole message, and what is missing."""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Metadata, Schema, Statistics

from linkrover.errors import LinkRoverError, ParseError
from linkrover.messages.schema import short_name

from .blocks import Block, Problems, Raw, Topic
from .container import MAGIC, MESSAGE_HEAD, RECORD_HEAD, release, stream, whole_records

_MAX_CHUNK = 1 << 30  # bytes a chunk may claim to hold; more is damage or an attack
_PRIVATE = 0x80  # opcodes from here on are for private use and are skipped
_CHUNK_HEAD = struct.Struct("<QQQI")
_STRETCH = 1 << 22  # bytes of bare messages handed on at once
_DAY_NS = 86_400_000_000_000
# an opcode, then a length below 4 GiB
_CANDIDATE = re.compile(rb"[\x01-\x0f].{4}\x00{4}", re.DOTALL)
_BROKEN = (McapError, ValueError, struct.error, IndexError, KeyError, EOFError, MemoryError, OverflowError)


class McapFile:
    """Reads one file from its beginning, record by record; the summary only helps.

    After damage the walk goes on at the next record that makes sense and is followed by another that does.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[int, Topic] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.statistics: Statistics | None = None
        self.finished = False  # the file has its summary
        self._schemas: dict[int, Schema] = {}
        self._problems = Problems()
        self._seen: dict[int, int] = {}
        self._last_ns = 0

    @property
    def problems(self) -> list[str]:
        """What was damaged or missing, as far as the file has been read."""
        return self._problems.all()

    def read_summary(self) -> bool:
        """Topics, statistics and metadata from the end of the file; False if it has none that is whole."""
        with self._mapped() as data:
            return self._read_summary(data) if data is not None else False

    def blocks(self) -> Iterator[Block]:
        """All blocks there are. Raises LinkRoverError if this is no MCAP file at all."""
        self._problems = Problems()
        self._seen = {}
        with self._mapped() as data:
            if data is None:
                self._problems.add("the file is empty")
                return
            self._read_summary(data)
            yield from self._file(data)
            self._compare()

    def salvage(self, data: memoryview, at: int) -> Iterator[tuple[int, int, int]]:
        """(opcode, start, end) of every record from `at` on that makes sense, past whatever is damaged between."""
        for opcode, start, end in self._walk(data, at, ""):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._other(opcode, data[start + 9 : end])  # what is searched for after damage are their messages
            if end <= len(data):
                yield opcode, start, end

    def _mapped(self) -> _Mapped:
        return _Mapped(self.path)

    def _read_summary(self, data: memoryview) -> bool:
        tail = 9 + 20 + len(MAGIC)
        if len(data) < len(MAGIC) + tail or data[-len(MAGIC) :] != MAGIC or data[len(data) - tail] != Opcode.FOOTER:
            return False
        footer = Footer.read(stream(data[len(data) - tail + 9 : -len(MAGIC)]))
        end = len(data) - tail
        self.finished = True
        if not 0 < footer.summary_start <= end:
            return False
        section = data[footer.summary_start : end]
        checked = zlib.crc32(data[end : end + 9 + 16], zlib.crc32(section))
        if footer.summary_crc and footer.summary_crc != checked:
            self._problems.add("the summary at the end is damaged; the messages were read without it")
            return False
        at = footer.summary_start
        try:
            while at < end:
                opcode, length = RECORD_HEAD.unpack_from(data, at)
                self._summary_record(opcode, data[at + 9 : at + 9 + length], data)
                at += 9 + length
        except _BROKEN as error:
            self._problems.add(f"the summary at the end cannot be read ({error})")
            return False
        return True

    def _summary_record(self, opcode: int, body: memoryview, data: memoryview) -> None:
        if opcode == Opcode.STATISTICS:
            self.statistics = Statistics.read(stream(body))
        elif opcode == Opcode.METADATA_INDEX:
            at = int.from_bytes(body[:8], "little")
            length = int.from_bytes(body[8:16], "little")
            if data[at] == Opcode.METADATA:
                self._take_metadata(data[at + 9 : at + length])
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define(opcode, body)
        elif opcode == Opcode.CHUNK_INDEX:
            ChunkIndex.read(stream(body))

    def _take_metadata(self, body: memoryview) -> None:
        metadata = Metadata.read(stream(body))
        self.metadata[metadata.name] = dict(metadata.metadata)

    def _define(self, opcode: int, body: memoryview) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream(body))
            self._schemas.setdefault(schema.id, schema)
            return
        channel = Channel.read(stream(body))
        found = self._schemas.get(channel.schema_id)
        if channel.id in self.topics and (found is None or self.topics[channel.id].definition):
            return
        self.topics[channel.id] = Topic(
            channel.id,
            channel.topic,
            short_name(found.name) if found else "",
            found.data.decode("utf-8", "replace") if found and found.encoding in ("ros2msg", "ros1msg") else "",
            ros1=channel.message_encoding == "ros1",
            encoding=channel.message_encoding,
        )

    def _file(self, data: memoryview) -> Iterator[Block]:
        if data[: len(MAGIC)] != MAGIC:
            alike = sum(a == b for a, b in zip(bytes(data[: len(MAGIC)]), MAGIC, strict=False))
            if _CANDIDATE.search(data) is None or alike < len(MAGIC) // 2:
                raise LinkRoverError(f"{self.path} is neither an MCAP file nor a ROS 1 bag")
            self._problems.add("the first bytes of the file are damaged")
        bare: tuple[int, int] | None = None  # a stretch of messages outside chunks, not yielded yet
        chunk: tuple[int, int, dict[int, bytes]] | None = None  # a chunk whose index records are being collected
        index_end = 0
        ended = False
        for opcode, at, end in self._walk(data, len(MAGIC), ""):
            if chunk is not None:
                if opcode == Opcode.MESSAGE_INDEX and at == index_end:
                    index_end = end if _take_index(data[at + 9 : end], chunk[2]) else -1
                    continue
                # an index of which a part is cut off or damaged would hide messages
                yield from self._chunk(data[chunk[0] + 9 : chunk[1]], chunk[2] if at == index_end else {})
                chunk = None
            if opcode == Opcode.MESSAGE:
                if bare is not None and bare[1] == at and at - bare[0] < _STRETCH:
                    bare = (bare[0], end)
                    continue
                if bare is not None:
                    yield self._stretch(data, *bare)
                bare = (at, end)
                continue
            if bare is not None:
                yield self._stretch(data, *bare)
                bare = None
            if opcode == Opcode.CHUNK:
                if isinstance(data.obj, mmap.mmap):
                    release(data.obj, at)
                chunk = (at, end, {})
                index_end = end
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
                self._other(opcode, data[at + 9 : end])
            elif opcode == Opcode.DATA_END:
                ended = True
                break
            elif opcode not in (Opcode.HEADER, Opcode.ATTACHMENT):
                self._problems.count("records of an unknown kind or out of place")
        if chunk is not None:
            yield from self._chunk(data[chunk[0] + 9 : chunk[1]], {})
        if bare is not None:
            yield self._stretch(data, *bare)
        if not ended:
            self._problems.add(
                "not finished: it ends without a summary (the recorder was killed, is still running, or the file is "
                "cut off)"
            )
        elif not self.finished:
            self._problems.add("not finished: its summary is cut off; no message is missing")

    def _other(self, opcode: int, body: memoryview) -> None:
        try:
            if opcode == Opcode.METADATA:
                self._take_metadata(body)
            else:
                self._define(opcode, body)
        except _BROKEN:
            self._problems.count("definitions or metadata that cannot be read")

    def _stretch(self, data: memoryview, start: int, end: int) -> Block:
        """Bare message records; they lie in the mapped file, which closes when reading ends, so copy."""
        copy = bytes(data[start:end])
        if isinstance(data.obj, mmap.mmap):
            release(data.obj, start)
        return Block(copy, lambda: self._messages(copy, "outside chunks"))

    def _messages(self, data: bytes, where: str, *, cut_is_known: bool = False, count: bool = True) -> Iterator[Raw]:
        view = memoryview(data)
        unpack = MESSAGE_HEAD.unpack_from
        size = MESSAGE_HEAD.size
        for opcode, start, end in self._walk(view, 0, where, cut_is_known=cut_is_known):
            if opcode == Opcode.MESSAGE and end - start >= size:
                _, _, channel, _, log_ns, _ = unpack(data, start)
                if channel in self.topics:
                    if count:
                        self._seen[channel] = self._seen.get(channel, 0) + 1
                    yield Raw(channel, log_ns, start + size, end)
                else:
                    self._problems.count(f"messages of a topic that is not declared (number {channel})")
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._other(opcode, view[start + 9 : end])
            else:
                self._problems.count("records of an unknown kind or out of place")

    def _chunk(self, body: memoryview, index: dict[int, bytes]) -> Iterator[Block]:
        number = sum(len(entries) // 16 for entries in index.values())
        try:
            start_ns, end_ns, size, checksum = _CHUNK_HEAD.unpack_from(body)
            at = _CHUNK_HEAD.size
            length = int.from_bytes(body[at : at + 4], "little")
            compression = bytes(body[at + 4 : at + 4 + length]).decode()
            at += 4 + length
            stored = int.from_bytes(body[at : at + 8], "little")
            payload = body[at + 8 : at + 8 + stored]
        except (struct.error, UnicodeDecodeError):
            self._problems.count("chunks with a damaged head")
            return
        cut = len(payload) < stored
        try:
            data = _decompress(payload, compression, size, partial=cut)
        except (ParseError, *_BROKEN) as error:
            self._lost_chunk(start_ns, end_ns, number, str(error))
            return
        if not cut and checksum and zlib.crc32(data) != checksum:
            self._lost_chunk(start_ns, end_ns, number, "its checksum does not fit")
            return
        where = "in a chunk that is cut off" if cut else "in a chunk"
        if any(channel not in self.topics for channel in index):
            self._define_all(data)
        indexed = bool(index) and not cut
        if indexed:
            for channel, entries in index.items():
                self._seen[channel] = self._seen.get(channel, 0) + len(entries) // 16
        yield Block(
            data, lambda: self._messages(data, where, cut_is_known=cut, count=not indexed), index if indexed else None
        )

    def _define_all(self, data: bytes) -> None:
        """The topics a chunk declares, for a reader that takes its messages by the index."""
        view = memoryview(data)
        for opcode, at, end in whole_records(view, 0):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._other(opcode, view[at + 9 : end])

    def _lost_chunk(self, start_ns: int, end_ns: int, number: int, why: str) -> None:
        messages = f"{number} messages" if number else "an unknown number of messages"
        seconds = max(end_ns - start_ns, 0) / 1e9
        self._problems.add(f"a chunk of {messages} over {seconds:.1f} s (from {start_ns} ns) is damaged: {why}")

    def _walk(
        self, data: memoryview, at: int, where: str, *, cut_is_known: bool = False
    ) -> Iterator[tuple[int, int, int]]:
        """(opcode, start, end) of the records that make sense."""
        size = len(data)
        place = f" {where}" if where else ""
        while at < size:
            if not where and at + len(MAGIC) >= size:
                return  # the closing magic
            if self._plausible(data, at):
                opcode, length = RECORD_HEAD.unpack_from(data, at)
                end = at + 9 + length
                if end == size or (end < size and self._plausible(data, end)) or _is_end(data, end):
                    yield opcode, at, end
                    at = end
                    continue
                # either this record's length is damaged or the next one's head
                good = self._resync(data, at + 1)
                if end < size and (good is None or good >= end):
                    yield opcode, at, end
                    at = end
                elif good is None and opcode == Opcode.CHUNK:
                    yield opcode, at, size  # cut off within a chunk: its beginning can still be unpacked
                    return
            else:
                good = self._resync(data, at + 1)
            if good is None:
                if not cut_is_known:
                    self._problems.add(f"cut off{place}: the last {size - at} bytes are no whole record")
                return
            self._problems.add(f"{good - at} bytes{place} at {at} are damaged and were left out")
            at = good

    def _plausible(self, data: memoryview, at: int) -> bool:
        """A record may begin here."""
        if at + 9 > len(data):
            return False
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        if opcode == Opcode.MESSAGE:
            return 22 <= int(length) < _MAX_CHUNK and at + 31 <= len(data)
        if opcode >= _PRIVATE:
            return int(length) < _MAX_CHUNK
        return 1 <= int(opcode) <= Opcode.DATA_END and int(length) < (_MAX_CHUNK << 3)

    def _resync(self, data: memoryview, at: int) -> int | None:
        """The next record that makes sense and is followed by one that does, or ends the file."""
        size = len(data)
        while True:
            match = _CANDIDATE.search(data, at)
            if match is None:
                return None
            at = match.start()
            _, length = RECORD_HEAD.unpack_from(data, at)
            end = at + 9 + length
            if self._trusted(data, at) and (
                end == size or (end < size and self._trusted(data, end)) or _is_end(data, end)
            ):
                return at
            at += 1

    def _trusted(self, data: memoryview, at: int) -> bool:
        """As plausible, for bytes of which nothing is known: a message must belong to a topic and a time."""
        if not self._plausible(data, at):
            return False
        if data[at] == Opcode.MESSAGE:
            _, _, channel, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(data, at)
            return channel in self.topics and abs(log_ns - publish_ns) < _DAY_NS
        if data[at] == Opcode.CHUNK:
            body = data[at + 9 : at + 9 + 64]
            length = int.from_bytes(body[28:32], "little")
            return bytes(body[32 : 32 + length]) in (b"", b"zstd", b"lz4")
        if data[at] in (Opcode.SCHEMA, Opcode.CHANNEL):
            _, length = RECORD_HEAD.unpack_from(data, at)
            return 8 <= int(length) < (1 << 24)
        if data[at] >= _PRIVATE:
            return False
        return data[at] in (Opcode.MESSAGE_INDEX, Opcode.METADATA, Opcode.DATA_END) and bool(
            RECORD_HEAD.unpack_from(data, at)[1] < (1 << 26)
        )

    def _compare(self) -> None:
        """What the summary promised and the file did not hold."""
        if self.statistics is None:
            return
        for channel, promised in self.statistics.channel_message_counts.items():
            missing = promised - self._seen.get(channel, 0)
            if missing > 0 and self._seen:
                name = self.topics[channel].name if channel in self.topics else f"topic {channel}"
                self._problems.add(f"{name}: {missing} of {promised} messages are missing")


def _take_index(body: memoryview, index: dict[int, bytes]) -> bool:
    """Note a chunk's index of one topic; False if it is damaged."""
    if len(body) < 6 or len(body) % 16 != 6 or int.from_bytes(body[2:6], "little") != len(body) - 6:
        return False
    channel = int.from_bytes(body[:2], "little")
    if channel in index:
        return False
    index[channel] = bytes(body[6:])
    return True


def _is_end(data: memoryview, at: int) -> bool:
    return len(data) - at == len(MAGIC) and data[at:] == MAGIC


def _decompress(payload: memoryview, compression: str, size: int, *, partial: bool) -> bytes:
    """A chunk's content; partial: as much as a cut-off one still gives. Never more than `size` bytes."""
    if size > _MAX_CHUNK:
        raise ParseError("chunk", "size", f"at most {_MAX_CHUNK} bytes", str(size))
    if compression == "":
        return bytes(payload)
    if compression == "zstd":
        import zstandard

        try:
            if not partial:
                return zstandard.ZstdDecompressor().decompress(payload, max_output_size=size)
            reader = zstandard.ZstdDecompressor().stream_reader(payload)
            return _as_much_as_comes(reader.read1, size)
        except zstandard.ZstdError as error:
            raise ParseError("chunk", "content", "zstd", str(error)) from None
    if compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        try:
            context = lz4.frame.LZ4FrameDecompressor()
            return bytes(context.decompress(bytes(payload), max_length=size))
        except RuntimeError as error:
            raise ParseError("chunk", "content", "lz4", str(error)) from None
    raise ParseError("chunk", "compression", "zstd, lz4 or none", compression)


def _as_much_as_comes(read: object, size: int) -> bytes:
    import zstandard

    out = bytearray()
    assert callable(read)
    while len(out) < size:
        try:
            part = read(min(1 << 17, size - len(out)))
        except zstandard.ZstdError:
            break
        if not part:
            break
        out += part
    return bytes(out)


class _Mapped:
    """A file mapped for reading; None where it is empty."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._map: mmap.mmap | None = None
        self._view: memoryview | None = None

    def __enter__(self) -> memoryview | None:
        with self._path.open("rb") as file:
            file.seek(0, 2)
            if file.tell() == 0:
                return None
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._view = memoryview(self._map)
        return self._view

    def __exit__(self, *_: object) -> None:
        if self._view is not None and self._map is not None:
            self._view.release()
            try:
                self._map.close()
            except BufferError:
                return  # a slice is still referenced by a traceback; the map goes with it
