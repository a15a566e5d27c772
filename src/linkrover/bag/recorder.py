"""The recorder: records into a crash-safe MCAP journal while measuring, and a finished recording at the end."""

from __future__ import annotations

import bisect
import contextlib
import errno
import fcntl
import os
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from linkrover.errors import LinkRoverError
from linkrover.messages import Codec, messages_of, texts
from linkrover.records import EventKind, LinkEvent, Manifest, Record

from .container import MANIFEST_NAME, MESSAGE_HEAD, Finished, file_head, finalise, packed
from .metadata import qos

JOURNAL_SUFFIX = ".mcap.journal"
FLUSH_S = 0.5
SYNC_S = 5.0
MAX_PENDING_BYTES = 64 * 1024 * 1024  # what may wait for a disk that hangs; beyond it records are lost and counted


class _Channel:
    """A topic of the recording."""

    def __init__(self, number: int, codec: Codec) -> None:
        self.id = number
        self.codec = codec
        self.sequence = 0


class Recorder:
    """A sink that writes `directory/<directory's name>.mcap` and `metadata.yaml` (rosbag2).

    take() only encodes and appends to memory; a thread writes every half second, so that a slow disk does not delay
    measuring and a killed process loses at most that. Until close() the file is `*.mcap.journal`: unchunked MCAP
    whose every whole record can be read. Where the disk is full, measuring goes on, `problem` says so, records that
    could not be written are counted in `records_lost`, and writing resumes when there is space again.
    """

    def __init__(
        self,
        directory: Path,
        manifest: Manifest,
        *,
        end: str | None = None,
        compatible: bool = True,
        flush_s: float = FLUSH_S,
        on_event: Callable[[LinkEvent], None] | None = None,
    ) -> None:
        """Open the recording and write the manifest, at once and to the disk.

        end: first part of the topics, by default the manifest's role ("truth" for the emulator's). compatible: write
        the 2021 and standard types too. on_event is called from within take(), in its thread, with an event of kind
        RECORDING when writing fails or resumes. Raises LinkRoverError if `directory` holds a recording already (a
        torn journal in it is recovered first) or if it cannot be written.
        """
        self.end = end or manifest.role.value
        self.records_written = 0
        self.records_lost = 0
        self.bytes_written = 0
        self.problem: str | None = None
        self.directory = directory
        self._compatible = compatible
        self._flush_s = flush_s
        self._on_event = on_event
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, int] = {}
        self._pending = bytearray()
        self._marks: list[int] = []  # where each pending record ends
        self._events: list[LinkEvent] = []
        self._lock = threading.Lock()  # what is pending; never held while writing
        self._taking = threading.RLock()  # channels and their sequence; again by an event that is itself recorded
        self._wake = threading.Event()
        self._closing = False
        self.path, self._fd = _create(directory)
        try:
            self._append(file_head())
            manifest_json = msgspec.json.encode(manifest).decode()
            self._append(packed(Metadata(MANIFEST_NAME, {"end": self.end, "manifest": manifest_json})))
            self.take(manifest)
            self._flush()
            os.fsync(self._fd)
        except OSError as error:
            os.close(self._fd)
            raise LinkRoverError(f"cannot record into {directory}: {error.strerror or error}") from error
        self._thread = threading.Thread(target=self._write_loop, name="recorder", daemon=True)
        self._thread.start()

    def take(self, record: Record) -> None:
        """Record it, from any thread. Never waits for the disk."""
        with self._taking:
            self._take(record)

    def _take(self, record: Record) -> None:
        if self._events:
            self._tell()
        data = bytearray()
        try:
            for topic, message_type, message in messages_of(record, self.end, compatible=self._compatible):
                channel = self._channels.get(topic)
                if channel is None:
                    channel = self._channels[topic] = self._open_channel(topic, message_type, data)
                body = channel.codec.encode(message)
                log_ns = record.wall_ns
                data += MESSAGE_HEAD.pack(Opcode.MESSAGE, len(body) + 22, channel.id, channel.sequence, log_ns, log_ns)
                data += body
                channel.sequence += 1
        except struct.error as error:
            # what is in `data` so far is whole, and may hold the channel's definition
            self.records_lost += 1
            self.problem = f"a {type(record).__name__} does not fit its message: {error}"
            self._append(data)
            return
        with self._lock:
            if self._closing or len(self._pending) > MAX_PENDING_BYTES:
                self.records_lost += 1
                return
            self._pending += data
            self._marks.append(len(self._pending))

    def close(self) -> Finished | None:
        """Write what is left and make the finished recording of it.

        None: that could not be done (no space); the journal stays, is readable, and `problem` says why.
        """
        with self._lock:
            if self._closing:
                return None
            self._closing = True
        self._wake.set()
        self._thread.join()
        self._flush()
        try:
            os.fsync(self._fd)
            finished = finalise(self.path)
        except OSError as error:
            self.problem = f"the recording stays a journal ({self.path}): {error.strerror or error}"
            return None
        finally:
            os.close(self._fd)
        return finished

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _append(self, data: bytes | bytearray) -> None:
        with self._lock:
            self._pending += data

    def _open_channel(self, topic: str, message_type: str, out: bytearray) -> _Channel:
        package, _, short = message_type.partition("/")
        schema_id = self._schemas.get(message_type)
        if schema_id is None:
            schema_id = self._schemas[message_type] = len(self._schemas) + 1
            text = texts.ros2_definition(message_type).encode()
            out += packed(Schema(id=schema_id, data=text, encoding="ros2msg", name=f"{package}/msg/{short}"))
        number = len(self._channels) + 1
        latched = topic.endswith("/linkrover/manifest")
        metadata = {"offered_qos_profiles": qos(latched=latched), "topic_type_hash": ""}
        out += packed(Channel(id=number, topic=topic, message_encoding="cdr", metadata=metadata, schema_id=schema_id))
        return _Channel(number, Codec(message_type, texts.definitions(message_type)))

    def _tell(self) -> None:
        with self._lock:
            events, self._events = self._events, []
        for event in events:
            self.take(event)
            if self._on_event is not None:
                self._on_event(event)

    def _write_loop(self) -> None:
        synced = time.monotonic()
        while not self._closing:
            self._wake.wait(self._flush_s)
            self._flush()
            if time.monotonic() - synced >= SYNC_S:
                synced = time.monotonic()
                with contextlib.suppress(OSError):  # the next write reports what is wrong with the disk
                    os.fdatasync(self._fd)

    def _flush(self) -> None:
        """Write what is pending. Only ever called by one thread at a time."""
        with self._lock:
            data, self._pending = self._pending, bytearray()
            marks, self._marks = self._marks, []
        if not data:
            return
        written = 0
        view = memoryview(data)
        try:
            while written < len(data):
                written += os.write(self._fd, view[written:])
        except OSError as error:
            self._failed(view, written, marks, error)
            return
        self.bytes_written += written
        self.records_written += len(marks)
        if self.problem is not None and self.problem.startswith(_FULL):
            self._report(None, f"writing again; {self.records_lost} records were lost meanwhile")

    def _failed(self, data: memoryview, written: int, marks: list[int], error: OSError) -> None:
        """Keep the records that were written whole, and the definitions for a later try; count the rest as lost."""
        kept = bisect.bisect_right(marks, written)
        end = marks[kept - 1] if kept else 0
        if end == 0 and self.bytes_written == 0:
            raise error  # not even the manifest: there is no recording
        definitions = bytearray()
        at = end
        while at < len(data):
            (length,) = struct.unpack_from("<Q", data, at + 1)
            if data[at] != Opcode.MESSAGE:
                definitions += data[at : at + 9 + length]
            at += 9 + length
        os.ftruncate(self._fd, self.bytes_written + end)
        os.lseek(self._fd, 0, os.SEEK_END)
        self.bytes_written += end
        self.records_written += kept
        self.records_lost += len(marks) - kept
        with self._lock:
            self._pending[:0] = definitions
            self._marks = [mark + len(definitions) for mark in self._marks]
        if self.problem is None or not self.problem.startswith(_FULL):
            what = "the disk is full" if error.errno in (errno.ENOSPC, errno.EDQUOT) else str(error.strerror)
            self._report(f"{_FULL}: {what}; measuring goes on, {self.path} is readable as far as it goes", "")

    def _report(self, problem: str | None, detail: str) -> None:
        self.problem = problem
        event = LinkEvent(
            wall_ns=time.time_ns(),
            mono_ns=time.monotonic_ns(),
            iface="",
            kind=EventKind.RECORDING,
            detail=problem or detail,
        )
        with self._lock:
            self._events.append(event)


_FULL = "recording stopped"


def _create(directory: Path) -> tuple[Path, int]:
    """A new journal, locked as long as this process lives."""
    try:
        return _create_journal(directory)
    except OSError as error:
        raise LinkRoverError(f"cannot record into {directory}: {error.strerror or error}") from error


def _create_journal(directory: Path) -> tuple[Path, int]:
    directory.mkdir(parents=True, exist_ok=True)
    stem = directory.resolve().name or "recording"
    for journal in sorted(directory.glob(f"*{JOURNAL_SUFFIX}")):
        if is_live(journal):
            raise LinkRoverError(f"{journal} is being written by another process: record into another directory")
        recover(journal)
    present = sorted(path.name for path in directory.iterdir() if path.suffix in (".mcap", ".yaml", ".bag"))
    if present:
        raise LinkRoverError(f"{directory} holds a recording already ({', '.join(present)}): record into another one")
    path = directory / f"{stem}{JOURNAL_SUFFIX}"
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    with contextlib.suppress(OSError):  # a file system without locks records all the same
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return path, fd


def is_live(journal: Path) -> bool:
    """A process is writing this journal now."""
    with journal.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False


def recover(path: Path, *, progress: Callable[[float], None] | None = None) -> Finished:
    """Make a finished recording of a journal whose process was killed. `path`: the journal or its directory.

    Raises LinkRoverError if there is no journal or it is still being written, OSError if there is no space.
    """
    journals = sorted(path.glob(f"*{JOURNAL_SUFFIX}")) if path.is_dir() else [path]
    if not journals or not journals[0].name.endswith(JOURNAL_SUFFIX):
        raise LinkRoverError(f"{path}: no journal (*{JOURNAL_SUFFIX}) to recover")
    journal = journals[0]
    target = journal.with_suffix("")
    if target.exists():
        raise LinkRoverError(f"{target} is there already: move it away to recover {journal}")
    with journal.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise LinkRoverError(f"{journal} is being written by another process: end that first") from None
        return _finalise_torn(journal, progress)


def _finalise_torn(journal: Path, progress: Callable[[float], None] | None) -> Finished:
    from .mcap_read import McapFile

    reader = McapFile(journal)

    def note() -> str:
        return "; ".join(["recovered from a journal that was not closed", *reader.problems])

    return finalise(journal, walk=reader.salvage, note=note, progress=progress)
