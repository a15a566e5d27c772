"""Addresses, queueing disciplines and routes as the kernel has them (linux/rtnetlink.h), read without privileges."""

from __future__ import annotations

import errno
import ipaddress
import socket
import struct
from collections.abc import Iterable
from typing import NamedTuple

from linkrover.errors import ParseError
from linkrover.sources.netlink import NETLINK_ROUTE, NetlinkError, NetlinkSocket, attributes, pack

RTM_GETADDR, RTM_GETROUTE, RTM_GETQDISC = 22, 26, 38
TC_H_ROOT = 0xFFFF_FFFF
_IFADDR = struct.Struct("=BBBBI")
_TC = struct.Struct("=BxxxiIII")
_ROUTE = struct.Struct("=BBBBBBBBI")
_NO_ROUTE = (errno.ENETUNREACH, errno.EHOSTUNREACH)

Address = ipaddress.IPv4Interface | ipaddress.IPv6Interface


class Owned(NamedTuple):
    """An address of this machine and the index of its interface."""

    ifindex: int
    address: Address


class Qdisc(NamedTuple):
    """A queueing discipline: kind, index of its interface, whether it is the root one."""

    ifindex: int
    kind: str
    root: bool


class Route(NamedTuple):
    """Where packets to an address go: index of the interface, source address, gateway."""

    ifindex: int
    source: str | None
    gateway: str | None


def parse_address(payload: bytes, file: str = "rtnetlink address") -> Owned:
    """One RTM_NEWADDR message.

    Raises:
        ParseError: it does not hold an address.
    """
    if len(payload) < _IFADDR.size:
        raise ParseError(file, "start", f"{_IFADDR.size} bytes", f"{len(payload)} bytes")
    _, prefix, _, _, index = _IFADDR.unpack_from(payload)
    found = attributes(payload, file, _IFADDR.size)
    data = found.get(2, found.get(1, b""))  # IFA_LOCAL, for point-to-point links; else IFA_ADDRESS
    try:
        return Owned(index, ipaddress.ip_interface((_ip(data, file), prefix)))
    except ValueError as error:
        raise ParseError(file, "prefix length", "0 to 32 or 128", str(prefix)) from error


def parse_qdisc(payload: bytes, file: str = "rtnetlink qdisc") -> Qdisc:
    """One RTM_NEWQDISC message.

    Raises:
        ParseError: it does not hold a discipline's name.
    """
    if len(payload) < _TC.size:
        raise ParseError(file, "start", f"{_TC.size} bytes", f"{len(payload)} bytes")
    _, index, _, parent, _ = _TC.unpack_from(payload)
    kind = attributes(payload, file, _TC.size).get(1, b"").rstrip(b"\0").decode("ascii", "replace")
    if not kind:
        raise ParseError(file, "attribute 1", "the name of a queueing discipline", "nothing")
    return Qdisc(index, kind, parent == TC_H_ROOT)


def parse_route(payload: bytes, file: str = "rtnetlink route") -> Route:
    """One RTM_NEWROUTE message.

    Raises:
        ParseError: it does not name an interface.
    """
    if len(payload) < _ROUTE.size:
        raise ParseError(file, "start", f"{_ROUTE.size} bytes", f"{len(payload)} bytes")
    found = attributes(payload, file, _ROUTE.size)
    index = found.get(4, b"")
    if len(index) != 4:
        raise ParseError(file, "attribute 4", "an interface index of 4 bytes", f"{len(index)} bytes")
    source, gateway = found.get(7), found.get(5)
    return Route(
        struct.unpack("=I", index)[0],
        None if source is None else str(_ip(source, file)),
        None if gateway is None else str(_ip(gateway, file)),
    )


class RouteTables:
    """Asks the kernel's routing."""

    def __init__(self) -> None:
        self._netlink = NetlinkSocket(NETLINK_ROUTE)

    def addresses(self) -> list[Owned]:
        """Every address of this network namespace."""
        answers = self._netlink.request(RTM_GETADDR, _IFADDR.pack(0, 0, 0, 0, 0), dump=True, asked="list addresses")
        return [parse_address(one) for one in answers]

    def qdiscs(self) -> list[Qdisc]:
        """Every queueing discipline of this network namespace."""
        answers = self._netlink.request(RTM_GETQDISC, _TC.pack(0, 0, 0, 0, 0), dump=True, asked="list qdiscs")
        return [parse_qdisc(one) for one in answers]

    def route(self, to: str, source: str | None = None) -> Route | None:
        """Where a packet to this address would go, None where there is no route.

        Raises:
            NetlinkError: the kernel refused for another reason.
        """
        target = ipaddress.ip_address(to.split("%", maxsplit=1)[0])
        family = socket.AF_INET if target.version == 4 else socket.AF_INET6
        from_ = None if source is None else ipaddress.ip_address(source)
        bits = target.max_prefixlen
        request = _ROUTE.pack(family, bits, 0 if from_ is None else bits, 0, 0, 0, 0, 0, 0) + pack(1, target.packed)
        if from_ is not None:
            request += pack(2, from_.packed)
        try:
            answers = self._netlink.request(RTM_GETROUTE, request, asked=f"route to {to}")
        except NetlinkError as error:
            if error.code in _NO_ROUTE:
                return None
            raise
        return parse_route(answers[0]) if answers else None

    def close(self) -> None:
        """Give back the socket."""
        self._netlink.close()


def shared_networks(owned: Iterable[tuple[str, Address]]) -> list[tuple[str, str, str]]:
    """(network, interface, interface) for each pair of interfaces with addresses in overlapping networks.

    Link-local and loopback networks are on every interface by design and are left out, host routes too.
    """
    found = []
    networks = [
        (name, a.network)
        for name, a in owned
        if not (a.is_link_local or a.is_loopback) and a.network.prefixlen < a.max_prefixlen
    ]
    for i, (name, network) in enumerate(networks):
        for other, second in networks[i + 1 :]:
            if name != other and network.version == second.version and network.overlaps(second):
                found.append((str(network), name, other))
    return found


def _ip(data: bytes, file: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    if len(data) not in (4, 16):
        raise ParseError(file, "an address", "4 or 16 bytes", f"{len(data)} bytes")
    return ipaddress.ip_address(data)
