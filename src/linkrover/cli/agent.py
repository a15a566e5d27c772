"""`linkrover agent`: measure at this end."""

from __future__ import annotations

import logging
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from types import FrameType

    from linkrover.agent import Agent, AgentConfig
    from linkrover.bag.recorder import Recorder
    from linkrover.live.output import Output
    from linkrover.records import LinkEvent

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130
_DRAW_HZ = 1.0  # a frame costs about 2.5 ms of CPU


def agent(
    *,
    interface: Annotated[list[str] | None, Parameter(name=["--interface", "-i"], negative=())] = None,
    role: Literal["robot", "station"] | None = None,
    peer: Annotated[list[str] | None, Parameter(negative=())] = None,
    reflect: Annotated[bool, Parameter(negative=())] = False,
    record: Path | None = None,
    config: Path | None = None,
    duration: float | None = None,
    feed: Path | None = None,
    wait: Annotated[bool, Parameter(negative=())] = False,
    wireless_path: Path | None = None,
    wireless_rate: float | None = None,
    utilization_rate: float | None = None,
    errors_rate: float | None = None,
    tcp_rate: float | None = None,
    scan_period: float | None = None,
    scan_mhz: Annotated[list[int] | None, Parameter(negative=())] = None,
    probe_rate: float | None = None,
    port: int | None = None,
    key_file: Path | None = None,
    stress_token_file: Path | None = None,
    control: Path | None = None,
    control_port: int | None = None,
    case: str | None = None,
    trial: int | None = None,
    run: str | None = None,
    emulated: Annotated[bool, Parameter(negative=(), show=False)] = False,
    json: Annotated[bool, Parameter(negative=())] = False,
    plain: Annotated[bool, Parameter(negative=())] = False,
    metrics: str | None = None,
) -> int:
    """Measure at this end of the link: signal, traffic, errors, and the delay to the peer. Records it if asked.

    Run one at the robot and one at the station. The robot probes the station, which reflects:

    station$ linkrover agent -i eth0 --role station --reflect --record runs/001

    robot$ linkrover agent --interface wlan0 --peer STATION --record runs/001

    Ctrl-C or SIGTERM ends it and finishes the recording; a lost terminal does not end one that records. Exit status
    0; 130 when Ctrl-C cut --duration short; 1 when records could not be written.

    Parameters
    ----------
    interface
        Network device to measure, by its exact name. May be given several times.
    role
        Which end this is. [default: robot]
    peer
        HOST or HOST:PORT of the other end's reflector, probed 10 times a second. May be given several times.
    reflect
        Answer the other end's probes.
    record
        Directory of the run; this end's recording goes to DIR/robot or DIR/station and is never overwritten.
    config
        TOML file with any of these settings and more (docs/agent.md); options given here come first.
    duration
        Stop after this many seconds.
    feed
        Path of a Unix datagram socket on which the robot's own software hands in pose, velocity commands and events.
    wait
        Start although an interface is not there yet.
    wireless_path
        Read this file in the format of /proc/net/wireless instead of asking the kernel (an emulated radio).
    wireless_rate
        Samples of the wireless link per second; 0 = off. [default: 10]
    utilization_rate
        Samples of traffic per second; 0 = off. [default: 1]
    errors_rate
        Samples of the error counters per second; 0 = off. [default: 1]
    tcp_rate
        Samples of each TCP connection over the interface per second; 0 = off. [default: 1]
    scan_period
        Scan for other access points every so many seconds, at least 5; 0 = never. A scan leaves the channel and so
        disturbs the link; it needs CAP_NET_ADMIN and is recorded. [default: 0]
    scan_mhz
        Scan only this channel, by its frequency; may be given several times. All channels take seconds, under traffic
        much longer. [default: all]
    probe_rate
        Probes per second to each peer, 1 to 1000; 0 = off. [default: 10]
    port
        UDP port on which --reflect listens, 8620 by default.
    key_file
        File with the shared key of authenticated probes (RFC 8762), at both ends.
    stress_token_file
        Let `linkrover stress` load the link to here, for whoever holds the token in this file (docs/stress.md).
    control
        File with a campaign's key: do not measure now, but let `linkrover experiment run`, which holds the same key,
        check this end and start and stop recordings below --record DIR (docs/experiment.md).
    control_port
        TCP port of --control. [default: 8622]
    case
        Name of the set-up under test, for the recording.
    trial
        Number of the trial, for the recording.
    run
        Name of the run, for the recording.
    emulated
        The link is an emulated one (set by linkrover demo).
    json
        Print every record as a line of JSON instead of the view.
    plain
        Log lines even on a terminal.
    metrics
        Answer Prometheus on this PORT of loopback, or on HOST:PORT; needs the "live" extra.
    """
    from linkrover.agent import Agent

    settings = _merged(
        config,
        {
            "interfaces": interface,
            "role": role,
            "peers": peer,
            "reflect": reflect or None,
            "record": record,
            "duration_s": duration,
            "feed": feed,
            "wait": wait or None,
            "wireless_path": wireless_path,
            "scan_period_s": scan_period,
            "scan_mhz": scan_mhz,
            "case": case,
            "trial": trial,
            "run": run,
            "emulated": emulated or None,
        },
        {
            "rates": {
                "wireless_hz": wireless_rate,
                "utilization_hz": utilization_rate,
                "errors_hz": errors_rate,
                "tcp_hz": tcp_rate,
            },
            "probe": {"rate_hz": probe_rate, "key_file": key_file},
            "reflector": {"port": port},
            "stress": {"token_file": stress_token_file},
        },
    )
    if control is not None:
        from linkrover.experiment.control import DEFAULT_PORT, load_key
        from linkrover.experiment.control_server import serve

        return serve(settings, load_key(control), DEFAULT_PORT if control_port is None else control_port)
    measuring = Agent(settings)
    if metrics is not None:
        from linkrover.live.metrics import Metrics, parse_address

        host, at = parse_address(metrics)
        measuring.add_sink(Metrics(at, host, role=settings.role.value))
    return _run(measuring, settings, json=json, plain=plain)


def _merged(path: Path | None, top: dict[str, Any], tables: dict[str, dict[str, Any]]) -> AgentConfig:
    """The file's settings with the options given on top."""
    import msgspec

    from linkrover.agent import AgentConfig, load_config
    from linkrover.agent.config import check
    from linkrover.records import Role

    settings = AgentConfig() if path is None else load_config(path)
    changes: dict[str, Any] = {}
    for key, value in top.items():
        if value is not None:
            changes[key] = tuple(value) if isinstance(value, list) else str(value) if isinstance(value, Path) else value
    if "role" in changes:
        changes["role"] = Role(changes["role"])
    for name, table in tables.items():
        given = {k: str(v) if isinstance(v, Path) else v for k, v in table.items() if v is not None}
        if given:
            changes[name] = msgspec.structs.replace(getattr(settings, name), **given)
    return check(msgspec.structs.replace(settings, **changes), "options" if path is None else str(path))


def _run(measuring: Agent, settings: AgentConfig, *, json: bool, plain: bool) -> int:
    from linkrover.live.output import Output

    terminal, recording = sys.stdout.isatty(), settings.record is not None
    # A terminal may be lost because the link under test is away (ssh): a recording must not end with it.
    outlives = terminal and recording
    out = Output(sys.stdout.fileno(), on_broken=None if outlives else measuring.request_stop)
    errors = out if not json else Output(sys.stderr.fileno())
    view_on = not json and not plain and terminal and os.environ.get("TERM", "dumb") != "dumb"
    handler = _OutputHandler(errors)
    logging.getLogger("linkrover").addHandler(handler)
    interrupted = _Interrupted(measuring, hangup_ends=not recording)
    recorder: Recorder | None = None
    try:
        # first what may be refused, so that no empty recording is left behind
        measuring.open()
        if recording:
            recorder = _record_to(measuring, Path(settings.record or "") / settings.role.value)
            if not view_on:
                errors.write(f"recording to {recorder.directory} (process {os.getpid()})\n")
        measuring.start()
        if json:
            _add_json(measuring, out)
        elif view_on:
            handler.held = []
            _add_view(measuring, out, None if recorder is None else recorder.directory)
        else:
            _add_log(measuring, out, settings.log_period_s)
        measuring.run()
    finally:
        measuring.close()
        logging.getLogger("linkrover").removeHandler(handler)
        for line in handler.held or ():
            errors.write(line)
        if out.dropped:
            errors.write(f"linkrover: {out.dropped} lines were not shown: whoever reads them was too slow\n")
        if recorder is not None:
            errors.write(_recorded(recorder))
        for output in {out, errors}:
            output.close()
        interrupted.restore()
    if recorder is not None and (recorder.problem is not None or recorder.records_lost):
        return EXIT_FAILED
    return EXIT_INTERRUPTED if interrupted.by_keyboard and settings.duration_s is not None else 0


def _record_to(measuring: Agent, directory: Path) -> Recorder:
    from linkrover.bag.recorder import Recorder
    from linkrover.errors import LinkRoverError

    def tell(event: LinkEvent) -> None:
        measuring.log.warning("%s", event.detail)
        measuring.publish_from(recorder, event)

    try:
        recorder = Recorder(directory, measuring.manifest, on_event=tell)
    except OSError as error:
        raise LinkRoverError(f"cannot record to {directory}: {error.strerror or error}") from error
    measuring.add_sink(recorder)
    return recorder


def _recorded(recorder: Recorder) -> str:
    """The last word on the recording."""
    text = f"recorded {recorder.records_written} records in {recorder.directory}\n"
    if recorder.records_lost:
        text += f"linkrover: {recorder.records_lost} records could not be written\n"
    if recorder.problem is not None:
        text += f"linkrover: {recorder.problem}\n"
    return text


def _add_json(measuring: Agent, out: Output) -> None:
    from linkrover.live.jsonl import JsonLines

    sink = JsonLines(out)
    sink.take(measuring.manifest)
    measuring.add_sink(sink)


def _add_log(measuring: Agent, out: Output, period_s: float) -> None:
    from linkrover.live.log import LogView

    measuring.add_sink(LogView(out, period_s=period_s))


def _add_view(measuring: Agent, out: Output, directory: Path | None) -> None:
    from linkrover.live.terminal import TerminalView

    recording = None if directory is None else str(directory)
    view = TerminalView(out, sys.stdout.fileno(), measuring.manifest, recording=recording)
    measuring.add_sink(view)
    measuring.every(_DRAW_HZ, view.draw, name="view")


class _Interrupted:
    """SIGINT and SIGTERM ask the agent to stop; a second one does not wait for the probes in flight.

    SIGHUP (the terminal is gone) does so too, unless a recording is to outlive it.
    """

    def __init__(self, measuring: Agent, *, hangup_ends: bool) -> None:
        self.by_keyboard = False
        self._measuring = measuring
        self._before = {number: signal.signal(number, self._take) for number in (signal.SIGINT, signal.SIGTERM)}
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup
            self._before[signal.SIGHUP] = signal.signal(signal.SIGHUP, self._take if hangup_ends else signal.SIG_IGN)

    def restore(self) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def _take(self, number: int, _frame: FrameType | None) -> None:
        self.by_keyboard = self.by_keyboard or number == signal.SIGINT
        self._measuring.request_stop()


class _OutputHandler(logging.Handler):
    """Log messages through the output's thread; kept back while the view has the screen."""

    def __init__(self, output: Output) -> None:
        super().__init__(logging.INFO)
        self.setFormatter(logging.Formatter("linkrover: %(levelname)s: %(message)s"))
        self._output = output
        self.held: list[str] | None = None

    def emit(self, record: logging.LogRecord) -> None:
        line = self.format(record) + "\n"
        if self.held is None:
            self._output.write(line)
        elif len(self.held) < 1000:
            self.held.append(line)
