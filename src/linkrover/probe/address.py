"""Where a peer is: HOST, HOST:PORT, [V6]:PORT and what they resolve to."""

from __future__ import annotations

import ipaddress
import socket
from pathlib import Path

import msgspec

from linkrover.errors import ConfigError

from .packet import DEFAULT_PORT

KEY_BYTES_LEAST = 16


class Endpoint(msgspec.Struct, frozen=True):
    """A resolved UDP peer: address family and the socket address of Python's socket module."""

    family: int
    address: tuple[str, int] | tuple[str, int, int, int]

    def __str__(self) -> str:
        host, port = self.address[:2]
        return f"[{host}]:{port}" if self.family == socket.AF_INET6 else f"{host}:{port}"

    @property
    def host(self) -> str:
        """The address alone, with its zone (`fe80::1%wlan0`) where it has one."""
        host = self.address[0]
        if len(self.address) == 4 and self.address[3] and "%" not in host:
            return f"{host}%{socket.if_indextoname(self.address[3])}"
        return host

    def is_from(self, address: tuple[str, int] | tuple[str, int, int, int]) -> bool:
        """Whether a packet from `address` is this peer's (flow label and scope left aside)."""
        return address[:2] == (self.address[0].split("%")[0], self.address[1]) or address[:2] == self.address[:2]


def split_host_port(text: str, default_port: int = DEFAULT_PORT) -> tuple[str, int]:
    """`robot`, `10.0.0.1:862`, `fe80::1%wlan0`, `[fe80::1%wlan0]:862` to host and port.

    Raises:
        ConfigError: no host, or a port outside 1..65535.
    """
    host, port_text = text.strip(), ""
    if host.startswith("["):
        host, closed, rest = host[1:].partition("]")
        port_text = rest.removeprefix(":")
        if not closed or (rest and not port_text) or (rest and not rest.startswith(":")):
            raise ConfigError(f"peer '{text}': expected [ADDRESS]:PORT")
    elif host.count(":") == 1:
        host, _, port_text = host.partition(":")
        if not port_text:
            raise ConfigError(f"peer '{text}': expected HOST or HOST:PORT")
    if not host:
        raise ConfigError(f"peer '{text}': no host; expected HOST or HOST:PORT")
    if not port_text:
        return host, default_port
    if not (port_text.isascii() and port_text.isdigit() and 1 <= int(port_text) <= 65_535):
        raise ConfigError(f"peer '{text}': the port must be a number from 1 to 65535")
    return host, int(port_text)


def numeric(host: str, port: int) -> Endpoint | None:
    """The endpoint of an address in figures, without asking any name service; None for a name."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return None
    try:
        return resolve(str(address), port)
    except ConfigError:
        return None


def resolve(host: str, port: int) -> Endpoint:
    """The first address the system's resolver gives for a host. May block on the name service.

    Raises:
        ConfigError: the name is not known, or the port is out of range.
    """
    if not 1 <= port <= 65_535:
        raise ConfigError(f"port {port}: must be from 1 to 65535")
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise ConfigError(
            f"cannot find the address of '{host}' ({error}); give its IP address, or mend DNS or /etc/hosts"
        ) from error
    for family, _, _, _, address in found:
        if family in (socket.AF_INET, socket.AF_INET6):
            return Endpoint(int(family), address)  # type: ignore[arg-type]  # typeshed allows AF_UNSPEC's tuple too
    raise ConfigError(f"'{host}' has no IPv4 or IPv6 address")


def load_key(path: Path | str) -> bytes:
    """The shared key of authenticated mode: a file's octets without surrounding white space.

    Raises:
        ConfigError: the file cannot be read, or holds fewer than 16 octets.
    """
    try:
        key = Path(path).read_bytes().strip()
    except OSError as error:
        raise ConfigError(f"cannot read the key file {path}: {error.strerror}") from error
    if len(key) < KEY_BYTES_LEAST:
        raise ConfigError(
            f"the key in {path} has {len(key)} octets, at least {KEY_BYTES_LEAST} are needed; make one with: "
            f"openssl rand -hex 32 > {path}"
        )
    return key
