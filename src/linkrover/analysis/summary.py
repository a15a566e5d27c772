"""The figures of one run, by our method or by the paper's, in one shape."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import msgspec

from linkrover.errors import ConfigError

from .account import AccountFigures, account_figures
from .balance import BalanceFigures, balance_figures
from .channel import ChannelFigures, channel_figures
from .connections import ConnectionFigures, connection_figures
from .delay import (
    OUTAGE_THRESHOLD_S,
    DelayFigures,
    Outage,
    Probes,
    application_probes,
    delay_figures,
    find_probes,
    outage_window,
)
from .link import (
    CounterFigures,
    SignalFigures,
    SpreadFigures,
    ThroughputFigures,
    counter_figures,
    signal_figures,
    throughput_figures,
)
from .motion import MotionFigures, motion_figures, moving_window, position_at, still_window
from .neighbours import NeighbourhoodFigures, neighbourhoods
from .reasons import with_reasons
from .recovery import Recovery, recoveries
from .run import End, Run
from .stations import StationFigures, station_figures
from .topics import TopicFigures, topic_figures
from .window import Window

if TYPE_CHECKING:
    from linkrover.records import Manifest

SCHEMA_VERSION = 1
Method = Literal["linkrover", "pandey2022"]
METHODS: tuple[Method, ...] = ("linkrover", "pandey2022")
COUNTERS = (
    "tcp_bad_segments",
    "tcp_lost_retransmits",
    "tcp_timeouts",
    "udp_errors",
    "udp_buffer_errors",
    "mac_rx_dropped",
    "nic_tx_errors",
    "nic_rx_errors",
    "nic_tx_dropped",
    "nic_rx_dropped",
)


class InterfaceFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of one interface of one end. Counters are increases over the part of the run."""

    throughput_mbps: ThroughputFigures
    rssi_dbm: SignalFigures
    link_quality: SpreadFigures | None = None
    retransmits: float | None = None  # TCP, of the whole machine
    mac_retries: float | None = None
    counters: dict[str, float] = {}
    counter_resets: int = 0
    spread: dict[str, SpreadFigures] = {}  # per-row increments of the paper's method
    reason: str | None = None


class EndFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of one end."""

    interfaces: dict[str, InterfaceFigures] = {}
    primary: str | None = None  # the interface that carried the most
    reason: str | None = None


class PartFigures(msgspec.Struct, frozen=True, kw_only=True):
    """The same figures over a part of the run."""

    duration_s: float | None = None
    delay_ms: DelayFigures
    ends: dict[str, EndFigures]
    reason: str | None = None


class ClockFigures(msgspec.Struct, frozen=True, kw_only=True):
    """How both ends came onto one clock."""

    method: str
    offset_ms: float | None = None
    error_bound_ms: float | None = None
    reason: str | None = None


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """What the recording says of one end."""

    host: str | None = None
    kernel: str | None = None
    drivers: dict[str, str] = {}
    middleware: str | None = None
    linkrover_version: str | None = None
    emulated: bool = False
    imported_from: str | None = None


class RunSummary(msgspec.Struct, frozen=True, kw_only=True):
    """Everything about one run; the JSON of `linkrover report` is a list of these (docs/report-schema.md)."""

    schema_version: int = SCHEMA_VERSION
    method: str
    run: str
    case: str | None
    trial: int | None
    factors: dict[str, str] = {}
    duration_s: float
    delay_ms: DelayFigures
    ends: dict[str, EndFigures]
    static: PartFigures
    moving: PartFigures
    static_no_lead: PartFigures | None = None  # the paper's method only
    application_delay_ms: dict[str, DelayFigures] = {}
    outages: list[Outage] = []
    recoveries: list[Recovery] = []  # after each interruption: when radio, probe and application were back
    stations: list[StationFigures] = []  # each peer of a wireless interface apart
    channels: list[ChannelFigures] = []
    neighbourhoods: list[NeighbourhoodFigures] = []
    connections: list[ConnectionFigures] = []
    topics: list[TopicFigures] = []
    balance: dict[str, BalanceFigures] = {}
    account: dict[str, AccountFigures] = {}  # what measuring cost, by end
    outage_threshold_s: float | None = None
    motion: MotionFigures = MotionFigures()
    clock: ClockFigures
    setup: dict[str, Setup] = {}
    problems: tuple[str, ...] = ()
    repairs: tuple[str, ...] = ()
    reason: str | None = None


def summarise(run: Run, method: str = "linkrover", *, outage_threshold_s: float = OUTAGE_THRESHOLD_S) -> RunSummary:
    """All figures of one run. Pure. Raises ConfigError for an unknown method.

    `linkrover`: time-weighted over the samples really taken. `pandey2022`: the paper's own formulas, row by row.
    """
    if method == "pandey2022":
        from .pandey import summarise_pandey

        return with_reasons(summarise_pandey(run))
    if method != "linkrover":
        raise ConfigError(f"method '{method}' is unknown; there are: {', '.join(METHODS)}")
    return with_reasons(_summarise(run, outage_threshold_s))


def _summarise(run: Run, outage_threshold_s: float) -> RunSummary:
    probes = find_probes(run)
    out, still_out = outage_window(probes, run.span, outage_threshold_s)
    connected = run.span.without(out)
    still, rule = still_window(run)
    whole = _part(run, run.span, connected, probes, details=True)
    connections = connection_figures(run)
    topics = topic_figures(run, connections)
    return RunSummary(
        method="linkrover",
        run=run.name,
        case=run.case,
        trial=run.trial,
        factors=run.factors,
        duration_s=run.span.seconds,
        delay_ms=whole.delay_ms,
        ends=whole.ends,
        static=_sub(run, still, connected, probes, "the robot never stood still"),
        moving=_sub(run, moving_window(run, still) if still is not None else None, connected, probes, "it never moved"),
        application_delay_ms=_application(run),
        outages=_outages(run, out, still_out),
        recoveries=recoveries(run, probes, out),
        stations=station_figures(run),
        channels=channel_figures(run),
        neighbourhoods=neighbourhoods(run),
        connections=connections,
        topics=topics,
        balance=balance_figures(run, _primary_throughput(whole.ends), topics),
        account=account_figures(run),
        outage_threshold_s=outage_threshold_s,
        motion=motion_figures(run, still, rule),
        clock=clock_figures(run),
        setup=setups(run),
        problems=run.problems,
        repairs=run.repairs,
        reason=_identity_reason(run),
    )


def _primary_throughput(ends: dict[str, EndFigures]) -> dict[str, ThroughputFigures]:
    return {
        role: end.interfaces[end.primary].throughput_mbps for role, end in ends.items() if end.primary in end.interfaces
    }


def _identity_reason(run: Run) -> str | None:
    missing = [name for name, value in (("case", run.case), ("trial", run.trial)) if value is None]
    return f"{', '.join(missing)}: not stated in the recording (give --case, --trial)" if missing else None


def clock_figures(run: Run) -> ClockFigures:
    """The join of the clocks, for the reader."""
    clock = run.clock
    return ClockFigures(
        method=clock.method,
        offset_ms=None if clock.offset_ns is None else clock.offset_ns / 1e6,
        error_bound_ms=None if clock.error_bound_ns is None else clock.error_bound_ns / 1e6,
    )


def setups(run: Run) -> dict[str, Setup]:
    """The manifests, shortened."""
    return {role: _setup(end.manifest) for role, end in run.ends.items() if end.manifest is not None}


def _setup(manifest: Manifest) -> Setup:
    return Setup(
        host=manifest.host,
        kernel=manifest.kernel,
        drivers={i.name: i.driver for i in manifest.interfaces if i.driver},
        middleware=manifest.middleware,
        linkrover_version=manifest.linkrover_version,
        emulated=manifest.emulated,
        imported_from=manifest.imported_from,
    )


def _sub(run: Run, window: Window | None, connected: Window, probes: Probes | None, empty: str) -> PartFigures:
    if window is None:
        reason = "no odometry was recorded"
        return PartFigures(delay_ms=DelayFigures(reason=reason), ends={}, reason=reason)
    if window.seconds <= 0:
        return PartFigures(duration_s=0.0, delay_ms=DelayFigures(reason=empty), ends={}, reason=empty)
    return _part(run, window, connected, probes, details=False)


def _part(run: Run, window: Window, connected: Window, probes: Probes | None, *, details: bool) -> PartFigures:
    return PartFigures(
        duration_s=window.seconds,
        delay_ms=delay_figures(probes, window, run, details=details),
        ends={role: _end(run, end, _own(end, window, details), connected) for role, end in run.ends.items()},
    )


def _own(end: End, window: Window, whole: bool) -> Window:
    """An end whose recording does not overlap the run's span is summed up over its own time."""
    if not whole or end.role == "robot" or end.alive is None or not len(end.alive.ends):
        return window
    begin, stop = float(end.alive.begins[0]), float(end.alive.ends[-1])
    if stop <= float(window.begins[0]) or begin >= float(window.ends[-1]):
        return Window.of(begin, stop)
    return window


def _end(run: Run, end: End, window: Window, connected: Window) -> EndFigures:
    if not end.interfaces:
        return EndFigures(reason="no interface was recorded at this end")
    up = connected if window.intersect(run.span).seconds > 0 else window
    return EndFigures(
        interfaces={iface: _interface(run, end, iface, window, up) for iface in end.interfaces},
        primary=end.primary,
    )


def _interface(run: Run, end: End, iface: str, window: Window, connected: Window) -> InterfaceFigures:
    wireless = end.wireless.get(iface)
    errors = end.errors.get(iface)
    # TCP counters are the whole machine's: any interface's sample of them will do
    machine = errors if errors is not None else next(iter(end.errors.values()), None)
    retransmits = counter_figures(machine, "tcp_retransmits", window)
    retries = counter_figures(errors, "mac_tx_retries", window)
    others = {name: counter_figures(errors, name, window) for name in COUNTERS if errors is not None and name in errors}
    named = (("tcp_retransmits", "retransmits", retransmits), ("mac_tx_retries", "mac_retries", retries))
    reasons = [c.reason.replace(raw, name, 1) for raw, name, c in named if c.reason]
    return InterfaceFigures(
        throughput_mbps=throughput_figures(end.utilization.get(iface), window, connected),
        rssi_dbm=signal_figures(end, wireless, window, run.published_2021),
        retransmits=retransmits.increase,
        mac_retries=retries.increase,
        counters={name: c.increase for name, c in others.items() if c.increase is not None},
        counter_resets=sum(c.resets for c in (retransmits, retries, *others.values())),
        reason="; ".join(reasons) or None,
    )


def _application(run: Run) -> dict[str, DelayFigures]:
    """Round trips of the application beside the probe's, by method; the difference is the middleware's share."""
    out: dict[str, DelayFigures] = {}
    for end in run.ends.values():
        for method in end.delays:
            probes = application_probes(end, method, run.published_2021)
            out.setdefault(method, delay_figures(probes, run.span, run, details=False))
    return out


def _outages(run: Run, out: Window, still_out: bool) -> list[Outage]:
    import numpy as np

    if not len(out.begins):
        return []
    x, y = position_at(run, out.begins)
    pose = run.pose
    x0, y0 = (float(pose["x_m"][0]), float(pose["y_m"][0])) if pose is not None else (np.nan, np.nan)
    rssi = _last_reading(run, out.begins)

    def known(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    return [
        Outage(
            start_s=float(a),
            end_s=float(b),
            duration_s=float(b - a),
            ended=not (still_out and i == len(out.begins) - 1),
            x_m=known(x[i]),
            y_m=known(y[i]),
            distance_m=known(float(np.hypot(x[i] - x0, y[i] - y0))),
            rssi_dbm=known(rssi[i]),
        )
        for i, (a, b) in enumerate(zip(out.begins, out.ends, strict=True))
    ]


def _last_reading(run: Run, times: object) -> list[float]:
    """The last signal reading of either end before each time."""
    import numpy as np

    for role in ("robot", "station"):
        end = run.ends.get(role)
        iface = end.primary if end is not None else None
        table = end.wireless.get(iface) if end is not None and iface is not None else None
        if table is None or not np.isfinite(table["rssi_dbm"]).any():
            continue
        known = np.isfinite(table["rssi_dbm"])
        t, rssi = table["t_s"][known], table["rssi_dbm"][known]
        at = np.searchsorted(t, np.asarray(times), side="right") - 1
        return [float(rssi[i]) if i >= 0 else float("nan") for i in at]
    return [float("nan")] * len(np.asarray(times))


__all__ = ["METHODS", "CounterFigures", "RunSummary", "summarise"]
