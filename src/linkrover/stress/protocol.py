"""What the two ends say to each other: one JSON object a line over TCP, no line above 4 KiB.

Both prove that they hold the consent token without sending it: each answers the other's nonce with an HMAC. Load goes
only between the two addresses of that connection.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import socket
import time
from pathlib import Path

import msgspec

from linkrover.errors import ConfigError, LinkRoverError, ParseError

PROTOCOL = 1
DEFAULT_PORT = 8621
"""TCP port of the consent server."""
LINE_BYTES_MOST = 4_096
TOKEN_BYTES_LEAST = 16
SESSION_BYTES = 16


class StressError(LinkRoverError):
    """The other end refused, does not hold the token, or went away."""


class Hello(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Server's first line. nonce: hexadecimal. Limits are what it would consent to."""

    protocol: int
    version: str
    nonce: str
    seconds_most: float
    rate_bps_most: float
    reflector_port: int | None = None


class Ask(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Client's answer; mac proves the token."""

    protocol: int
    version: str
    nonce: str
    mac: str


class Consent(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Server's yes; mac proves that it holds the token too. session opens data connections, for this client only."""

    mac: str
    session: str
    udp_port: int


class Refusal(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Server's no, with the reason in words."""

    reason: str


class Load(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Client asks for one phase of load. up: client to server."""

    profile: str
    up: bool
    down: bool
    seconds: float
    rate_bps: float | None = None


class Ready(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Server awaits the data connections of that phase, or datagrams that carry its number."""

    streams: int
    phase: int


class Finish(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Client is through with its side of the phase and asks for the server's figures."""


class Outcome(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """The server's figures of a phase: what it received (up) and sent (down)."""

    received_bytes: int
    received_bps: float
    received_datagrams: int
    sent_bytes: int
    sent_datagrams: int
    frames_sent: int
    frames_dropped: int


class Attach(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """First line of a data connection. up: the client sends on it."""

    session: str
    up: bool


Message = Hello | Ask | Consent | Refusal | Load | Ready | Finish | Outcome | Attach
_DECODER: msgspec.json.Decoder[Message] = msgspec.json.Decoder(Message)


def encode(message: Message) -> bytes:
    """One line."""
    return msgspec.json.encode(message) + b"\n"


def decode(line: bytes) -> Message:
    """Read one line.

    Raises:
        ParseError: it is none of the messages.
    """
    if len(line) > LINE_BYTES_MOST:
        raise ParseError("stress control line", f"octet {LINE_BYTES_MOST}", "the end of the line")
    try:
        return _DECODER.decode(line)
    except (msgspec.DecodeError, msgspec.ValidationError, UnicodeDecodeError, RecursionError) as error:
        raise ParseError("stress control line", "the message", "a message of this protocol", str(error)) from error


class Line:
    """A TCP connection that carries messages. timeout_s is for a whole message, however slowly its octets come."""

    def __init__(self, sock: socket.socket, timeout_s: float) -> None:
        self.sock = sock
        self.timeout_s = timeout_s
        self._rest = b""

    def send(self, message: Message) -> None:
        """Write one message."""
        self.sock.settimeout(self.timeout_s)
        self.sock.sendall(encode(message))

    def receive(self) -> Message:
        """Read one message.

        Raises:
            ParseError: no message of this protocol, or a line that does not end.
            OSError: the connection broke or was silent for the time-out.
            EOFError: the other end closed it.
        """
        ends = time.monotonic() + self.timeout_s
        while b"\n" not in self._rest:
            self.sock.settimeout(max(0.001, ends - time.monotonic()))
            if len(self._rest) > LINE_BYTES_MOST:
                raise ParseError("stress control line", f"octet {LINE_BYTES_MOST}", "the end of the line")
            data = self.sock.recv(LINE_BYTES_MOST)
            if not data:
                raise EOFError("the other end closed the connection")
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return decode(line)

    def take_rest(self) -> bytes:
        """What came after the last line: the first octets of the data."""
        rest, self._rest = self._rest, b""
        return rest

    def close(self) -> None:
        """Close the connection."""
        self.sock.close()


def proof(token: bytes, side: str, own_nonce: str, other_nonce: str) -> str:
    """HMAC-SHA-256 by which `side` ("client" or "server") shows that it holds the token."""
    text = f"linkrover stress {PROTOCOL} {side} {own_nonce} {other_nonce}".encode()
    return hmac.new(token, text, hashlib.sha256).hexdigest()


def proves(mac: str, token: bytes, side: str, own_nonce: str, other_nonce: str) -> bool:
    """Whether mac is the proof of `side`."""
    return hmac.compare_digest(mac.encode("utf-8", "replace"), proof(token, side, own_nonce, other_nonce).encode())


def new_token() -> str:
    """A token for one run of a server."""
    return secrets.token_urlsafe(18)


def load_token(path: Path | str) -> bytes:
    """The consent token in a file, without surrounding white space.

    Raises:
        ConfigError: it cannot be read, or is too short to be a secret.
    """
    try:
        token = Path(path).read_bytes().strip()
    except OSError as error:
        raise ConfigError(f"cannot read the stress token file {path}: {error.strerror}") from error
    return check_token(token, f"in {path}")


def check_token(token: bytes, where: str = "given") -> bytes:
    """The token, if it is long enough.

    Raises:
        ConfigError: fewer than 16 octets.
    """
    if len(token) < TOKEN_BYTES_LEAST:
        raise ConfigError(
            f"the stress token {where} has {len(token)} octets, at least {TOKEN_BYTES_LEAST} are needed; make one "
            "with: openssl rand -hex 16"
        )
    return token
