"""A Unix datagram socket on which a robot's own software hands records to the agent, without ROS."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import socket
import stat
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec

from linkrover.errors import ConfigError, ParseError
from linkrover.loop import Loop
from linkrover.records import LinkEvent, NetworkDelay, Pose, Record, TopicTraffic, VelocityCommand, now

FedRecord = Pose | VelocityCommand | LinkEvent | NetworkDelay | TopicTraffic

_DATAGRAM_MOST = 65536
_AT_ONCE = 256
_WAITING_MOST = 1000
_FIELDS = {
    kind.__name__: {"type"} | {field.name for field in msgspec.structs.fields(kind)}
    for kind in (Pose, VelocityCommand, LinkEvent, NetworkDelay, TopicTraffic)
}
_TIME_LIMIT = 1 << 63
_COMPLAINT_PERIOD_NS = 5_000_000_000

log = logging.getLogger("linkrover.agent")


def parse_fed(data: bytes, file: str = "feed") -> Record:
    """One datagram: a JSON object with "type" (the record's name) and the record's fields.

    wall_ns and mono_ns may both be left out: then it is the time of arrival.

    Raises:
        ParseError: no such object; says what was expected.
    """
    try:
        tree: Any = msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ParseError(file, "datagram", "one JSON object", str(error)) from error
    if not isinstance(tree, dict):
        raise ParseError(file, "datagram", "one JSON object", type(tree).__name__)
    name = tree.get("type")
    fields = _FIELDS.get(name) if isinstance(name, str) else None
    if fields is None:
        raise ParseError(file, '"type"', f"one of {', '.join(_FIELDS)}", repr(name)[:80])
    foreign = tree.keys() - fields
    if foreign:
        raise ParseError(file, str(name), f"only {', '.join(sorted(fields))}", ", ".join(sorted(foreign))[:80])
    if "wall_ns" not in tree and "mono_ns" not in tree:
        stamp = now()
        tree["wall_ns"], tree["mono_ns"] = stamp.wall_ns, stamp.mono_ns
    try:
        record: Record = msgspec.convert(tree, FedRecord)
    except (msgspec.ValidationError, RecursionError) as error:
        raise ParseError(file, str(name), "fields of the right kind", str(error)) from error
    for field in msgspec.structs.fields(record):
        value = getattr(record, field.name)
        if isinstance(value, int) and not -_TIME_LIMIT <= value < _TIME_LIMIT:
            raise ParseError(file, field.name, "an integer of 64 bit", str(value)[:40])
    return record


class FeedReceiver:
    """Listens on a path; bad datagrams are counted and named in the log at most every 5 s.

    Raises:
        ConfigError: from the constructor: the path cannot be used.
    """

    def __init__(self, loop: Loop, path: str, publish: Callable[[Record], None]) -> None:
        self.path = path
        self.received = 0
        self.refused = 0
        self._publish = publish
        self._complain_ns = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        try:
            _clear_stale(path)
            self._socket.bind(path)
        except OSError as error:
            self._socket.close()
            raise ConfigError(f"cannot listen for records on {path}: {error.strerror or error}") from error
        self._inode = os.stat(path).st_ino  # noqa: PTH116
        self._remove = loop.reader(self._socket, self._read)

    def close(self) -> None:
        """Stop listening and remove the path."""
        self._remove()
        self._socket.close()
        with contextlib.suppress(FileNotFoundError):
            if os.stat(self.path).st_ino == self._inode:  # noqa: PTH116
                os.unlink(self.path)  # noqa: PTH108

    def _read(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                data = self._socket.recv(_DATAGRAM_MOST)
            except BlockingIOError:
                return
            try:
                record = parse_fed(data, self.path)
            except ParseError as error:
                self.refused += 1
                now_ns = time.monotonic_ns()
                if now_ns >= self._complain_ns:
                    self._complain_ns = now_ns + _COMPLAINT_PERIOD_NS
                    log.warning("feed: %s (%d refused so far)", error, self.refused)
                continue
            self.received += 1
            self._publish(record)


class FeedSender:
    """Hands records to an agent's feed; never blocks. Usable before the agent is there and after it has gone.

    The kernel queues about ten datagrams (net.unix.max_dgram_qlen): what an agent that is busy for a moment cannot
    take is kept here, up to 1000 records, and goes with the next one. Without an agent records are dropped.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.sent = 0
        self.dropped = 0
        self._waiting: deque[bytes] = deque()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)

    def send(self, record: Record) -> bool:
        """True when the agent's socket has taken this record and all before it."""
        self._waiting.append(msgspec.json.encode(record))
        if len(self._waiting) > _WAITING_MOST:
            self._waiting.popleft()
            self.dropped += 1
        return self.flush()

    def flush(self) -> bool:
        """Try to hand over what waits; True when nothing does any more."""
        try:
            while self._waiting:
                self._socket.sendto(self._waiting[0], self.path)
                self._waiting.popleft()
                self.sent += 1
        except BlockingIOError:
            return False
        except OSError:
            # no agent there: a robot's control loop must neither wait for its meter nor fail without it
            self.dropped += len(self._waiting)
            self._waiting.clear()
            return False
        return True

    def close(self) -> None:
        """Give back the socket."""
        self._socket.close()


def _clear_stale(path: str) -> None:
    """Remove a socket nobody listens on; anything else at that path is left alone."""
    try:
        if not stat.S_ISSOCK(os.lstat(path).st_mode):
            raise FileExistsError(errno.EEXIST, "something else is there")
    except FileNotFoundError:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as trial:
        try:
            trial.connect(path)
        except ConnectionRefusedError:
            os.unlink(path)  # noqa: PTH108
            return
    raise OSError(errno.EADDRINUSE, "another agent listens there")
