"""The latest of everything, with a short history: what a live view shows."""

from __future__ import annotations

import time
from collections import deque

from linkrover.records import (
    Continuity,
    EventKind,
    LinkEvent,
    LinkUtilization,
    NetworkErrors,
    ProbeResult,
    ProbeState,
    Record,
    SelfAccount,
    WirelessLink,
)

HISTORY = 60
_PEER_KEPT_NS = 3_000_000_000
_PROBE_WINDOW_NS = 60_000_000_000
_ERROR_FIELDS = (
    "tcp_retransmits",
    "tcp_bad_segments",
    "udp_errors",
    "udp_buffer_errors",
    "mac_tx_retries",
    "mac_rx_dropped",
    "nic_tx_errors",
    "nic_rx_errors",
    "nic_tx_dropped",
    "nic_rx_dropped",
)


class InterfaceState:
    """One interface."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.utilization: LinkUtilization | None = None
        self.wireless: WirelessLink | None = None
        self.errors: NetworkErrors | None = None
        self.rx_history: deque[float | None] = deque(maxlen=HISTORY)
        self.tx_history: deque[float | None] = deque(maxlen=HISTORY)
        self.rssi_history: deque[float | None] = deque(maxlen=HISTORY)
        self.error_totals: dict[str, int] = {}  # increments since the start, resets left out
        self.peers: dict[str, WirelessLink] = {}  # of an access point, by address
        self._rssi_due_ns = 0

    def take_utilization(self, record: LinkUtilization) -> None:
        """A new sample of traffic."""
        self.utilization = record
        self.rx_history.append(record.rx_rate_bps)
        self.tx_history.append(record.tx_rate_bps)

    def take_wireless(self, record: WirelessLink) -> None:
        """A new sample of the link; the history takes one a second.

        Of an access point's peers the weakest is shown.
        """
        if record.peer is None:
            self.peers.clear()
            self.wireless = record
        else:
            self.peers[record.peer] = record
            for peer in [p for p, link in self.peers.items() if record.mono_ns - link.mono_ns > _PEER_KEPT_NS]:
                del self.peers[peer]
            heard = [link for link in self.peers.values() if link.rssi_dbm is not None]
            self.wireless = min(heard, key=lambda link: link.rssi_dbm or 0.0) if heard else record
        if record.mono_ns >= self._rssi_due_ns:
            self._rssi_due_ns = record.mono_ns + 950_000_000
            self.rssi_history.append(self.wireless.rssi_dbm)

    def take_errors(self, record: NetworkErrors) -> None:
        """New counters; what has been added since the last ones is added up."""
        before, self.errors = self.errors, record
        if before is None or record.continuity in {Continuity.FIRST, Continuity.BACK, Continuity.GONE}:
            return
        for field in _ERROR_FIELDS:
            old, new = getattr(before, field), getattr(record, field)
            if old is not None and new is not None and new > old:
                self.error_totals[field] = self.error_totals.get(field, 0) + new - old


class PeerState:
    """Probes to one peer over the last minute."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.sent = 0
        self.lost = 0
        self.last: ProbeResult | None = None
        self.out_since_ns: int | None = None  # CLOCK_MONOTONIC of the last answered probe before the outage
        self.out_total_ns = 0
        self.outages = 0
        self.rtt_history: deque[float | None] = deque(maxlen=HISTORY)
        self._window: deque[tuple[int, int, int | None]] = deque()  # sequence, mono_ns, rtt_ns
        self._second: list[int] = []
        self._second_due_ns = 0
        self._lost_sequences: set[int] = set()

    def take(self, result: ProbeResult) -> None:
        """One result; one that supersedes an earlier result of the same probe changes nothing here."""
        if self.last is not None and (result.state is ProbeState.LATE or result.sequence in self._lost_sequences):
            return
        self.last = result
        self.sent += 1
        rtt_ns = result.rtt_ns if result.state is ProbeState.ANSWERED else None
        if rtt_ns is None:
            self.lost += 1
            self._lost_sequences.add(result.sequence)
            if len(self._lost_sequences) > 65536:
                self._lost_sequences.clear()
        else:
            self._second.append(rtt_ns)
        self._window.append((result.sequence, result.mono_ns, rtt_ns))
        while self._window and self._window[0][1] < result.mono_ns - _PROBE_WINDOW_NS:
            self._window.popleft()
        if result.mono_ns >= self._second_due_ns:
            self._second_due_ns = result.mono_ns + 1_000_000_000
            self.rtt_history.append(median(self._second) if self._second else None)
            self._second.clear()

    def median_rtt_ns(self) -> int | None:
        """Median round trip of the last minute."""
        return median([rtt for _, _, rtt in self._window if rtt is not None])

    def loss(self) -> float | None:
        """Share of the probes of the last minute that were not answered in time, 0..1."""
        if not self._window:
            return None
        return sum(rtt is None for _, _, rtt in self._window) / len(self._window)

    def out_for_ns(self) -> int | None:
        """How long the present outage has lasted."""
        return None if self.out_since_ns is None else time.monotonic_ns() - self.out_since_ns


class LiveState:
    """A sink that keeps what a view needs, in bounded memory."""

    def __init__(self) -> None:
        self.interfaces: dict[str, InterfaceState] = {}
        self.peers: dict[str, PeerState] = {}
        self.account: SelfAccount | None = None
        self.events: deque[LinkEvent] = deque(maxlen=8)
        self.records = 0
        self.started_ns = time.monotonic_ns()

    def take(self, record: Record) -> None:
        """One record."""
        self.records += 1
        if isinstance(record, LinkUtilization):
            self._interface(record.iface).take_utilization(record)
        elif isinstance(record, WirelessLink):
            self._interface(record.iface).take_wireless(record)
        elif isinstance(record, NetworkErrors):
            self._interface(record.iface).take_errors(record)
        elif isinstance(record, ProbeResult):
            self._peer(record.peer).take(record)
        elif isinstance(record, SelfAccount):
            self.account = record
        elif isinstance(record, LinkEvent):
            self.events.append(record)
            self._outage(record)

    def close(self) -> None:
        """Nothing is open."""

    def _outage(self, event: LinkEvent) -> None:
        if event.peer is None:
            return
        if event.kind is EventKind.OUTAGE_BEGAN:
            peer = self._peer(event.peer)
            peer.out_since_ns = event.mono_ns
            peer.outages += 1
        elif event.kind is EventKind.OUTAGE_ENDED:
            peer = self._peer(event.peer)
            peer.out_since_ns = None
            peer.out_total_ns += event.gap_ns or 0

    def _interface(self, name: str) -> InterfaceState:
        if name not in self.interfaces:
            self.interfaces[name] = InterfaceState(name)
        return self.interfaces[name]

    def _peer(self, name: str) -> PeerState:
        if name not in self.peers:
            self.peers[name] = PeerState(name)
        return self.peers[name]


def median(values: list[int]) -> int | None:
    """The upper median, None of nothing."""
    return sorted(values)[len(values) // 2] if values else None
