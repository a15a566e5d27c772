"""Which topic fills the air, which connection retransmits: the nodes' own counters joined with the kernel's."""

from __future__ import annotations

import socket
import time
import urllib.parse
from collections.abc import Iterable, Mapping, Sequence

import msgspec

from linkrover.errors import ParseError
from linkrover.records import TcpConnection, TopicTraffic, Unknown, now

from .busstats import OVERFLOW, BusCount, BusLink, increment, parse_bus_info, parse_bus_stats
from .rpc import Rpc, RpcError, master_uri

Key = tuple[str, int, str, str]  # node, connection, topic, direction


class _Seen(msgspec.Struct):
    count: BusCount
    mono_ns: int
    bytes_total: int
    messages_total: int


class NodeTraffic(msgspec.Struct, frozen=True):
    """One node's answer: its connections, and why they are missing if they are."""

    node: str
    links: tuple[BusLink, ...] = ()
    counts: tuple[BusCount, ...] = ()
    problem: str = ""
    overflowed: bool = False


class Row(msgspec.Struct, frozen=True):
    """One connection of one topic, with what the kernel says of it (None: its socket is not on this machine)."""

    traffic: TopicTraffic
    tcp: TcpConnection | None = None


def is_local(host: str) -> bool:
    """Whether one may bind to this host's address, i.e. it is an address of this network namespace."""
    try:
        for family, kind, protocol, _, address in socket.getaddrinfo(host, 0, type=socket.SOCK_DGRAM):
            with socket.socket(family, kind, protocol) as trial:
                try:
                    trial.bind(address)
                except OSError:
                    continue
                return True
    except OSError:
        return False
    return False


class TrafficReader:
    """Reads the bus statistics of the graph's nodes, without subscribing to anything.

    only_local: ask nodes of this machine only, so that asking puts nothing on the air but the call to the master.
    refresh_s: how long the list of nodes is kept.
    """

    def __init__(
        self,
        caller: str = "/linkrover_traffic",
        *,
        only_local: bool = False,
        timeout_s: float = 1.0,
        refresh_s: float = 0.0,
    ) -> None:
        self._caller = caller
        self._only_local = only_local
        self._timeout_s = timeout_s
        self._refresh_s = refresh_s
        self._refresh_due_ns = 0
        self._nodes: dict[str, Rpc] = {}
        self._local: dict[str, bool] = {}
        self._seen: dict[Key, _Seen] = {}
        self.problems: dict[str, str] = {}

    def read(self, connections: Sequence[TcpConnection] = ()) -> list[Row]:
        """One row for each connection of each topic; rates from the second call on.

        Raises:
            RpcError: no master.
        """
        asked_ns = time.monotonic_ns()
        if asked_ns >= self._refresh_due_ns or self.problems:
            self._refresh_nodes()
            self._refresh_due_ns = asked_ns + round(self._refresh_s * 1e9)
        by_uri = {rpc.uri.rstrip("/"): node for node, rpc in self._nodes.items()}
        rows: list[Row] = []
        self.problems = {}
        for node, rpc in self._nodes.items():
            answer = read_node(node, rpc)
            if answer.problem:
                self.problems[node] = answer.problem
            rows += self._rows(answer, by_uri, connections)
        return rows

    def _refresh_nodes(self) -> None:
        master = Rpc(master_uri(), self._caller, self._timeout_s)
        state = master.call("getSystemState")
        names = sorted({n for part in state for _, nodes in part for n in nodes})
        for gone in self._nodes.keys() - set(names):
            del self._nodes[gone]
        for name in names:
            if name not in self._nodes:
                uri = master.call("lookupNode", name)
                host = urllib.parse.urlparse(uri).hostname or ""
                if not self._only_local or self._local.setdefault(host, is_local(host)):
                    self._nodes[name] = Rpc(uri, self._caller, self._timeout_s)

    def _rows(
        self, answer: NodeTraffic, by_uri: Mapping[str, str], connections: Sequence[TcpConnection]
    ) -> Iterable[Row]:
        instant = now()
        counts = {(c.connection, c.topic, c.direction): c for c in answer.counts}
        for link in answer.links:
            tcp = find_connection(link, connections)
            peer = by_uri.get(link.peer.rstrip("/"), link.peer)
            local, remote = _ends(link, tcp)
            count = counts.get((link.connection, link.topic, link.direction))
            unknown: dict[str, Unknown] = {}
            if count is None and answer.overflowed and tcp is not None:
                count = _from_kernel(link, tcp)
            if count is None:
                unknown = {"bytes_total": Unknown.UNSUPPORTED if answer.overflowed else Unknown.ABSENT}
                measured = _Measured()
            else:
                measured = self._measure((answer.node, link.connection, link.topic, link.direction), count)
                if measured.rate_bps is None:
                    unknown = {"rate_bps": Unknown.NO_BASE}
            yield Row(
                TopicTraffic(
                    wall_ns=instant.wall_ns,
                    mono_ns=instant.mono_ns,
                    unknown=unknown,
                    topic=link.topic,
                    node=answer.node,
                    peer=peer,
                    direction=link.direction,
                    transport=link.transport,
                    interval_ns=measured.interval_ns,
                    bytes_total=measured.bytes_total,
                    messages_total=measured.messages_total,
                    rate_bps=measured.rate_bps,
                    messages_per_s=measured.messages_per_s,
                    local=local,
                    remote=remote,
                ),
                tcp,
            )

    def _measure(self, key: Key, count: BusCount) -> _Measured:
        mono_ns = time.monotonic_ns()
        seen = self._seen.get(key)
        kernel = count.messages < 0
        messages = 0 if kernel else count.messages
        if seen is None:
            self._seen[key] = _Seen(count, mono_ns, count.bytes, messages)
            return _Measured(bytes_total=count.bytes, messages_total=None if kernel else messages)
        if kernel != (seen.count.messages < 0):
            # rospy's own counter ended at 2^31 and the kernel's took over: another base, the sum goes on
            self._seen[key] = _Seen(count, mono_ns, seen.bytes_total, seen.messages_total)
            return _Measured(bytes_total=seen.bytes_total)
        byte_step = increment(seen.count.bytes, count.bytes)
        message_step = 0 if kernel else increment(seen.count.messages, count.messages)
        interval_ns = mono_ns - seen.mono_ns
        if byte_step is None or message_step is None or interval_ns <= 0:
            self._seen[key] = _Seen(count, mono_ns, count.bytes, messages)
            return _Measured(bytes_total=count.bytes, messages_total=None if kernel else messages)
        total = _Seen(count, mono_ns, seen.bytes_total + byte_step, seen.messages_total + message_step)
        self._seen[key] = total
        seconds = interval_ns / 1e9
        return _Measured(
            interval_ns=interval_ns,
            bytes_total=total.bytes_total,
            messages_total=None if kernel else total.messages_total,
            rate_bps=byte_step * 8 / seconds,
            messages_per_s=None if kernel else message_step / seconds,
        )


class _Measured(msgspec.Struct, frozen=True):
    interval_ns: int | None = None
    bytes_total: int | None = None
    messages_total: int | None = None
    rate_bps: float | None = None
    messages_per_s: float | None = None


def read_node(node: str, rpc: Rpc) -> NodeTraffic:
    """One node's connections; a node that does not answer is a problem in words, not an error."""
    try:
        links = tuple(parse_bus_info(rpc.raw("getBusInfo")))
        try:
            return NodeTraffic(node, links, tuple(parse_bus_stats(rpc.raw("getBusStats"))))
        except RpcError as error:
            if OVERFLOW not in str(error):
                raise
            return NodeTraffic(
                node, links, problem="its counters passed 2^31 bytes, which rospy cannot send", overflowed=True
            )
    except (RpcError, ParseError) as error:
        return NodeTraffic(node, problem=str(error))


def find_connection(link: BusLink, connections: Sequence[TcpConnection]) -> TcpConnection | None:
    """The kernel's entry of a connection, by its pair of ports (and the remote address, where it is numeric)."""
    if link.local_port is None or link.remote_port is None:
        return None
    matches = [
        c
        for c in connections
        if c.local.rpartition(":")[2] == str(link.local_port) and c.remote.rpartition(":")[2] == str(link.remote_port)
    ]
    if len(matches) > 1:
        exact = [c for c in matches if c.remote.rpartition(":")[0].strip("[]").endswith(link.remote_host or "")]
        matches = exact or matches
    return matches[0] if matches else None


def _ends(link: BusLink, tcp: TcpConnection | None) -> tuple[str | None, str | None]:
    if tcp is not None:
        return tcp.local, tcp.remote
    if link.local_port is None:
        return None, None
    return f"*:{link.local_port}", f"{link.remote_host}:{link.remote_port}"


def _from_kernel(link: BusLink, tcp: TcpConnection) -> BusCount | None:
    """The kernel's byte count in place of rospy's; messages -1 = it does not know messages."""
    total = tcp.bytes_acked if link.direction == "out" else tcp.bytes_received
    return None if total is None else BusCount(link.connection, link.topic, link.direction, total % (1 << 32), -1)
