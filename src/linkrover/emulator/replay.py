"""A recorded drive played back as a link: its RSSI, its throughput and its outages become the emulated radio's.

What a recording cannot tell is decided so: throughput is taken as what the link could carry (where the robot's
programs wanted less, the replayed link is worse than the real one was); a stretch without an answered probe longer
than a second is an outage; noise is set so low that the recorded throughput, not the modulation, is the limit.
"""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

import msgspec

from linkrover.errors import LinkRoverError
from linkrover.records import LinkUtilization, NetworkDelay, Now, Pose, ProbeResult, ProbeState, Record, WirelessLink

from .association import AssociationConfig
from .channel import ChannelConfig
from .medium import Medium
from .medium_config import MediumConfig
from .presets import Case

STEP_S = 0.1
OUTAGE_S = 1.0
LEAST_BPS = 250_000.0
"""A link that carried nothing in a second can still carry this, outages apart: it had nothing to carry."""
BLACKOUT_DBM = -120.0
UNKNOWN_DBM = -60.0

CASE = Case(
    name="replay",
    access_point="station",
    adapter="recorded",
    channel=ChannelConfig(),
    medium=MediumConfig(
        band_ghz=5.0,
        width_mhz=80,
        max_mcs=9,
        noise_dbm=-115.0,
        association=AssociationConfig(missed_beacons=3, scan_ns=100_000_000, pause_ns=0, join_ns=20_000_000),
    ),
    places={"station": (0.0, 0.0)},
)


class Timeline(msgspec.Struct, frozen=True, kw_only=True):
    """The drive in steps of STEP_S. rssi_dbm by end; None = none known. rate_bps: what the link carried, both ways."""

    source: str
    robot_dbm: tuple[float | None, ...]
    station_dbm: tuple[float | None, ...]
    rate_bps: tuple[float, ...]
    outage: tuple[bool, ...]
    place_m: tuple[tuple[float, float] | None, ...]

    @property
    def duration_s(self) -> float:
        """How long the drive lasted."""
        return len(self.rate_bps) * STEP_S


def build(source: str, ends: Mapping[str, Sequence[Record]]) -> Timeline:
    """From the recordings of a run, by end.

    Raises:
        LinkRoverError: they hold neither RSSI nor throughput.
    """
    everything = [record for records in ends.values() for record in records]
    moving = [r for r in everything if isinstance(r, (WirelessLink, LinkUtilization))]
    if not moving:
        raise LinkRoverError(f"{source}: no RSSI and no throughput in it; a replay needs one of them")
    begin, end = min(r.wall_ns for r in moving), max(r.wall_ns for r in moving)
    times = [begin + int(step * STEP_S * 1e9) for step in range(max(1, int((end - begin) / 1e9 / STEP_S)))]
    levels = {
        name: _held(times, [(r.wall_ns, r.rssi_dbm) for r in _one_iface(records)], 3.0)
        for name, records in ends.items()
    }
    robot, station = levels.get("robot"), levels.get("station")
    # an access point may show no level: the way back is as strong to within a few dB
    robot = station if robot is None or all(x is None for x in robot) else robot
    station = robot if station is None or all(x is None for x in station) else station
    rates = [_rates(times, records) for records in ends.values()]
    return Timeline(
        source=source,
        robot_dbm=tuple(robot or [None] * len(times)),
        station_dbm=tuple(station or [None] * len(times)),
        rate_bps=tuple(max(LEAST_BPS, *values) for values in zip(*rates, strict=True)),
        outage=tuple(_outages(times, everything)),
        place_m=tuple(
            _held(times, [(r.wall_ns, (r.x_m, r.y_m)) for r in ends.get("robot", ()) if isinstance(r, Pose)], 5.0)
        ),
    )


def _one_iface(records: Iterable[Record]) -> list[WirelessLink]:
    links = [r for r in records if isinstance(r, WirelessLink)]
    names = [r.iface for r in links if r.rssi_dbm is not None]
    return [r for r in links if names and r.iface == names[0]]


def _held(times: list[int], samples: list[tuple[int, object]], hold_s: float) -> list:  # type: ignore[type-arg]
    """The last known value at each time, None when it is older than hold_s."""
    samples = sorted((sample for sample in samples if sample[1] is not None), key=lambda sample: sample[0])
    at = [sample[0] for sample in samples]
    out = []
    for now_ns in times:
        index = bisect_right(at, now_ns) - 1
        fresh = index >= 0 and now_ns - at[index] <= hold_s * 1e9
        out.append(samples[index][1] if fresh else None)
    return out


def _rates(times: list[int], records: Iterable[Record]) -> list[float]:
    totals: dict[str, list[tuple[int, float]]] = {}
    for r in records:
        if isinstance(r, LinkUtilization) and r.rx_rate_bps is not None and r.tx_rate_bps is not None:
            totals.setdefault(r.iface, []).append((r.wall_ns, r.rx_rate_bps + r.tx_rate_bps))
    if not totals:
        return [0.0] * len(times)
    # with several interfaces: the one that carried the traffic
    samples = sorted(max(totals.values(), key=lambda found: sum(rate for _, rate in found)))
    at = [wall_ns for wall_ns, _ in samples]
    # a sample's rate is of the interval that ends with it
    return [samples[min(bisect_right(at, now_ns), len(samples) - 1)][1] for now_ns in times]


def _outages(times: list[int], records: Iterable[Record]) -> list[bool]:
    """Whether each time lies in a stretch without an answer longer than OUTAGE_S in which one was asked for in vain."""
    answered: list[int] = []
    vain: list[int] = []
    for r in records:
        if isinstance(r, ProbeResult) and r.state is not ProbeState.NOT_SENT:
            (answered if r.state is ProbeState.ANSWERED else vain).append(r.wall_ns)
        elif isinstance(r, NetworkDelay):
            (answered if r.alive and r.delay_ns is not None else vain).append(r.wall_ns)
    if not vain:
        return [False] * len(times)
    answered.sort()
    vain.sort()
    out = []
    for now_ns in times:
        index = bisect_right(answered, now_ns)
        before = answered[index - 1] if index else vain[0] - 1
        after = answered[index] if index < len(answered) else vain[-1] + 1
        asked = bisect_right(vain, after) - bisect_right(vain, before)
        out.append(before <= now_ns <= after and after - before > OUTAGE_S * 1e9 and asked > 0)
    return out


class Faces(Protocol):
    """The drivers' texts."""

    def write(self, medium: Medium) -> None:
        """Show the medium's signals."""
        ...


class ReplayLink:
    """Moves the medium along a timeline; after its end the link stays as it was last."""

    def __init__(self, timeline: Timeline, faces: Faces) -> None:
        self.timeline = timeline
        self._faces = faces
        self._start_ns = time.monotonic_ns()
        self._last = {"robot": UNKNOWN_DBM, "station": UNKNOWN_DBM}

    def tick(self, medium: Medium, at: Now) -> None:
        """Signals, limits and outage as of now."""
        line = self.timeline
        step = min(int((at.mono_ns - self._start_ns) / 1e9 / STEP_S), len(line.rate_bps) - 1)
        place = line.place_m[step]
        distance = 0.0 if place is None else (place[0] ** 2 + place[1] ** 2) ** 0.5
        for end, other, known in (("robot", "station", line.robot_dbm), ("station", "robot", line.station_dbm)):
            level = known[step]
            if level is not None:
                self._last[end] = level
            shown = BLACKOUT_DBM if line.outage[step] else self._last[end]
            medium.set_link(other, end, rssi_dbm=shown, distance_m=distance)
            medium.limit(end, line.rate_bps[step])
        self._faces.write(medium)
