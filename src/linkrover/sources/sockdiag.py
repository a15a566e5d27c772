"""TCP connections one by one, from the kernel's sock_diag.

Numbers: linux/inet_diag.h, linux/sock_diag.h, struct tcp_info of linux/tcp.h, struct tcp_bbr_info.
"""

from __future__ import annotations

import socket
import struct
from typing import Any, NamedTuple

from ..errors import ParseError
from ..records import Now, TcpConnection, Unknown, now
from .genetlink import text
from .netlink import NETLINK_ROUTE, NETLINK_SOCK_DIAG, NetlinkSocket, attribute_list, attributes
from .socket_process import ProcessNames

SOCK_DIAG_BY_FAMILY = 20
INET_DIAG_INFO, INET_DIAG_VEGASINFO, INET_DIAG_CONG, INET_DIAG_BBRINFO = 2, 3, 4, 16
RTM_NEWADDR, RTM_GETADDR = 20, 22
IFA_ADDRESS, IFA_LOCAL = 1, 2

STATES = {
    1: "established",
    2: "syn-sent",
    3: "syn-received",
    4: "fin-wait-1",
    5: "fin-wait-2",
    6: "time-wait",
    7: "close",
    8: "close-wait",
    9: "last-ack",
    10: "listen",
    11: "closing",
    12: "new-syn-received",
}
_ALIVE = sum(1 << state for state in (1, 2, 3, 4, 5, 8, 9, 11))

_REQUEST = struct.Struct("=BBBBI48x")  # struct inet_diag_req_v2
_MESSAGE = struct.Struct("=4B2s2s16s16sIQIIIII")  # struct inet_diag_msg
_INFO: tuple[tuple[str, int, struct.Struct], ...] = tuple(
    (name, offset, struct.Struct("=" + form))
    for name, offset, form in (
        ("lost", 32, "I"),
        ("rtt_us", 68, "I"),
        ("rtt_var_us", 72, "I"),
        ("congestion_window", 80, "I"),
        ("reordering", 88, "I"),
        ("retransmits", 100, "I"),
        ("pacing_rate_bps", 104, "Q"),
        ("bytes_acked", 120, "Q"),
        ("bytes_received", 128, "Q"),
        ("min_rtt_us", 148, "I"),
        ("delivery_rate_bps", 160, "Q"),
        ("busy_us", 168, "Q"),
        ("receive_window_limited_us", 176, "Q"),
        ("send_buffer_limited_us", 184, "Q"),
        ("bytes_sent", 200, "Q"),
        ("bytes_retransmitted", 208, "Q"),
    )
)
_INFO_LEAST = 104  # up to tcpi_total_retrans: kernels since 2.6
_BBR = struct.Struct("=III")


class SocketEnd(NamedTuple):
    """The fixed part of a sock_diag answer."""

    family: int
    state: int
    source: bytes
    source_port: int
    destination: bytes
    destination_port: int
    ifindex: int
    receive_queue_bytes: int
    send_queue_bytes: int
    uid: int
    inode: int


def parse_end(payload: bytes, file: str = "sock_diag") -> SocketEnd:
    """Struct inet_diag_msg.

    Raises:
        ParseError: too short, or an address family that is not IP.
    """
    if len(payload) < _MESSAGE.size:
        raise ParseError(file, "start", f"{_MESSAGE.size} bytes", f"{len(payload)} bytes")
    family, state, _, _, sport, dport, source, destination, ifindex, _, _, rqueue, wqueue, uid, inode = (
        _MESSAGE.unpack_from(payload)
    )
    if family == socket.AF_INET:
        source, destination = source[:4], destination[:4]
    elif family != socket.AF_INET6:
        raise ParseError(file, "family", "AF_INET or AF_INET6", str(family))
    elif source[:12] == _MAPPED and destination[:12] == _MAPPED:  # IPv4 through an IPv6 socket
        source, destination = source[12:], destination[12:]
    return SocketEnd(
        family,
        state,
        source,
        int.from_bytes(sport, "big"),
        destination,
        int.from_bytes(dport, "big"),
        ifindex,
        rqueue,
        wqueue,
        uid,
        inode,
    )


_MAPPED = bytes(10) + b"\xff\xff"


def parse_tcp_info(data: bytes, file: str = "tcp_info") -> dict[str, int]:
    """Struct tcp_info as fields of TcpConnection; what this kernel's struct does not hold is left out.

    Raises:
        ParseError: shorter than any kernel's.
    """
    if len(data) < _INFO_LEAST:
        raise ParseError(file, "start", f"at least {_INFO_LEAST} bytes", f"{len(data)} bytes")
    found = {}
    for name, offset, form in _INFO:
        if offset + form.size > len(data):
            continue
        value = form.unpack_from(data, offset)[0]
        if name.endswith("_bps"):
            if value == 0xFFFFFFFFFFFFFFFF:
                continue  # not paced
            value *= 8
            if value == 0:
                continue  # nothing delivered yet
        elif (name == "min_rtt_us" and value == 0xFFFFFFFF) or (name.startswith("rtt") and value == 0):
            continue  # no round trip measured yet
        found[name] = value
    return found


def parse_connection(
    payload: bytes, at: Now, iface: str, process: str | None = None, file: str = "sock_diag"
) -> TcpConnection:
    """One answer of the TCP dump.

    Raises:
        ParseError: it is too short, or an attribute points outside of it.
    """
    end = parse_end(payload, file)
    fields: dict[str, Any] = {}
    for kind, value in attribute_list(payload, file, _MESSAGE.size):
        if kind == INET_DIAG_INFO:
            fields.update(parse_tcp_info(value, file))
        elif kind == INET_DIAG_CONG:
            fields["congestion_control"] = text(value) or None
        elif kind == INET_DIAG_BBRINFO and len(value) >= _BBR.size:
            low, high, min_rtt_us = _BBR.unpack_from(value)
            fields["bbr_bandwidth_bps"] = (high << 32 | low) * 8
            fields["bbr_min_rtt_us"] = None if min_rtt_us == 0xFFFFFFFF else min_rtt_us
    unknown = {}
    for name in _EXPECTED:
        if name not in fields:
            unknown[name] = Unknown.NO_BASE if name in _LATER else Unknown.UNSUPPORTED
    if process is None:  # inode 0: no process holds it any more
        unknown["process"] = Unknown.NOT_PERMITTED if end.inode else Unknown.ABSENT
    return TcpConnection(
        wall_ns=at.wall_ns,
        mono_ns=at.mono_ns,
        iface=iface,
        local=_place(end.source, end.source_port),
        remote=_place(end.destination, end.destination_port),
        state=STATES.get(end.state, str(end.state)),
        inode=end.inode,
        process=process,
        send_queue_bytes=end.send_queue_bytes,
        receive_queue_bytes=end.receive_queue_bytes,
        unknown=unknown,
        **fields,
    )


_LATER = ("rtt_us", "rtt_var_us", "min_rtt_us", "pacing_rate_bps", "delivery_rate_bps")
_EXPECTED = (*(name for name, _, _ in _INFO), "congestion_control")


def _place(address: bytes, port: int) -> str:
    if len(address) == 4:
        return f"{socket.inet_ntop(socket.AF_INET, address)}:{port}"
    return f"[{socket.inet_ntop(socket.AF_INET6, address)}]:{port}"


def parse_address(payload: bytes, file: str = "rtnetlink address") -> tuple[int, bytes] | None:
    """(interface index, address) of an RTM_NEWADDR message; None for a family that is not IP.

    Raises:
        ParseError: it is too short, or an attribute points outside of it.
    """
    if len(payload) < 8:
        raise ParseError(file, "start", "8 bytes", f"{len(payload)} bytes")
    family, ifindex = payload[0], struct.unpack_from("=I", payload, 4)[0]
    size = 4 if family == socket.AF_INET else 16 if family == socket.AF_INET6 else None
    found = attributes(payload, file, 8)
    address = found.get(IFA_LOCAL, found.get(IFA_ADDRESS, b""))  # IFA_ADDRESS is the peer's on point-to-point links
    return (ifindex, address) if size is not None and len(address) == size else None


class TcpConnections:
    """TCP connections over one interface: those from one of its addresses, or bound to it.

    Reading needs no privileges; the process is named where /proc permits (own processes, or all as root).

    Raises:
        NetlinkError: this kernel has no sock_diag.
    """

    def __init__(self, iface: str, *, processes: bool = True) -> None:
        self._iface = iface
        self._diag = NetlinkSocket(NETLINK_SOCK_DIAG)
        self._route = NetlinkSocket(NETLINK_ROUTE)
        self._processes = ProcessNames() if processes else None

    def addresses(self) -> set[bytes]:
        """The interface's IP addresses; empty while it is absent."""
        try:
            ifindex = socket.if_nametoindex(self._iface)
        except OSError:
            return set()
        answers = self._route.request(RTM_GETADDR, bytes(8), dump=True, asked="addresses")
        return {found[1] for found in map(parse_address, answers) if found is not None and found[0] == ifindex}

    def read(self, at: Now | None = None) -> list[TcpConnection]:
        """The connections now.

        Raises:
            NetlinkError: the kernel refused or did not answer.
            ParseError: the answer is damaged.
        """
        at = at or now()
        ours = self.addresses()
        if not ours:
            return []
        ifindex = _index(self._iface)
        extensions = 1 << (INET_DIAG_INFO - 1) | 1 << (INET_DIAG_VEGASINFO - 1) | 1 << (INET_DIAG_CONG - 1)
        chosen: list[tuple[bytes, SocketEnd]] = []
        for family in (socket.AF_INET, socket.AF_INET6):
            request = _REQUEST.pack(family, socket.IPPROTO_TCP, extensions, 0, _ALIVE)
            for payload in self._diag.request(SOCK_DIAG_BY_FAMILY, request, dump=True, asked="TCP connections"):
                end = parse_end(payload)
                if end.source in ours or (ifindex is not None and end.ifindex == ifindex):
                    chosen.append((payload, end))
        names: dict[int, str] = {}
        if self._processes is not None and chosen:
            names = self._processes.names({end.inode for _, end in chosen})
        return [parse_connection(payload, at, self._iface, names.get(end.inode)) for payload, end in chosen]

    def close(self) -> None:
        """Give back the sockets."""
        self._diag.close()
        self._route.close()


def _index(iface: str) -> int | None:
    try:
        return socket.if_nametoindex(iface)
    except OSError:
        return None
