"""`linkrover reflect`: the ping-only station."""

from __future__ import annotations

import json as json_module
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
from cyclopts import Parameter

from linkrover.errors import ConfigError
from linkrover.loop import Loop
from linkrover.probe.address import load_key
from linkrover.probe.limits import SessionKey
from linkrover.probe.packet import DEFAULT_PORT
from linkrover.probe.reflector import ReflectorCounters, StampReflector

from . import _units

if TYPE_CHECKING:
    from linkrover.stress.server import StressServer

REPORT_NS = 10_000_000_000


def reflect(
    *,
    bind: str = "",
    port: int = DEFAULT_PORT,
    key_file: Path | None = None,
    allow_stress: Annotated[bool, Parameter(negative=())] = False,
    stress_token_file: Path | None = None,
    stress_port: int | None = None,
    duration: float | None = None,
    json: Annotated[bool, Parameter(negative=())] = False,
    quiet: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Answer probes: a stateful STAMP reflector (RFC 8762), also for TWAMP-Light senders.

    The ping-only station: nothing is recorded here. It answers well-formed test
    packets, never with more octets than came and not without limit to one
    source. Runs until Ctrl-C.

    Args:
        bind: Address to listen on; all addresses, IPv4 and IPv6, by default.
        port: UDP port. STAMP's own port 862 needs root; use it where the sender cannot be told another.
        key_file: File with the shared key (make one with `openssl rand -hex 32`): only packets authenticated with it
            are answered.
        allow_stress: Also let `linkrover stress` load the link to here, for whoever holds the token that is printed.
        stress_token_file: File with the token to use instead of a new one; implies --allow-stress.
        stress_port: TCP port of the stress consent server, 8621 by default.
        duration: Stop after this many seconds.
        json: Print the counters as one JSON object at the end and nothing else.
        quiet: Print nothing but errors.
    """
    if not 0 <= port <= 65_535:
        raise ConfigError(f"--port {port}: must be from 1 to 65535, or 0 for any free one")
    if duration is not None and duration <= 0:
        raise ConfigError(f"--duration {duration:g}: must be above 0 s")
    loop = Loop()
    talks = not (quiet or json)

    def announce(session: SessionKey) -> None:
        if talks:
            print(f"session of {session[0]} port {session[1]}, identifier {session[2]}", flush=True)

    key = load_key(key_file) if key_file else None
    reflector = StampReflector(loop, bind, port, key=key, on_session=announce)
    reflector.start()
    stress = (
        _stress_server(stress_token_file, bind, stress_port, reflector.port, talks=talks)
        if allow_stress or stress_token_file is not None
        else None
    )
    shown = ReflectorCounters()

    def report() -> None:
        nonlocal shown
        if talks and reflector.counters != shown:
            shown = msgspec.structs.replace(reflector.counters)
            print(describe(shown), flush=True)

    restore = _units.on_interrupt(loop.stop)
    try:
        if talks:
            mode = "authenticated probes only" if key else "unauthenticated"
            print(f"answering on {', '.join(reflector.addresses)} ({mode}); end with Ctrl-C", flush=True)
        loop.every(REPORT_NS, lambda _slot: report(), start_ns=time.monotonic_ns() + REPORT_NS)
        loop.run(None if duration is None else time.monotonic_ns() + round(duration * 1e9))
        report()
    finally:
        if stress is not None:
            stress.stop()
        reflector.stop()
        loop.close()
        restore()
    if json:
        print(json_module.dumps(msgspec.to_builtins(reflector.counters), indent=2))
    return 0


def _stress_server(
    token_file: Path | None, bind: str, port: int | None, reflector_port: int, *, talks: bool
) -> StressServer:
    from linkrover.stress.protocol import DEFAULT_PORT as STRESS_PORT
    from linkrover.stress.protocol import load_token, new_token
    from linkrover.stress.server import StressServer

    token = load_token(token_file) if token_file is not None else new_token().encode()
    server = StressServer(
        token,
        bind,
        STRESS_PORT if port is None else port,
        reflector_port=reflector_port,
        on_event=(lambda text: print(text, flush=True)) if talks else None,
    )
    server.start()
    if token_file is None:
        # also with --quiet and --json: without it nobody could use what was asked for
        print(f"stress allowed on TCP port {server.port}; token: {token.decode()}", file=sys.stderr, flush=True)
    elif talks:
        print(f"stress allowed on TCP port {server.port} with the token in {token_file}", flush=True)
    return server


def describe(counters: ReflectorCounters) -> str:
    """The counters that are not zero, in one line."""
    names = {"received": "received", "answered": "answered", "malformed": "malformed", "unauthenticated": "wrong HMAC"}
    names |= {"rate_limited": "over the rate limit", "replayed": "replayed", "send_failed": "answers not sent"}
    values = [(label, getattr(counters, name)) for name, label in names.items()]
    return ", ".join(f"{label} {value}" for label, value in values if value) or "nothing received"
