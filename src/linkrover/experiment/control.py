"""The control port of an agent in a real campaign: who holds the key may check this end, and start and stop recordings.

One request a TCP connection, one JSON object a line. Each side sends a nonce; request and answer carry an HMAC-SHA-256
over both nonces and their text, so that they can neither be forged nor replayed. What can be asked is what stands
below: nothing of it reaches a shell, and a run's name can only be a folder below the agent's own.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
import socket
import time
from pathlib import Path

import msgspec

from linkrover.errors import ConfigError, LinkRoverError, ParseError

DEFAULT_PORT = 8622
REQUEST_MOST = 16_384
ANSWER_MOST = 2_000_000
KEY_LEAST = 16
CHUNK_OCTETS = 524_288
RUN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}(/[A-Za-z0-9][A-Za-z0-9._-]{0,63}){0,3}")


class ControlError(LinkRoverError):
    """The other end cannot be reached, does not hold the key, or refused."""


class UnreachableError(ControlError):
    """Nothing answers there, now."""


class ExistsError(ControlError):
    """That run is recorded there already."""


class Check(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """How are things there? probe: also probe that reflector (HOST:PORT) for two seconds."""

    interfaces: tuple[str, ...] = ()
    probe: str | None = None
    reflect: bool = False  # answer probes until the next Start or Stop


class Start(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Begin a recording: `run` is a folder below the agent's own."""

    run: str
    case: str
    trial: int
    interfaces: tuple[str, ...]
    peer: str | None = None
    reflect: bool = False
    duration_s: float | None = None


class Stop(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """End the recording and read it through."""


class Fetch(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """A piece of a file of a finished recording."""

    run: str
    file: str
    offset: int


class Status(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Answer to Check. interfaces: by name, "up", "down" or "absent"."""

    role: str
    host: str
    version: str
    wall_ns: int
    interfaces: dict[str, str] = {}
    free_bytes: int = 0
    recording: str | None = None
    probes_sent: int | None = None
    probes_answered: int | None = None
    probe_problem: str = ""


class Started(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Answer to Start."""

    directory: str


class Stopped(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Answer to Stop. files: name and octets. topics: messages by topic."""

    run: str
    directory: str
    problems: tuple[str, ...]
    seconds: float
    topics: dict[str, int]
    files: dict[str, int]


class Chunk(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """Answer to Fetch."""

    data: bytes
    total: int


class Refusal(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """The answer is no, with the reason in words. exists: because that run is recorded there already."""

    reason: str
    exists: bool = False


Request = Check | Start | Stop | Fetch
Answer = Status | Started | Stopped | Chunk | Refusal


class Hello(msgspec.Struct, frozen=True, kw_only=True):
    """First line of the serving side."""

    linkrover: str
    nonce: str


class Sealed(msgspec.Struct, frozen=True, kw_only=True):
    """A request or an answer with its proof; nonce: the asking side's."""

    nonce: str
    text: str
    mac: str


def load_key(path: Path | str) -> bytes:
    """The shared key in a file, without surrounding white space.

    Raises:
        ConfigError: it cannot be read, or is too short to be a secret.
    """
    try:
        key = Path(path).read_bytes().strip()
    except OSError as error:
        raise ConfigError(f"cannot read the campaign's key file {path}: {error.strerror}") from error
    if len(key) < KEY_LEAST:
        raise ConfigError(
            f"the campaign's key in {path} has {len(key)} octets, at least {KEY_LEAST} are needed; make one with: "
            f"openssl rand -hex 16 > {path}"
        )
    return key


def seal(key: bytes, side: str, theirs: str, ours: str, message: Request | Answer) -> bytes:
    """One line. side: "ask" or "answer"; the nonces in the order serving, asking."""
    text = msgspec.json.encode(message).decode()
    return msgspec.json.encode(Sealed(nonce=ours, text=text, mac=_mac(key, side, theirs, ours, text))) + b"\n"


def unseal(line: bytes, key: bytes, side: str, serving_nonce: str, kind: type) -> tuple[str, Request | Answer]:
    """The asking side's nonce and the message.

    Raises:
        ParseError: no such line, or a wrong proof.
    """
    try:
        sealed = msgspec.json.decode(line, type=Sealed)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ParseError("control line", "the line", "a sealed message", str(error)) from error
    expected = _mac(key, side, serving_nonce, sealed.nonce, sealed.text)
    if not hmac.compare_digest(expected.encode(), sealed.mac.encode("utf-8", "replace")):
        raise ParseError("control line", "the proof", "one made with the campaign's key")
    try:
        message: Request | Answer = msgspec.json.decode(sealed.text, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ParseError("control line", "the message", "a message of this protocol", str(error)) from error
    return sealed.nonce, message


def _mac(key: bytes, side: str, serving_nonce: str, asking_nonce: str, text: str) -> str:
    data = "\n".join(("linkrover control 1", side, serving_nonce, asking_nonce, text)).encode("utf-8", "replace")
    return hmac.new(key, data, hashlib.sha256).hexdigest()


def read_line(handle: socket.socket, most: int, timeout_s: float) -> bytes:
    """One line within the time-out, however slowly its octets come.

    Raises:
        ParseError: longer than `most`.
        OSError: time-out or broken connection.
        EOFError: closed before the line ended.
    """
    ends = time.monotonic() + timeout_s
    data = bytearray()
    while not data.endswith(b"\n"):
        handle.settimeout(max(0.001, ends - time.monotonic()))
        piece = handle.recv(65_536)
        if not piece:
            raise EOFError("closed")
        data += piece
        if len(data) > most:
            raise ParseError("control line", f"octet {most}", "the end of the line")
    return bytes(data)


def ask(host: str, port: int, key: bytes, request: Request, timeout_s: float = 30.0) -> Answer:
    """Put one request to an agent's control port.

    Raises:
        UnreachableError: no answer in time.
        ControlError: not the same key, or refused (with the agent's reason; ExistsError: recorded already).
    """
    where = f"{host}:{port}"
    try:
        with socket.create_connection((host, port), timeout=min(5.0, timeout_s)) as handle:
            hello = msgspec.json.decode(read_line(handle, REQUEST_MOST, 5.0), type=Hello)
            nonce = secrets.token_hex(16)
            handle.sendall(seal(key, "ask", hello.nonce, nonce, request))
            line = read_line(handle, ANSWER_MOST, timeout_s)
            echoed, answer = unseal(line, key, "answer", hello.nonce, Answer)  # type: ignore[arg-type]
    except (OSError, EOFError, msgspec.DecodeError) as error:
        raise UnreachableError(
            f"no agent's control port answers at {where} ({error}); start one there: "
            "linkrover agent --control KEY_FILE --interface IFACE --role ROLE --record DIR"
        ) from error
    except ParseError as error:
        raise ControlError(f"{where} did not prove that it holds the campaign's key: {error}") from error
    if echoed != nonce:
        raise ControlError(f"{where} answered somebody else's request")
    if isinstance(answer, Refusal):
        raise (ExistsError if answer.exists else ControlError)(f"{where}: {answer.reason}")
    assert not isinstance(answer, Check | Start | Stop | Fetch)
    return answer
