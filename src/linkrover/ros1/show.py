"""Topic traffic on a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Sequence

import msgspec
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from linkrover.errors import ParseError
from linkrover.records import TcpConnection
from linkrover.sources.interface import interface_names
from linkrover.sources.netlink import NetlinkError
from linkrover.sources.sockdiag import TcpConnections

from .rpc import RpcError
from .traffic import Row, TrafficReader


class KernelConnections:
    """TCP connections over every interface of this machine, as a context manager."""

    def __init__(self) -> None:
        self._sources: list[TcpConnections] = []

    def __enter__(self) -> KernelConnections:
        self._sources = [TcpConnections(name, processes=False) for name in interface_names()]
        return self

    def __exit__(self, *_: object) -> None:
        for source in self._sources:
            source.close()

    def read(self) -> list[TcpConnection]:
        """What the kernel knows now; without the right to ask, nothing."""
        try:
            return [connection for source in self._sources for connection in source.read()]
        except (NetlinkError, ParseError) as error:
            print(f"linkrover: no TCP figures: {error}", file=sys.stderr)
            self._sources = []
            return []


def show_traffic(
    *,
    interval_s: float,
    count: int | None,
    only_local: bool,
    json: bool,
    connections: Callable[[], Iterable[TcpConnection]] | None = None,
) -> int:
    """Read and show until count readings were made or Ctrl-C. Returns the exit status.

    Raises:
        RpcError: no master at the start.
    """
    reader = TrafficReader(only_local=only_local)
    reader.read(tuple(connections()) if connections else ())  # the base of the first rates
    console = Console()
    encoder = msgspec.json.Encoder()
    start_s = time.monotonic()
    live = None if json or not console.is_terminal else Live(console=console, auto_refresh=False)
    try:
        if live is not None:
            live.start()
        turn = 0
        while count is None or turn < count:
            turn += 1
            time.sleep(max(0.0, start_s + turn * interval_s - time.monotonic()))
            try:
                rows = reader.read(tuple(connections()) if connections else ())
            except RpcError as error:
                print(f"linkrover: {error}; asking again", file=sys.stderr)
                continue
            if json:
                for row in rows:
                    sys.stdout.write(encoder.encode(row).decode() + "\n")
                sys.stdout.flush()
            elif live is not None:
                live.update(picture(rows, reader.problems), refresh=True)
            else:
                console.print(picture(rows, reader.problems))
    except KeyboardInterrupt:
        return 130 if count is not None else 0
    finally:
        if live is not None:
            live.stop()
    return 0


def picture(rows: Sequence[Row], problems: dict[str, str]) -> Group:
    """Two tables: topics by what they put on the wire, connections with the kernel's figures."""
    return Group(_topics(rows), _connections(rows), *(Text(f"{n}: {p}", "yellow") for n, p in sorted(problems.items())))


def _topics(rows: Sequence[Row]) -> Table:
    table = Table(title="topics (sum over subscribers, as sent)", expand=False)
    for name in ("topic", "kbit/s", "messages/s", "subscribers"):
        table.add_column(name, justify="left" if name == "topic" else "right")
    sent: dict[str, list[Row]] = {}
    for row in rows:
        if row.traffic.direction == "out":
            sent.setdefault(row.traffic.topic, []).append(row)
    # a topic whose publisher was not asked is still seen by its subscribers
    for row in rows:
        if row.traffic.direction == "in" and row.traffic.topic not in sent:
            sent.setdefault(row.traffic.topic, []).append(row)
    sums = {topic: sum(r.traffic.rate_bps or 0.0 for r in found) for topic, found in sent.items()}
    for topic in sorted(sent, key=lambda t: (-sums[t], t)):
        found = sent[topic]
        known = [r.traffic.messages_per_s for r in found if r.traffic.messages_per_s is not None]
        table.add_row(topic, f"{sums[topic] / 1e3:.1f}", f"{sum(known):.1f}" if known else "-", str(len(found)))
    return table


def _connections(rows: Sequence[Row]) -> Table:
    table = Table(title="connections", expand=False)
    for name in ("topic", "from", "to", "kbit/s", "total MB", "RTT ms", "retransmits", "cwnd", "delivery Mbit/s"):
        table.add_column(name, justify="left" if name in ("topic", "from", "to") else "right", overflow="fold")
    for row in sorted(rows, key=lambda r: (-(r.traffic.rate_bps or 0.0), r.traffic.topic, r.traffic.node)):
        t, k = row.traffic, row.tcp
        source, target = (t.node, t.peer) if t.direction == "out" else (t.peer, t.node)
        if t.direction == "in" and _is_seen_from_the_other_end(row, rows):
            continue
        table.add_row(
            t.topic,
            source,
            target,
            _number(t.rate_bps, 1e3),
            _number(t.bytes_total, 1e6),
            _number(None if k is None else k.rtt_us, 1e3),
            "-" if k is None or k.retransmits is None else str(k.retransmits),
            "-" if k is None or k.congestion_window is None else str(k.congestion_window),
            _number(None if k is None else k.delivery_rate_bps, 1e6),
        )
    return table


def _is_seen_from_the_other_end(row: Row, rows: Sequence[Row]) -> bool:
    mine = row.traffic
    return any(
        r.traffic.direction == "out"
        and r.traffic.topic == mine.topic
        and r.traffic.node == mine.peer
        and r.traffic.peer == mine.node
        for r in rows
    )


def _number(value: float | None, unit: float) -> str:
    return "-" if value is None else f"{value / unit:.1f}"
