"""Per-connection TCP as the kernel's sock_diag gives it."""

from __future__ import annotations

from .base import Record


class TcpConnection(Record, frozen=True, kw_only=True):
    """One connection (struct tcp_info, include/uapi/linux/tcp.h). Counters are raw and of this connection only."""

    iface: str
    local: str  # address:port
    remote: str
    state: str
    inode: int = 0
    process: str | None = None
    rtt_us: int | None = None
    rtt_var_us: int | None = None
    min_rtt_us: int | None = None
    retransmits: int | None = None
    lost: int | None = None
    reordering: int | None = None
    congestion_window: int | None = None
    congestion_control: str | None = None
    pacing_rate_bps: int | None = None
    delivery_rate_bps: int | None = None
    bytes_sent: int | None = None
    bytes_acked: int | None = None
    bytes_received: int | None = None
    bytes_retransmitted: int | None = None
    busy_us: int | None = None
    receive_window_limited_us: int | None = None
    send_buffer_limited_us: int | None = None
    send_queue_bytes: int | None = None
    receive_queue_bytes: int | None = None
    bbr_bandwidth_bps: int | None = None  # what BBR believes the path carries
    bbr_min_rtt_us: int | None = None


class TopicTraffic(Record, frozen=True, kw_only=True):
    """Bytes and messages of one ROS topic over one connection, from the nodes' own bus statistics."""

    topic: str
    node: str
    peer: str
    direction: str  # "in" or "out"
    transport: str = "TCPROS"
    interval_ns: int | None = None
    bytes_total: int | None = None
    messages_total: int | None = None
    rate_bps: float | None = None
    messages_per_s: float | None = None
    local: str | None = None  # address:port, joins with TcpConnection
    remote: str | None = None
