"""What the agent knows now, for Prometheus: one gauge a figure, absent while it is unknown."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from linkrover.errors import ConfigError, LinkRoverError, MissingExtraError
from linkrover.records import (
    LinkUtilization,
    NetworkErrors,
    ProbeResult,
    ProbeState,
    Record,
    SelfAccount,
    StationLink,
    WirelessLink,
)

if TYPE_CHECKING:
    from prometheus_client.core import Metric

# record type -> (labels, (field, metric, help, kind)); names follow Prometheus: base units, counters end in _total
GAUGES: dict[type[Record], tuple[tuple[str, ...], tuple[tuple[str, str, str, str], ...]]] = {
    WirelessLink: (
        ("iface", "peer"),
        (
            ("rssi_dbm", "rssi_dbm", "Received signal, dBm", "gauge"),
            ("noise_dbm", "noise_dbm", "Noise, dBm", "gauge"),
            ("link_quality", "link_quality", "Link quality on the driver's own scale", "gauge"),
            ("connected", "connected", "1 = associated", "gauge"),
        ),
    ),
    StationLink: (
        ("iface", "peer"),
        (
            ("tx_retries", "mac_tx_retries_total", "Frames sent again to this peer", "counter"),
            ("tx_failed", "mac_tx_failed_total", "Frames given up to this peer", "counter"),
        ),
    ),
    LinkUtilization: (
        ("iface",),
        (
            ("rx_bytes", "receive_bytes_total", "Bytes received", "counter"),
            ("tx_bytes", "transmit_bytes_total", "Bytes sent", "counter"),
            ("rx_rate_bps", "receive_bits_per_second", "Received over the last interval", "gauge"),
            ("tx_rate_bps", "transmit_bits_per_second", "Sent over the last interval", "gauge"),
        ),
    ),
    NetworkErrors: (
        ("iface",),
        (
            ("tcp_retransmits", "tcp_retransmits_total", "TCP segments sent again, whole machine", "counter"),
            ("udp_errors", "udp_errors_total", "UDP datagrams that could not be delivered, whole machine", "counter"),
            ("nic_tx_errors", "transmit_errors_total", "Send errors of the device", "counter"),
            ("nic_rx_errors", "receive_errors_total", "Receive errors of the device", "counter"),
            ("nic_tx_dropped", "transmit_dropped_total", "Packets the device dropped sending", "counter"),
            ("nic_rx_dropped", "receive_dropped_total", "Packets the device dropped receiving", "counter"),
        ),
    ),
    SelfAccount: (
        (),
        (
            ("rss_bytes", "agent_resident_bytes", "Resident memory of the agent", "gauge"),
            ("records_lost", "agent_records_lost", "Records the last account could not write", "gauge"),
        ),
    ),
}
RTT_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)


class Metrics:
    """A sink that answers Prometheus on `host`:`port` (loopback unless told otherwise) in a thread of its own.

    Raises:
        MissingExtraError: prometheus-client is not installed.
        LinkRoverError: the address cannot be bound.
    """

    def __init__(self, port: int, host: str = "127.0.0.1", *, role: str = "robot") -> None:
        try:
            from prometheus_client import CollectorRegistry, Counter, Histogram, start_http_server
        except ImportError as error:
            raise MissingExtraError("live", "prometheus-client") from error
        self._role = role
        self._latest: dict[tuple[type[Record], tuple[str, ...]], Record] = {}
        registry = CollectorRegistry()
        registry.register(_Collector(self))
        self._rtt = Histogram(
            "linkrover_rtt_seconds", "STAMP round trip", ["role", "peer"], buckets=RTT_BUCKETS_S, registry=registry
        )
        self._probes = Counter("linkrover_probes", "Probes by their fate", ["role", "peer", "state"], registry=registry)
        try:
            self._server, self._thread = start_http_server(port, addr=host, registry=registry)
        except OSError as error:
            raise LinkRoverError(f"metrics cannot listen on {host}:{port}: {error.strerror or error}") from error

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._server.server_port)

    def take(self, record: Record) -> None:
        """Keep the latest of each kind; probes are counted."""
        kind = type(record)
        if isinstance(record, ProbeResult):
            self._probes.labels(self._role, record.peer, record.state.value).inc()
            if record.state is ProbeState.ANSWERED and record.rtt_ns is not None:
                self._rtt.labels(self._role, record.peer).observe(record.rtt_ns / 1e9)
        elif kind in GAUGES:
            labels = tuple(str(getattr(record, name) or "") for name in GAUGES[kind][0])
            self._latest[kind, labels] = record

    def close(self) -> None:
        """Stop answering."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def collect(self) -> Iterator[Metric]:
        """The figures of now (called in the server's thread)."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        latest = dict(self._latest)  # one atomic copy: the agent's thread goes on writing
        for kind, (labels, figures) in GAUGES.items():
            for field, name, text, sort in figures:
                family: Any = CounterMetricFamily if sort == "counter" else GaugeMetricFamily
                metric = family(f"linkrover_{name}", text, labels=["role", *labels])
                for (taken, values), record in latest.items():
                    value = getattr(record, field) if taken is kind else None
                    if value is not None:
                        metric.add_metric([self._role, *values], float(value))
                yield metric


class _Collector:
    def __init__(self, metrics: Metrics) -> None:
        self._metrics = metrics

    def collect(self) -> Iterator[Metric]:
        return self._metrics.collect()


def parse_address(text: str) -> tuple[str, int]:
    """`PORT` or `HOST:PORT` -> (host, port); loopback where no host is said.

    Raises:
        ConfigError: not of that form.
    """
    host, _, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise ConfigError(f"--metrics {text}: expected PORT or HOST:PORT, the port from 0 to 65535")
    return host.strip("[]") or "127.0.0.1", int(port)
