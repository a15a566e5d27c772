"""What an agent would have recorded at one end of a virtual-time run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from linkrover.records import (
    ClockOffset,
    Continuity,
    EventKind,
    LinkEvent,
    LinkUtilization,
    NetworkErrors,
    Now,
    ProbeResult,
    ProbeState,
    Record,
    TcpConnection,
    Unknown,
    WirelessLink,
)

from .driver import level_dbm

if TYPE_CHECKING:
    from .hop import Hop
    from .tcp_model import TcpConnectionModel
    from .virtual import Simulation
    from .virtual_traffic import Prober

OUTAGE_NS = 1_000_000_000
FLOW_NAMES = {1: "lidar", 2: "camera", 3: "commands", 4: "goals", 5: "results"}


class EndRecords:
    """Samples one end's counters and signal, and watches for what an agent reports as events."""

    def __init__(self, simulation: Simulation, end: str, prober: Prober) -> None:
        self.simulation = simulation
        self.end = end
        self.peer = {"robot": "station", "station": "robot"}[end]
        settings = simulation.settings
        self.iface = settings.iface
        medium = simulation.medium
        self._out: list[Hop] = [hop for hop in medium.hops() if hop.sender == end]
        self._in: list[Hop] = [hop for hop in medium.hops() if hop.receiver == end]
        self.is_access_point = medium.access_point == end
        self._shows_signal = settings.access_point_shows_signal or not self.is_access_point
        self._udp_out = self._udp_in = 0
        self._before: dict[str, int] | None = None
        self._before_ns = 0
        self._associated = dict.fromkeys(self._watched(), True)
        self._lost_ns: dict[str, int] = {}
        self._shown: tuple[bool, float | None] = (True, None)
        self._answered = 0
        self._last_answer_ns = 0
        self._out_since_ns: int | None = None
        self._best_rtt_ns: int | None = None
        if end == "robot":
            prober.on_result = self._probed
        offset_ns = 7_000_000 if end == "robot" else 11_000_000
        if settings.wireless_hz > 0:
            simulation.every(round(1e9 / settings.wireless_hz), self._wireless, offset_ns)
        if settings.utilization_hz > 0:
            simulation.every(round(1e9 / settings.utilization_hz), self._counters, offset_ns)

    def _watched(self) -> tuple[str, ...]:
        return self.simulation.medium.stations if self.is_access_point else (self.end,)

    def _take(self, record: Record) -> None:
        self.simulation.record(self.end, record)

    # ---- signal

    def tick(self, at: Now) -> None:
        """The radio has changed: what the driver shows from now on; association events."""
        medium = self.simulation.medium
        up = medium.associated(self.end if not self.is_access_point else self.peer)
        self._shown = (up, self._in[0].rssi_dbm if up else None)
        for name in self._watched():
            now_up = medium.associated(name)
            if now_up == self._associated[name]:
                continue
            self._associated[name] = now_up
            mine = not self.is_access_point
            if now_up:
                lost_ns = self._lost_ns.pop(name, None)
                kind = EventKind.ASSOCIATED if mine else EventKind.PEER_JOINED
                gap_ns = None if lost_ns is None else at.mono_ns - lost_ns
            else:
                self._lost_ns[name] = at.mono_ns
                kind, gap_ns = EventKind.DISCONNECTED if mine else EventKind.PEER_LEFT, None
            self._take(
                LinkEvent(
                    wall_ns=at.wall_ns,
                    mono_ns=at.mono_ns,
                    iface=self.iface,
                    kind=kind,
                    peer=None if mine else name,
                    gap_ns=gap_ns,
                    detail=f"{name} {kind.value} (simulated)",
                )
            )

    def _wireless(self, now_ns: int) -> None:
        at = self.simulation.stamp(now_ns)
        up, rssi = self._shown
        case = self.simulation.case
        if not self._shows_signal:
            return
        unknown = {} if up else {"rssi_dbm": Unknown.NOT_CONNECTED, "link_quality": Unknown.NOT_CONNECTED}
        level = None if rssi is None else float(level_dbm(rssi))
        self._take(
            WirelessLink(
                wall_ns=at.wall_ns,
                mono_ns=at.mono_ns,
                unknown=unknown,
                iface=self.iface,
                source="wext",
                connected=up,
                mode="ap" if self.is_access_point else "station",
                frequency_mhz=round(case.channel.frequency_mhz) if up else None,
                rssi_dbm=level,
                link_quality=None if level is None else max(0.0, min(70.0, level + 110.0)),
                link_quality_max=70.0,
                tx_failed=sum(hop.dropped_retries for hop in self._out) if up else None,
            )
        )

    # ---- counters

    def _connections(self) -> list[tuple[TcpConnectionModel, bool]]:
        """(connection, whether this end sends its data)."""
        return [(each, each.source == self.end) for each in self.simulation.connections]

    def _counters(self, now_ns: int) -> None:
        at = self.simulation.stamp(now_ns)
        data = self._connections()
        into = sum(c.segments_in for c, mine in data if not mine)
        values = {
            "rx_bytes": sum(hop.delivered_octets for hop in self._in),
            "tx_bytes": sum(hop.offered_octets for hop in self._out),
            "rx_packets": sum(hop.delivered_packets for hop in self._in),
            "tx_packets": sum(hop.offered_packets for hop in self._out),
        }
        retransmits = sum(c.retransmits for c, mine in data if mine)
        # the kernel counts retransmitted segments apart (RetransSegs), and acknowledgements as segments
        probes = self.simulation.prober.sent if self.end == "robot" else self.simulation.prober.reflected
        values |= {
            "tcp_tx_segments": values["tx_packets"] - probes - retransmits,
            "tcp_rx_segments": into + sum(c.acknowledgements_in for c, mine in data if mine),
            "udp_tx_datagrams": probes,
            "udp_rx_datagrams": (
                self.simulation.prober.answered if self.end == "robot" else self.simulation.prober.reflected
            ),
        }
        before, self._before = self._before, values
        interval_ns = None if before is None else now_ns - self._before_ns
        self._before_ns = now_ns
        rates: dict[str, Any] = {}
        unknown: dict[str, Unknown] = {}
        for name, field, factor in (
            ("rx_bytes", "rx_rate_bps", 8),
            ("tx_bytes", "tx_rate_bps", 8),
            ("tcp_tx_segments", "tcp_tx_segments_per_s", 1),
            ("tcp_rx_segments", "tcp_rx_segments_per_s", 1),
            ("udp_tx_datagrams", "udp_tx_datagrams_per_s", 1),
            ("udp_rx_datagrams", "udp_rx_datagrams_per_s", 1),
        ):
            if before is None or not interval_ns:
                unknown[field] = Unknown.NO_BASE
            else:
                rates[field] = (values[name] - before[name]) * factor * 1e9 / interval_ns
        self._take(
            LinkUtilization(
                wall_ns=at.wall_ns,
                mono_ns=at.mono_ns,
                unknown=unknown,
                iface=self.iface,
                continuity=Continuity.FIRST if before is None else Continuity.STEADY,
                interval_ns=interval_ns,
                **values,
                **rates,
            )
        )
        self._take(
            NetworkErrors(
                wall_ns=at.wall_ns,
                mono_ns=at.mono_ns,
                iface=self.iface,
                continuity=Continuity.FIRST if before is None else Continuity.STEADY,
                tcp_retransmits=retransmits,
                tcp_timeouts=sum(c.timeouts for c, mine in data if mine),
                tcp_bad_segments=0,
                udp_errors=0,
                mac_tx_retries=sum(hop.retries for hop in self._out),
                nic_tx_errors=0,
                nic_rx_errors=0,
                nic_tx_dropped=sum(hop.dropped_queue + hop.dropped_unassociated for hop in self._out),
                nic_rx_dropped=0,
            )
        )
        for connection, mine in data:
            if mine:
                self._connection(at, connection)

    def _connection(self, at: Now, connection: TcpConnectionModel) -> None:
        from .virtual import ADDRESSES

        self._take(
            TcpConnection(
                wall_ns=at.wall_ns,
                mono_ns=at.mono_ns,
                iface=self.iface,
                local=f"{ADDRESSES[connection.source]}:{7400 + connection.flow}",
                remote=f"{ADDRESSES[connection.destination]}:{7400 + connection.flow}",
                state="ESTABLISHED",
                process=f"simulated {FLOW_NAMES.get(connection.flow, 'flow')}",
                rtt_us=None if connection.srtt_ns is None else round(connection.srtt_ns / 1000),
                min_rtt_us=None if connection.min_rtt_ns is None else connection.min_rtt_ns // 1000,
                retransmits=connection.retransmits,
                congestion_window=int(connection.window),
                congestion_control="cubic (model)",
                bytes_acked=connection.octets_acknowledged,
                send_queue_bytes=connection.unsent_octets,
            )
        )

    # ---- probes

    def _probed(self, result: ProbeResult) -> None:
        if result.state is not ProbeState.ANSWERED:
            if self._out_since_ns is None and result.mono_ns - self._last_answer_ns > OUTAGE_NS and self._answered:
                self._out_since_ns = self._last_answer_ns
                self._outage(EventKind.OUTAGE_BEGAN, self._last_answer_ns, None)
            return
        gap_ns = result.mono_ns - self._last_answer_ns
        if self._answered and gap_ns > OUTAGE_NS and self._out_since_ns is None:
            self._outage(EventKind.OUTAGE_BEGAN, self._last_answer_ns, None)
            self._out_since_ns = self._last_answer_ns
        if self._out_since_ns is not None:
            self._outage(EventKind.OUTAGE_ENDED, result.mono_ns, result.mono_ns - self._out_since_ns)
            self._out_since_ns = None
        self._last_answer_ns = max(self._last_answer_ns, result.mono_ns)
        self._answered += 1
        rtt_ns = result.rtt_ns
        assert rtt_ns is not None
        if self._best_rtt_ns is None or rtt_ns < self._best_rtt_ns:
            self._best_rtt_ns = rtt_ns
        if self._answered % 10 == 0:
            # both ends share one clock here; the bound is what four timestamps could have told
            self._take(
                ClockOffset(
                    wall_ns=result.wall_ns,
                    mono_ns=result.mono_ns,
                    peer=result.peer,
                    offset_ns=0,
                    error_bound_ns=self._best_rtt_ns // 2,
                    drift_ppb=0.0,
                    samples=self._answered,
                    window_ns=result.mono_ns,
                )
            )

    def _outage(self, kind: EventKind, mono_ns: int, gap_ns: int | None) -> None:
        at = self.simulation.stamp(mono_ns)
        self._take(
            LinkEvent(
                wall_ns=at.wall_ns,
                mono_ns=at.mono_ns,
                iface=self.iface,
                kind=kind,
                peer=self.peer,
                gap_ns=gap_ns,
                detail="no probe answered for more than 1 s"
                if gap_ns is None
                else f"{gap_ns / 1e9:.2f} s without answer",
            )
        )

    def finish(self) -> None:
        """The last sample of every counter."""
        self._counters(self.simulation.now_ns)
