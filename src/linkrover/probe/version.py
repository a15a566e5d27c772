"""Which LinkRover version a peer's reflector is."""

from __future__ import annotations

import secrets
import socket
import time

from linkrover.errors import ParseError

from . import packet
from .address import resolve

_TRIES = 3


def ask_version(host: str, port: int, *, key: bytes | None = None, timeout_s: float = 0.5) -> str | None:
    """Version of the reflector at host, blocking for at most three time-outs.

    None where nothing answered, or a reflector of another make.

    Raises:
        ConfigError: the host is not known.
    """
    endpoint = resolve(host, port)
    with socket.socket(endpoint.family, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
        sock.settimeout(timeout_s)
        for number in range(1, _TRIES + 1):
            sent = packet.SenderPacket(number, time.time_ns(), ssid=1 + secrets.randbelow(0xFFFF))
            try:
                sock.sendto(packet.encode_sender(sent, key=key) + packet.version_request(), endpoint.address)
                data, source = sock.recvfrom(2_048)
                reply = packet.decode_reflector(data, key=key)
            except (OSError, ParseError):
                continue
            if endpoint.is_from(source) and reply.sender_timestamp_ns == sent.timestamp_ns:
                return packet.version_of(data, authenticated=key is not None)
    return None
