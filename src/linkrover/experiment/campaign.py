"""A real campaign, trial by trial: both ends checked, both recordings started, stopped, read through and collected.

No terminal here: cli/experiment.py asks the questions.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from linkrover.errors import ConfigError, LinkRoverError
from linkrover.experiment.control import (
    DEFAULT_PORT,
    Check,
    Chunk,
    ControlError,
    ExistsError,
    Fetch,
    Start,
    Started,
    Status,
    Stop,
    Stopped,
    UnreachableError,
    ask,
    load_key,
)
from linkrover.experiment.plan import Plan, TrialPlan
from linkrover.probe.address import split_host_port

ENDS = ("robot", "station")
RECORD_FILE = "campaign.json"
EXPECTED = {
    "robot": (("link_utilization",), ("wireless_link", "station_link"), ("probe_result",)),
    "station": (("link_utilization",),),
}
"""Topics without which a recording of that end is not whole; of several in one place, one is enough."""


class Finding(msgspec.Struct, frozen=True):
    """One thing that was checked. ok None: worth knowing, not in the way."""

    what: str
    ok: bool | None
    text: str


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """What is kept of a trial of a real campaign, beside its recordings."""

    case: str
    trial: int
    attempt: int
    seconds: float
    started_wall_ns: int
    robot: Stopped
    station: Stopped
    problems: tuple[str, ...] = ()
    note: str = ""


class Campaign:
    """Both ends of a campaign by their control ports.

    Raises:
        ConfigError: the plan's [campaign] lacks the key file, or an address cannot be used.
    """

    def __init__(self, plan: Plan, folder: Path, base: Path) -> None:
        self.plan = plan
        self.folder = folder
        settings = plan.campaign
        if settings.key_file is None:
            raise ConfigError("campaign.key_file: must name the file with the key that both agents were started with")
        key_file = Path(settings.key_file)
        self._key = load_key(key_file if key_file.is_absolute() else base / key_file)
        self._at = {
            end: split_host_port(address, DEFAULT_PORT)
            for end, address in (("robot", settings.robot), ("station", settings.station))
        }
        # the robot reaches the station's reflector where we reach its control port, unless the plan says otherwise
        self.peer = settings.peer or self._at["station"][0]
        self._attempts: dict[str, int] = {}

    def done(self, run: TrialPlan) -> bool:
        """Whether this trial is recorded whole."""
        return (self.folder / run.folder / RECORD_FILE).exists()

    def _call(self, end: str, request: Check | Start | Stop | Fetch, timeout_s: float = 45.0) -> object:
        host, port = self._at[end]
        return ask(host, port, self._key, request, timeout_s)

    def check(self, run: TrialPlan) -> list[Finding]:
        """Look at both ends before a trial: reachable, interfaces up, peer answers, clocks near, disk free."""
        found: list[Finding] = []
        interfaces = {"robot": run.case.robot_interfaces, "station": run.case.station_interfaces}
        # the station first: it then answers the robot's probes
        for end in reversed(ENDS):
            probe = self.peer if end == "robot" else None
            asked_ns = time.time_ns()
            began = time.monotonic()
            try:
                status = self._call(end, Check(interfaces=interfaces[end], reflect=end == "station"))
                took_s = time.monotonic() - began
                assert isinstance(status, Status)
                found += self._look(end, status, asked_ns, took_s)
                if probe is not None:
                    probed = self._call(end, Check(probe=probe))
                    assert isinstance(probed, Status)
                    found.append(_answers(probed, probe))
            except ControlError as error:
                found.append(Finding(f"{end}: control port", False, str(error)))
        return found

    def _look(self, end: str, status: Status, asked_ns: int, took_s: float) -> list[Finding]:
        limits = self.plan.campaign
        found = [Finding(f"{end}: control port", True, f"{status.host}, LinkRover {status.version}")]
        if status.role != end:
            found.append(Finding(f"{end}: role", False, f"the agent there was started as {status.role}"))
        for name, state in status.interfaces.items():
            text = f"{name} is {state}" + ("" if state == "up" else f": sudo ip link set {name} up, or connect it")
            found.append(Finding(f"{end}: interface", state == "up", text))
        free = status.free_bytes
        found.append(
            Finding(f"{end}: free disk", free >= limits.least_free_bytes,
                    f"{free / 1e9:.1f} GB, needed {limits.least_free_bytes / 1e9:.1f} GB")
        )  # fmt: skip
        # within the time the question took; good enough to see a clock that is not set. Recordings are joined by the
        # probes, so a difference is no error of the measurement
        offset_s = abs((status.wall_ns - asked_ns) / 1e9 - took_s / 2)
        within = offset_s - took_s / 2 <= limits.largest_clock_offset_s
        found.append(Finding(f"{end}: clock", within, f"{offset_s:.2f} s from this machine's"))
        if status.recording is not None:
            found.append(Finding(f"{end}: idle", False, f"records {status.recording} now; stop that first"))
        return found

    def start(self, run: TrialPlan, duration_s: float | None = None) -> str:
        """Start both recordings, the station's first. Returns the run's name at the ends.

        Raises:
            ControlError: an end refused or is gone; what was started is stopped again.
        """
        attempt = self._attempts.get(run.folder, 0) + 1
        while True:
            name = f"{self.plan.name}/{run.folder}" + ("" if attempt == 1 else f".{attempt}")
            try:
                self._begin("station", run, name, duration_s)
                break
            except ExistsError:
                # recordings of a trial that was repeated stay where they are
                attempt += 1
        self._attempts[run.folder] = attempt
        try:
            self._begin("robot", run, name, duration_s)
        except ControlError:
            self._call("station", Stop())
            raise
        return name

    def _begin(self, end: str, run: TrialPlan, name: str, duration_s: float | None) -> None:
        case = run.case
        answer = self._call(
            end,
            Start(
                run=name,
                case=case.name,
                trial=run.trial,
                interfaces=case.robot_interfaces if end == "robot" else case.station_interfaces,
                peer=self.peer if end == "robot" else None,
                reflect=end == "station",
                duration_s=duration_s,
            ),
        )
        assert isinstance(answer, Started)

    def stop(
        self, run: TrialPlan, seconds: float, say: Callable[[str], None] = lambda _text: None, patience_s: float = 600.0
    ) -> Trial:
        """Stop both recordings, the robot's first, and say what is wrong with them.

        The robot may be out of reach: it is asked again until patience_s is over, and records on meanwhile.

        Raises:
            ControlError: an end stayed out of reach.
        """
        started_ns = time.time_ns() - int(seconds * 1e9)
        stopped: dict[str, Stopped] = {}
        for end in ENDS:
            stopped[end] = self._stop(end, say, time.monotonic() + patience_s)
        problems = [problem for end in ENDS for problem in faults(end, stopped[end])]
        return Trial(
            case=run.case.name,
            trial=run.trial,
            attempt=self._attempts.get(run.folder, 1),
            seconds=seconds,
            started_wall_ns=started_ns,
            robot=stopped["robot"],
            station=stopped["station"],
            problems=tuple(problems),
        )

    def _stop(self, end: str, say: Callable[[str], None], give_up_s: float) -> Stopped:
        while True:
            with contextlib.suppress(UnreachableError):
                answer = self._call(end, Stop())
                assert isinstance(answer, Stopped)
                return answer
            if time.monotonic() > give_up_s:
                raise UnreachableError(f"the {end} stayed out of reach; its agent records on: stop it there")
            say(f"the {end} is out of reach and records on; bring it back into range")
            time.sleep(2.0)

    def collect(self, run: TrialPlan, trial: Trial, progress: Callable[[float], None] = lambda _share: None) -> Path:
        """Copy both recordings into the campaign's folder; the last thing written says that the trial is whole.

        Raises:
            LinkRoverError: a file cannot be had whole, or the folder holds recordings already.
        """
        out = self.folder / run.folder
        if any((out / end).exists() for end in ENDS):
            raise LinkRoverError(f"{out} holds recordings already; they are never overwritten")
        total = sum(sum(stopped.files.values()) for stopped in (trial.robot, trial.station)) or 1
        copied = 0
        for end, stopped in (("robot", trial.robot), ("station", trial.station)):
            # a copy that breaks off must not look like a recording
            partial = out / f".{end}.partial"
            partial.mkdir(parents=True, exist_ok=True)
            for name, octets in stopped.files.items():
                if Path(name).name != name:
                    raise LinkRoverError(f"the {end} names a file {name!r}, which is no plain name")
                with (partial / name).open("wb") as file:
                    while file.tell() < octets:
                        chunk = self._call(end, Fetch(run=stopped.run, file=name, offset=file.tell()))
                        assert isinstance(chunk, Chunk)
                        if not chunk.data:
                            raise LinkRoverError(f"{name} of the {end} ended at {file.tell()} of {octets} octets")
                        file.write(chunk.data)
                        copied += len(chunk.data)
                        progress(copied / total)
            partial.rename(out / end)
        new = out / (RECORD_FILE + ".new")
        new.write_bytes(msgspec.json.format(msgspec.json.encode(trial)))
        new.rename(out / RECORD_FILE)
        return out

    def recording(self) -> dict[str, str | None]:
        """What each end records now; an end out of reach is left out."""
        found: dict[str, str | None] = {}
        for end in ENDS:
            try:
                status = self._call(end, Check(), 5.0)
            except ControlError:
                continue
            assert isinstance(status, Status)
            found[end] = status.recording
        return found


def faults(end: str, stopped: Stopped) -> list[str]:
    """What keeps a recording from being whole."""
    found = [f"{end}: {problem}" for problem in stopped.problems]
    there = {topic.rpartition("/")[2] for topic, count in stopped.topics.items() if count and "/linkrover/" in topic}
    missing = [" or ".join(parts).replace("_", " ") for parts in EXPECTED[end] if not there.intersection(parts)]
    return found + [f"{end}: not one {what} in the recording" for what in missing]


def _answers(status: Status, peer: str) -> Finding:
    what = f"robot: {peer} answers probes"
    if status.probes_sent is None:
        return Finding(what, False, status.probe_problem)
    if not status.probes_answered:
        text = f"none of {status.probes_sent} was answered {status.probe_problem}".strip()
        return Finding(what, False, f"{text}; is the robot connected, and UDP port 8620 open?")
    return Finding(what, True, f"{status.probes_answered} of {status.probes_sent}")
