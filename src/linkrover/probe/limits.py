"""Bounds on what strangers may make a reflector do: a token bucket per source, sessions in tables of fixed size."""

from __future__ import annotations

import ipaddress
from collections import OrderedDict

SOURCE_RATE_PER_S = 4_000.0
SOURCE_BURST = 2_000.0
TOTAL_RATE_PER_S = 50_000.0
SOURCES_MOST = 4_096
SESSIONS_MOST = 1_024
ESTABLISHED_PACKETS = 8
SESSION_IDLE_NS = 300_000_000_000


class Bucket:
    """A token bucket on CLOCK_MONOTONIC: `rate` tokens a second, at most `burst` saved up."""

    __slots__ = ("_burst", "_rate", "_tokens", "_updated_ns")

    def __init__(self, rate_per_s: float, burst: float, now_ns: int) -> None:
        self._rate = rate_per_s / 1e9
        self._burst = burst
        self._tokens = burst
        self._updated_ns = now_ns

    def take(self, now_ns: int) -> bool:
        """Take one token, if there is one."""
        self._tokens = min(self._burst, self._tokens + (now_ns - self._updated_ns) * self._rate)
        self._updated_ns = now_ns
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True


class SourceLimiter:
    """A bucket per source address (per /64 for IPv6, which one host may fill with addresses), and one for all."""

    def __init__(self, rate_per_s: float, burst: float, total_per_s: float, now_ns: int) -> None:
        self._rate_per_s = rate_per_s
        self._burst = burst
        self._total = Bucket(total_per_s, total_per_s / 2, now_ns)
        self._buckets: OrderedDict[str, Bucket] = OrderedDict()

    def __len__(self) -> int:
        return len(self._buckets)

    def allows(self, host: str, now_ns: int) -> bool:
        """Whether one more packet from this source may be answered now."""
        bucket = self._buckets.get(host)
        if bucket is None:
            source = _prefix(host)
            bucket = self._buckets.get(source) or Bucket(self._rate_per_s, self._burst, now_ns)
            self._buckets[source] = bucket
            if source != host:
                self._buckets[host] = bucket  # the same bucket, so that the prefix is worked out once a host
            while len(self._buckets) > SOURCES_MOST:
                self._buckets.popitem(last=False)
        else:
            self._buckets.move_to_end(host)
        return bucket.take(now_ns) and self._total.take(now_ns)


class Session:
    """What a stateful reflector keeps of one Session-Sender (RFC 8762, 4: its own sequence per session)."""

    __slots__ = ("_window", "duplicates", "first_ns", "highest", "last_ns", "received", "reordered", "sequence")

    def __init__(self, now_ns: int) -> None:
        self.sequence = 0  # of the next answer
        self.first_ns = now_ns
        self.last_ns = now_ns
        self.received = 0
        self.duplicates = 0
        self.reordered = 0
        self.highest = -1
        self._window = 0  # bit k: sequence highest - k was seen

    def note(self, sequence: int, now_ns: int) -> bool:
        """Count a packet that came; True if its sequence number was seen before (among the last 1024)."""
        self.received += 1
        self.last_ns = now_ns
        if self.highest < 0:
            self.highest, self._window = sequence, 1
            return False
        ahead = (sequence - self.highest + 0x8000_0000) % 0x1_0000_0000 - 0x8000_0000
        if ahead > 0:
            self._window = (self._window << ahead | 1) & ((1 << 1024) - 1) if ahead < 1024 else 1
            self.highest = sequence
            return False
        self.reordered += ahead < 0
        if ahead <= -1024:
            return False
        bit = 1 << -ahead
        if self._window & bit:
            self.duplicates += 1
            self.reordered -= ahead < 0
            return True
        self._window |= bit
        return False


SessionKey = tuple[str, int, int]


class SessionTable:
    """Sessions by (address, port, SSID), bounded.

    New ones fill a table of their own until they have sent 8 packets over a second, so that a flood of invented
    senders pushes out other invented ones, not those being measured.
    """

    def __init__(self, most: int = SESSIONS_MOST) -> None:
        self._most = max(2, most) // 2
        self._new: OrderedDict[SessionKey, Session] = OrderedDict()
        self._established: OrderedDict[SessionKey, Session] = OrderedDict()
        self.evicted = 0

    def __len__(self) -> int:
        return len(self._new) + len(self._established)

    def established(self) -> dict[SessionKey, Session]:
        """The sessions that have lasted."""
        return dict(self._established)

    def get(self, key: SessionKey, now_ns: int) -> Session:
        """The session of this sender, made where there is none."""
        session = self._established.get(key)
        if session is not None:
            self._established.move_to_end(key)
            return session
        session = self._new.get(key)
        if session is None:
            session = self._new[key] = Session(now_ns)
            if len(self._new) > self._most:
                self._new.popitem(last=False)
                self.evicted += 1
            return session
        self._new.move_to_end(key)
        if session.received >= ESTABLISHED_PACKETS and now_ns - session.first_ns >= 1_000_000_000:
            self._promote(key, now_ns)
        return session

    def expire(self, now_ns: int) -> list[tuple[SessionKey, Session]]:
        """Drop what has been silent for five minutes; the established ones among it are returned."""
        for table in (self._new, self._established):
            idle = [key for key, session in table.items() if now_ns - session.last_ns > SESSION_IDLE_NS]
            if table is self._new:
                for key in idle:
                    del table[key]
        return [(key, self._established.pop(key)) for key in idle]

    def _promote(self, key: SessionKey, now_ns: int) -> None:
        if len(self._established) >= self._most:
            oldest, idle = next(iter(self._established.items()))
            if now_ns - idle.last_ns < 10_000_000_000:
                return  # all are alive: the newcomer stays where it is
            del self._established[oldest]
            self.evicted += 1
        self._established[key] = self._new.pop(key)


def _prefix(host: str) -> str:
    if ":" not in host:
        return host
    try:
        address = ipaddress.IPv6Address(host.split("%", maxsplit=1)[0])
    except ValueError:
        return host
    return str(ipaddress.IPv6Address(int(address) >> 64 << 64)) + "/64"
