"""MCAP (mcap.dev/spec): the record framing, and a journal made into an indexed, compressed file.

The record types and their layouts are the `mcap` package's; only what is done per message is here, because a journal
already holds its messages as a chunk wants them: whole runs of it are compressed as they stand.
"""

from __future__ import annotations

import errno
import io
import mmap
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import msgspec
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from linkrover import __version__

from .metadata import BagInfo, TopicInfo, metadata_yaml

MAGIC = b"\x89MCAP0\r\n"
MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
RECORD_HEAD = struct.Struct("<BQ")
CHUNK_BYTES = 64 * 1024
"""What a flipped bit in a finished recording costs; at 64 KiB files are 2 % larger than at 512 KiB."""
MANIFEST_NAME = "linkrover"
_ZSTD_LEVEL = 3


def packed(*records: McapRecord) -> bytes:
    """The bytes of these records."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def file_head() -> bytes:
    """Magic and header of a recording."""
    return MAGIC + packed(Header(profile="ros2", library=f"linkrover {__version__}"))


def stream(data: bytes | memoryview) -> ReadDataStream:
    """A record's content, to be read by the `mcap` package's record classes."""
    return ReadDataStream(io.BytesIO(data))


class Finished(msgspec.Struct, frozen=True):
    """A journal that was made into a recording. torn_bytes: what lay behind its last whole record."""

    path: Path
    messages: int
    torn_bytes: int


Walk = Callable[[memoryview, int], Iterator[tuple[int, int, int]]]


def finalise(
    journal: Path,
    *,
    walk: Walk | None = None,
    note: Callable[[], str] = str,
    progress: Callable[[float], None] | None = None,
) -> Finished:
    """Make `x.mcap.journal` into `x.mcap` (chunked, indexed, zstd) and `metadata.yaml`; remove the journal.

    walk: how the journal's records are found, by default `whole_records`; note: what to say of it, asked at the end.
    The journal stays as it is until the new file is complete and on disk. Raises OSError (no space, ...).
    """
    target = journal.with_suffix("")
    temporary = target.with_suffix(".mcap.part")
    temporary.unlink(missing_ok=True)  # of an attempt that was killed
    try:
        with journal.open("rb") as source, temporary.open("xb") as out:
            writer = _Writer(out)
            used, size = _copy(source, writer, walk or whole_records, progress)
            writer.finish(note())
            out.flush()
            os.fsync(out.fileno())
        yaml = journal.parent / "metadata.yaml.part"
        yaml.write_text(metadata_yaml(writer.info(target.name)), encoding="utf-8")
        if target.exists():
            raise FileExistsError(errno.EEXIST, f"{target} is there already")
        temporary.rename(target)
        yaml.replace(journal.parent / "metadata.yaml")
    except OSError:
        temporary.unlink(missing_ok=True)
        (journal.parent / "metadata.yaml.part").unlink(missing_ok=True)
        raise
    _sync_directory(journal.parent)
    journal.unlink()
    return Finished(target, writer.messages, size - used)


def _sync_directory(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _copy(source: BinaryIO, writer: _Writer, walk: Walk, progress: Callable[[float], None] | None) -> tuple[int, int]:
    size = os.fstat(source.fileno()).st_size
    if size == 0:
        return 0, 0
    with mmap.mmap(source.fileno(), 0, access=mmap.ACCESS_READ) as whole, memoryview(whole) as data:
        end = len(MAGIC)
        for opcode, at, end in walk(data, len(MAGIC)):
            if opcode == Opcode.MESSAGE:
                writer.message(data, at, end)
            elif opcode == Opcode.SCHEMA:
                writer.schema(Schema.read(stream(data[at + 9 : end])), data[at:end])
            elif opcode == Opcode.CHANNEL:
                writer.channel(Channel.read(stream(data[at + 9 : end])), data[at:end])
            elif opcode == Opcode.METADATA:
                writer.metadata.append(Metadata.read(stream(data[at + 9 : end])))
            elif opcode == Opcode.DATA_END:
                break
            if writer.chunk_just_closed:
                release(whole, end)
                if progress is not None:
                    progress(end / size)
                writer.chunk_just_closed = False
        return min(end, size), size


def release(mapped: mmap.mmap, end: int) -> None:
    """Give back the memory of what has been read of a mapped file, so that a long one does not fill it."""
    whole_pages = end - end % mmap.PAGESIZE
    if whole_pages:
        mapped.madvise(mmap.MADV_DONTNEED, 0, whole_pages)


def whole_records(data: memoryview, at: int) -> Iterator[tuple[int, int, int]]:
    """(opcode, start, end) of every whole record from `at` on; stops before a torn one or at an impossible opcode."""
    size = len(data)
    unpack = RECORD_HEAD.unpack_from
    while at + 9 <= size:
        opcode, length = unpack(data, at)
        end = at + 9 + length
        if end > size or opcode == 0:
            return
        yield opcode, at, end
        at = end


class _Writer:
    """Writes the chunks and then the summary of one file."""

    def __init__(self, out: BinaryIO) -> None:
        import zstandard

        self._out = out
        self._compress = zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress
        self._position = 0
        self._body = bytearray()
        self._index: dict[int, list[tuple[int, int]]] = {}
        self._chunks: list[ChunkIndex] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: dict[int, int] = {}
        self.metadata: list[Metadata] = []
        self.messages = 0
        self.start_ns = 2**63 - 1
        self.end_ns = 0
        self.chunk_just_closed = False
        self._write(file_head())

    def _write(self, data: bytes) -> None:
        self._out.write(data)
        self._position += len(data)

    def schema(self, schema: Schema, raw: memoryview) -> None:
        """Take over a schema."""
        self._schemas[schema.id] = schema
        self._body += raw

    def channel(self, channel: Channel, raw: memoryview) -> None:
        """Take over a channel."""
        self._channels[channel.id] = channel
        self._body += raw

    def message(self, data: memoryview, at: int, end: int) -> None:
        """Take over the message record data[at:end]."""
        if end - at < MESSAGE_HEAD.size:
            return
        _, _, channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(data, at)
        if channel not in self._channels:
            return
        entries = self._index.get(channel)
        if entries is None:
            entries = self._index[channel] = []
        entries.append((log_time, len(self._body)))
        self._body += data[at:end]
        if len(self._body) >= CHUNK_BYTES:
            self._close_chunk()

    def _close_chunk(self) -> None:
        self.chunk_just_closed = True
        if not self._body:
            return
        times = [time for entries in self._index.values() for time, _ in entries]
        start, end = (min(times), max(times)) if times else (0, 0)
        body = bytes(self._body)
        compressed = self._compress(body)
        at = self._position
        chunk = Chunk("zstd", compressed, end, start, zlib.crc32(body), len(body))
        self._write(packed(chunk))
        chunk_length = self._position - at
        offsets = {}
        for channel, entries in self._index.items():
            offsets[channel] = self._position
            self._write(packed(MessageIndex(channel, entries)))
            self._counts[channel] = self._counts.get(channel, 0) + len(entries)
        self._chunks.append(
            ChunkIndex(
                chunk_length=chunk_length,
                chunk_start_offset=at,
                compression="zstd",
                compressed_size=len(compressed),
                message_end_time=end,
                message_index_length=self._position - at - chunk_length,
                message_index_offsets=offsets,
                message_start_time=start,
                uncompressed_size=len(body),
            )
        )
        if times:
            self.messages += len(times)
            self.start_ns, self.end_ns = min(self.start_ns, start), max(self.end_ns, end)
        self._body.clear()
        self._index.clear()

    def finish(self, note: str) -> None:
        """The last chunk, the metadata and the summary."""
        self._close_chunk()
        if self.messages == 0:
            self.start_ns = 0
        if note:
            self.metadata.append(Metadata("linkrover.recovery", {"note": note}))
        indexes = []
        for metadata in self.metadata:
            at = self._position
            self._write(packed(metadata))
            indexes.append(MetadataIndex(offset=at, length=self._position - at, name=metadata.name))
        # 0 = not calculated, which the format allows: every chunk has its own
        self._write(packed(DataEnd(0)))
        self._summary(indexes)

    def _summary(self, metadata: list[MetadataIndex]) -> None:
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=self.messages,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=len(metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, list(self._chunks)),
            (Opcode.METADATA_INDEX, list(metadata)),
        ]
        start = self._position
        body = bytearray()
        offsets: list[McapRecord] = []
        for opcode, group in groups:
            if not group:
                continue
            at = start + len(body)
            body += packed(*group)
            offsets.append(SummaryOffset(group_opcode=opcode, group_start=at, group_length=start + len(body) - at))
        offset_start = start + len(body)
        body += packed(*offsets)
        # the checksum covers the summary and the footer up to the checksum itself
        footer = packed(Footer(start, offset_start, 0))
        checksum = zlib.crc32(footer[:-4], zlib.crc32(body))
        self._write(bytes(body) + packed(Footer(start, offset_start, checksum)) + MAGIC)

    def info(self, file: str) -> BagInfo:
        """What `metadata.yaml` says."""
        topics = [
            TopicInfo(
                channel.topic,
                self._schemas[channel.schema_id].name if channel.schema_id in self._schemas else "",
                channel.metadata.get("offered_qos_profiles", ""),
                self._counts.get(channel.id, 0),
            )
            for channel in self._channels.values()
        ]
        custom = next((m.metadata for m in self.metadata if m.name == MANIFEST_NAME), {})
        return BagInfo(file, self.start_ns, self.end_ns, topics, dict(custom))
