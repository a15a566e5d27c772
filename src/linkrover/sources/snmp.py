"""/proc/net/snmp and /proc/net/netstat: TCP and UDP counters of a whole network namespace (net/ipv4/proc.c)."""

from __future__ import annotations

from functools import lru_cache

import msgspec

from linkrover.errors import ParseError

from .digits import counter, show
from .kept import KeptFile

SNMP_PATH = "/proc/thread-self/net/snmp"
NETSTAT_PATH = "/proc/thread-self/net/netstat"

_TCP = (b"InSegs", b"OutSegs", b"RetransSegs", b"InErrs")
_UDP = (b"InDatagrams", b"OutDatagrams", b"InErrors", b"RcvbufErrors", b"SndbufErrors")
_TCP_EXT = (b"TCPLostRetransmit", b"TCPTimeouts", b"TCPSynRetrans")


class SnmpCounters(msgspec.Struct, frozen=True):
    """Counters of RFC 4022 (TCP) and RFC 4113 (UDP), of the namespace, IPv4 and IPv6 TCP together.

    tcp_out_segments leaves out segments that hold only retransmitted octets, as RFC 4022 says. UDP figures are of
    IPv4 (IPv6 has its own in /proc/net/snmp6). On a 32-bit kernel they wrap at 2^32.
    """

    tcp_in_segments: int
    tcp_out_segments: int
    tcp_retransmits: int
    tcp_bad_segments: int
    udp_in_datagrams: int
    udp_out_datagrams: int
    udp_in_errors: int
    udp_receive_buffer_errors: int
    udp_send_buffer_errors: int


class NetstatCounters(msgspec.Struct, frozen=True):
    """Linux's further TCP counters (include/uapi/linux/snmp.h, LINUX_MIB_*)."""

    tcp_lost_retransmits: int
    tcp_timeouts: int
    tcp_syn_retransmits: int


def parse_snmp(data: bytes, file: str = SNMP_PATH) -> SnmpCounters:
    """The TCP and UDP rows.

    Raises:
        ParseError: torn, a row or column missing, names and values that do not pair up, or not a counter.
    """
    return SnmpCounters(*_row(data, b"Tcp:", _TCP, file), *_row(data, b"Udp:", _UDP, file))


def parse_netstat(data: bytes, file: str = NETSTAT_PATH) -> NetstatCounters:
    """The TcpExt row.

    Raises:
        ParseError: as parse_snmp.
    """
    return NetstatCounters(*_row(data, b"TcpExt:", _TCP_EXT, file))


def _row(data: bytes, prefix: bytes, names: tuple[bytes, ...], file: str) -> list[int]:
    place = prefix.decode()
    start = 0 if data.startswith(prefix) else data.find(b"\n" + prefix) + 1
    if start == 0 and not data.startswith(prefix):
        raise ParseError(file, place, f"a line that begins with '{place}'")
    header_end = data.find(b"\n", start)
    values_end = data.find(b"\n", header_end + 1)
    if header_end < 0 or values_end < 0:
        raise ParseError(file, place, "a line of names and a line of values, both complete")
    values = data[header_end + 1 : values_end].split(b" ")
    if values[0] != prefix:
        raise ParseError(file, place, f"values that begin with '{place}'", show(data[header_end + 1 : values_end]))
    columns, count = _columns(data[start:header_end], names, file, place)
    if len(values) != count:
        raise ParseError(file, place, f"{count - 1} values for {count - 1} names", str(len(values) - 1))
    return [counter(values[column], file, place) for column in columns]


@lru_cache(maxsize=16)
def _columns(header: bytes, names: tuple[bytes, ...], file: str, place: str) -> tuple[tuple[int, ...], int]:
    titles = header.split(b" ")
    for name in names:
        if titles.count(name) != 1:
            raise ParseError(file, place, f"one column {name.decode()}", str(titles.count(name)))
    return tuple(titles.index(name) for name in names), len(titles)


class SnmpReader:
    """Reads /proc/net/snmp of the namespace it was opened in."""

    def __init__(self, path: str = SNMP_PATH) -> None:
        self._file = KeptFile(path)

    def read(self) -> SnmpCounters:
        """The counters now.

        Raises:
            SourceUnavailableError: the file cannot be read.
            ParseError: it is not what it should be.
        """
        return parse_snmp(self._file.read(), self._file.path)

    def close(self) -> None:
        """Give back the file descriptor."""
        self._file.close()


class NetstatReader:
    """Reads /proc/net/netstat of the namespace it was opened in."""

    def __init__(self, path: str = NETSTAT_PATH) -> None:
        self._file = KeptFile(path)

    def read(self) -> NetstatCounters:
        """The counters now.

        Raises:
            SourceUnavailableError: the file cannot be read.
            ParseError: it is not what it should be.
        """
        return parse_netstat(self._file.read(), self._file.path)

    def close(self) -> None:
        """Give back the file descriptor."""
        self._file.close()
