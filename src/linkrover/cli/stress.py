"""`linkrover stress`: round trip and loss while the link is loaded."""

from __future__ import annotations

import json as json_module
import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from cyclopts import Parameter

from linkrover.errors import ConfigError
from linkrover.probe.address import load_key
from linkrover.stress import load
from linkrover.stress.client import PHASES, Phase, StressClient, StressReport
from linkrover.stress.protocol import DEFAULT_PORT, check_token, load_token

from . import _units

TOKEN_VARIABLE = "LINKROVER_STRESS_TOKEN"  # noqa: S105  # the name of a variable, not a secret


def stress(
    host: str,
    *,
    profile: Literal["camera", "lidar", "bulk", "tcp", "udp"] = "camera",
    rate: float | None = None,
    seconds: float = 10.0,
    phase: Annotated[list[Literal["idle", "up", "down", "both"]] | None, Parameter(negative=())] = None,
    token_file: Path | None = None,
    port: int = DEFAULT_PORT,
    probe_rate: float = 50.0,
    probe_port: int | None = None,
    key_file: Path | None = None,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Measure round trip and loss while the link is idle, loaded up (to HOST), down, and both ways.

    HOST must consent: there, run `linkrover reflect --allow-stress` (it prints
    a token) or an agent with --stress-token-file. Load goes to that end only,
    after both ends have proved that they hold the token. Give the token in the
    environment variable LINKROVER_STRESS_TOKEN or with --token-file.

    The robot's other traffic suffers while this runs: do not do it while the
    robot drives among people.

    LINKROVER_STRESS_TOKEN=... linkrover stress station --profile lidar

    linkrover stress station --token-file token --profile udp --rate 30

    Args:
        host: The consenting end: name or address.
        profile: camera: 30 images/s of 50 kB over TCP (12 Mbit/s). lidar: 10 scans/s of 300 kB over TCP (24 Mbit/s).
            bulk: one TCP connection as fast as it goes. tcp: four of them. udp: datagrams at a steady rate.
        rate: Mbit/s of camera, lidar or udp (default 12, 24, 10).
        seconds: Length of each phase.
        phase: Only these phases. May be given several times; the buffer delay needs idle among them.
        token_file: File with the consent token.
        port: TCP port of the consent server.
        probe_rate: Probes a second while measuring, 1 to 1000.
        probe_port: UDP port of the reflector, where the consenting end does not tell.
        key_file: Key of authenticated probes, where the reflector has one.
        json: Print one JSON object at the end and nothing else.
    """
    if not 1 <= seconds <= 600:
        raise ConfigError(f"--seconds {seconds:g}: must be from 1 to 600")
    if not 1 <= probe_rate <= 1000:
        raise ConfigError(f"--probe-rate {probe_rate:g}: must be from 1 to 1000")
    kind = load.profile(profile, None if rate is None else rate * 1e6)
    wanted = tuple(name for name in PHASES if name in phase) if phase else PHASES
    client = StressClient(
        host,
        _token(token_file),
        port,
        key=load_key(key_file) if key_file else None,
        probe_port=probe_port,
        probe_rate_hz=probe_rate,
    )
    try:
        client.connect()
        client.probe_port()
        assert client.hello is not None
        if not json:
            print(f"{host} ({client.address}, linkrover {client.hello.version}) consents; {kind.name}: {kind.about}")
        report = client.run(
            kind,
            seconds=seconds,
            phases=wanted,
            on_phase=lambda name: None if json else print(f"{name}: {seconds:g} s ...", flush=True),
            on_done=lambda done: None if json else print("\n".join(lines(done)), flush=True),
        )
    finally:
        client.close()
    if json:
        print(json_module.dumps(msgspec.to_builtins(report), indent=2))
    else:
        print(closing(report))
    if not any(done.probes.answered for done in report.phases):
        print("linkrover: no probe was answered: does a firewall pass the reflector's UDP port?", file=sys.stderr)
        return 1
    return 0


def _token(path: Path | None) -> bytes:
    if path is not None:
        return load_token(path)
    given = os.environ.get(TOKEN_VARIABLE)
    if not given:
        raise ConfigError(
            f"no consent token: start `linkrover reflect --allow-stress` at the other end and set {TOKEN_VARIABLE} to "
            "the token it prints, or give --token-file"
        )
    return check_token(given.strip().encode(), f"in {TOKEN_VARIABLE}")


def lines(done: Phase) -> list[str]:
    """One phase as text."""
    found = []
    if done.up_bps is not None:
        found.append(f"  up {_units.bit_rate(done.up_bps)}" + _datagrams(done.up_lost))
    if done.down_bps is not None:
        found.append(f"  down {_units.bit_rate(done.down_bps)}" + _datagrams(done.down_lost))
    if done.frames_sent is not None:
        found.append(f"  frames sent {done.frames_sent}, given up for newer ones {done.frames_dropped}")
    rtt, probes = done.probes.rtt, done.probes
    if rtt is None:
        found.append(f"  round trip: no answer to {probes.sent} probes")
    else:
        found.append(
            f"  round trip median {_units.duration(rtt.median_ns)}, p95 {_units.duration(rtt.p95_ns)}, p99 "
            f"{_units.duration(rtt.p99_ns)}, max {_units.duration(rtt.max_ns)}; probes without an answer in time "
            f"{_units.share(probes.loss)} of {probes.sent} (there {probes.lost_forward}, back {probes.lost_back})"
        )
    if done.buffer_delay is not None:
        found.append(f"  buffer delay {done.buffer_delay * 100:.0f} % of the idle round trip")
    found.extend(f"  load thread: {error}" for error in done.errors)
    return found


def closing(report: StressReport) -> str:
    """What the probes themselves cost."""
    return (
        f"probes: {report.probe_rate_hz:g} a second, {_units.bit_rate(report.probe_overhead_bps)} in each direction "
        "with IPv4 and UDP headers, not counted above"
    )


def _datagrams(lost: float | None) -> str:
    return "" if lost is None else f", datagrams lost {_units.share(lost)}"
