"""One emulated run with real packets: hosts, relay, traffic and agents, started and ended in the right order."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import IO, Any

import msgspec

from linkrover.agent.config import AgentConfig, to_toml
from linkrover.emulator import enter
from linkrover.emulator.leftovers import RunFolder
from linkrover.emulator.netns import Host, in_namespace, make_host
from linkrover.emulator.presets import Case
from linkrover.emulator.relay_process import HostSettings, RelaySettings, TruthRecord
from linkrover.emulator.replay import Timeline
from linkrover.emulator.robot import Drive, Route
from linkrover.emulator.traffic import Settings as TrafficSettings
from linkrover.emulator.traffic import Traffic
from linkrover.errors import ConfigError, LinkRoverError
from linkrover.loop import Loop
from linkrover.probe.packet import DEFAULT_PORT
from linkrover.records import Record, Role

ADDRESSES = {"station": "10.77.0.1", "robot": "10.77.0.2"}
OTHERS = "10.77.0.{}"  # robot-2 is 10.77.0.12
ROBOTS_MOST = 10
IFACE = "wlan0"
START_LIMIT_S = 30.0
STOP_LIMIT_S = 10.0

_truth_decoder = msgspec.json.Decoder(TruthRecord)


class EmulationError(LinkRoverError):
    """A part of the emulation died; the message holds its last words."""


class WorldSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What to emulate.

    robots: how many; all but the first only send the traffic and drive elsewhere, agents are at the first and at the
    station. replay: a recorded run as the link, instead of the case's channel. run, trial: for the manifests. rates,
    probe: what the agents' configuration says otherwise than by default.
    """

    case: Case
    seed: int
    route: Route
    drive: Drive = Drive()
    traffic: Traffic = Traffic()
    trial: int | None = None
    run: str | None = None
    replay: Timeline | None = None
    robots: int = 1
    access_point_shows_signal: bool = True
    rates: dict[str, float] = {}
    probe: dict[str, Any] = {}

    def __post_init__(self) -> None:
        if not 1 <= self.robots <= ROBOTS_MOST:
            raise ConfigError(f"robots = {self.robots}: must be 1 to {ROBOTS_MOST}")
        if self.robots > 1 and (self.case.access_point == "robot" or self.replay is not None):
            raise ConfigError(
                f"robots = {self.robots}: several robots need a case whose access point is the router or the station"
            )

    @property
    def robot_names(self) -> tuple[str, ...]:
        """robot, robot-2, ..."""
        return ("robot", *(f"robot-{number}" for number in range(2, self.robots + 1)))


class Part:
    """A process of the emulation."""

    def __init__(self, what: str, process: subprocess.Popen[bytes], log: Path) -> None:
        self.what = what
        self.process = process
        self.log = log

    def check(self) -> None:
        """Raise EmulationError if it has ended by itself."""
        code = self.process.poll()
        if code is not None:
            raise EmulationError(f"the {self.what} ended by itself (status {code}): {self.last_words()}")

    def last_words(self) -> str:
        """The end of what it printed."""
        text = self.log.read_text(errors="replace").strip()
        return text[-800:] or "it said nothing"

    def end(self, limit_s: float = STOP_LIMIT_S) -> bool:
        """SIGTERM, then SIGKILL after limit_s. Returns whether it ended by SIGTERM."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.process.wait(limit_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return False
        return True


class World:
    """A context manager: what was started is ended on the way out, whatever happened.

    `take` gets the emulator's truth records. Call netns.become_namespace_root() before.
    """

    def __init__(self, settings: WorldSettings, out: Path, take: Callable[[Record], None]) -> None:
        self.settings = settings
        self.out = out
        self.folder = RunFolder(out)
        self.loop = Loop()
        self.notes: list[str] = []
        self.summary: dict[str, Any] = {}
        self._take = take
        self._truth_began = False
        self._parts: list[Part] = []
        self._hosts: dict[str, Host] = {}
        self._files: list[IO[bytes]] = []
        self._truth_fd = -1
        self._truth_rest = b""
        self._forget_truth: Callable[[], None] = _nothing
        self._environment = {**os.environ, "PYTHONUNBUFFERED": "1"}

    def __enter__(self) -> World:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def addresses(self) -> dict[str, str]:
        """IPv4 addresses of all hosts."""
        more = enumerate(self.settings.robot_names[1:], start=2)
        return {**ADDRESSES, **{name: OTHERS.format(10 + number) for number, name in more}}

    # ---- starting

    def start_link(self) -> None:
        """Hosts, relay, driver texts. Returns once packets can pass."""
        for name, address in self.addresses.items():
            self._hosts[name] = make_host(name, address, IFACE)
        read_fd, write_fd = os.pipe()
        os.set_blocking(read_fd, False)
        self._truth_fd = read_fd
        self._forget_truth = self.loop.reader(read_fd, self._read_truth)
        settings = self.settings
        relay = RelaySettings(
            hosts=tuple(HostSettings(h.name, h.address, h.tun_fd, h.tap_fd) for h in self._hosts.values()),
            case=settings.case,
            seed=settings.seed,
            pose_paths={name: self.path(f"pose-{name}") for name in settings.robot_names},
            driver_paths={end: self.path(f"{end}.wireless") for end in ADDRESSES},
            truth_fd=write_fd,
            iface=IFACE,
            access_point_shows_signal=settings.access_point_shows_signal,
            replay=settings.replay,
        )
        self._start(
            "relay",
            [sys.executable, "-m", "linkrover.emulator.relay_process", self._save("relay.json", relay)],
            keep=(write_fd, *(fd for host in self._hosts.values() for fd in (host.tun_fd, host.tap_fd))),
        )
        os.close(write_fd)
        self._until(lambda: self._truth_began, "the relay to begin")

    def start_agents(self, record: Path, *, reflect_both: bool = False) -> None:
        """The station's agent, then, once its reflector listens, the robot's. reflect_both: the robot answers too."""
        self._agent("station", record, reflect=True)
        self._until(partial(self._reflects, "station"), "the station's reflector to listen")
        self._agent("robot", record, peers=(ADDRESSES["station"],), feed=self.path("feed"), reflect=reflect_both)
        for end in ADDRESSES:
            folder = record / end
            self._until(partial(_has_files, folder), f"the {end}'s recording")

    def start_reflector(self, end: str) -> None:
        """Only a STAMP reflector at one end, nothing recorded."""
        self._start(f"{end}'s reflector", [sys.executable, "-m", "linkrover", "reflect"], host=self._hosts[end])
        self._until(partial(self._reflects, end), f"the {end}'s reflector to listen")

    def start_traffic(self) -> None:
        """Robot, operator and their streams."""
        self._traffic("robot", 0)

    def start_others(self) -> None:
        """The further robots with their operators and streams: they share the air."""
        for index, name in enumerate(self.settings.robot_names[1:], start=1):
            self._traffic(name, index)

    def _traffic(self, name: str, index: int) -> None:
        tail = "" if index == 0 else f"-{name}"
        settings = TrafficSettings(
            robot_address=self.addresses[name],
            station_address=ADDRESSES["station"],
            route=self.settings.route.turned(index * 0.7),
            drive=self.settings.drive,
            traffic=self.settings.traffic,
            seed=self.settings.seed + index,
            eyes_path=self.path(f"eyes{tail}"),
            pose_path=self.path(f"pose-{name}"),
            feed_path=self.path("feed") if index == 0 else None,
            result_path=self.path(f"traffic{tail}-{{role}}.json"),
            done_path=self.path(f"done{tail}"),
            port_offset=10 * index,
        )
        file = self._save(f"traffic{tail}.json", settings)
        for end in ("station", "robot"):
            host = self._hosts["station" if end == "station" else name]
            what = f"{end}'s traffic" if index == 0 else f"{end}'s traffic of {name}"
            self._start(what, [sys.executable, "-m", "linkrover.emulator.traffic", file, end], host=host)

    def popen(self, end: str, command: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start the user's program at one end, on the terminal of this process."""
        host = self._hosts[end]
        process = subprocess.Popen(
            [sys.executable, "-I", "-S", enter.__file__, str(host.netns_fd), "--", *command],
            pass_fds=(host.netns_fd,),
            env={
                **os.environ,
                **{f"LINKROVER_{name.upper()}": address for name, address in ADDRESSES.items()},
                "LINKROVER_END": end,
                "LINKROVER_WIRELESS": self.path(f"{end}.wireless"),
                enter.HOSTS_VARIABLE: self._hosts_file(),
            },
        )
        self.folder.add(process.pid, command[0])
        return process

    # ---- running

    def run(self, seconds: float, each: Callable[[], bool] | None = None, period_s: float = 0.1) -> None:
        """Let it run; `each` is called every period_s and ends it early by returning True.

        Raises:
            EmulationError: a part ended by itself.
        """
        until = time.monotonic() + seconds
        while (now := time.monotonic()) < until:
            self.loop.run(time.monotonic_ns() + int(min(period_s, until - now) * 1e9))
            for part in self._parts:
                part.check()
            if each is not None and each():
                return

    @property
    def drive_done(self) -> bool:
        """Whether the operator has driven the whole route."""
        return Path(self.path("done")).exists()

    def traffic_results(self) -> dict[str, Any]:
        """What both traffic programs counted, after they ended."""
        found = {}
        for end in ADDRESSES:
            with contextlib.suppress(FileNotFoundError):
                found[end] = msgspec.json.decode(Path(self.path(f"traffic-{end}.json")).read_bytes())
        return found

    # ---- ending

    def stop(self) -> None:
        """End everything, the robot's agent first, so that its last probes are still answered. Safe to call again."""
        order = ("robot's agent", "station's agent", "robot's traffic", "station's traffic")
        with _deaf_to_interrupts():
            ranks = {what: rank for rank, what in enumerate(order)}
            for part in sorted(self._parts, key=lambda part: ranks.get(part.what, 9 if part.what == "relay" else 5)):
                # the truth goes on being read meanwhile, or the relay would wait for room in its pipe
                part.process.terminate() if part.process.poll() is None else None
                give_up = time.monotonic() + STOP_LIMIT_S
                while part.process.poll() is None and time.monotonic() < give_up:
                    self.loop.run(time.monotonic_ns() + 20_000_000)
                if not part.end(0.1):
                    self.notes.append(f"the {part.what} had to be killed")
                if part.what == "relay":
                    with contextlib.suppress(msgspec.DecodeError, IndexError):
                        self.summary.update(msgspec.json.decode(part.log.read_text().strip().splitlines()[-1]))
            if self._parts:
                self.summary["traffic"] = self.traffic_results()
            self._parts.clear()
            if self._truth_fd >= 0:
                self._read_truth()
                os.close(self._truth_fd)
                self._truth_fd = -1
                self.loop.close()
            for host in self._hosts.values():
                host.close()
            self._hosts.clear()
            for file in self._files:
                file.close()
            self._files.clear()
            self.folder.remove()

    # ---- within

    def path(self, name: str) -> str:
        """A path in the run's working folder."""
        return str(self.folder.path / name)

    def _hosts_file(self) -> str:
        """/etc/hosts as the user's program sees it: what this machine's says, and the two ends."""
        path = Path(self.path("hosts"))
        if not path.exists():
            with contextlib.suppress(OSError):
                path.write_text(Path("/etc/hosts").read_text())
            with path.open("a") as file:
                file.writelines(f"\n{address} {name}\n" for name, address in self.addresses.items())
        return str(path)

    def _save(self, name: str, settings: msgspec.Struct) -> str:
        path = Path(self.path(name))
        path.write_bytes(msgspec.json.encode(settings))
        return str(path)

    def _agent(self, end: str, record: Path, **more: Any) -> None:
        config = AgentConfig(
            interfaces=(IFACE,),
            role=Role(end),
            record=str(record),
            wireless_path=self.path(f"{end}.wireless"),
            case=self.settings.case.name,
            trial=self.settings.trial,
            run=self.settings.run or record.name,
            emulated=True,
            **more,
        )
        if self.settings.rates:
            config = msgspec.structs.replace(config, rates=msgspec.structs.replace(config.rates, **self.settings.rates))
        if self.settings.probe:
            config = msgspec.structs.replace(config, probe=msgspec.structs.replace(config.probe, **self.settings.probe))
        file = Path(self.path(f"{end}.toml"))
        file.write_text(to_toml(config))
        command = [sys.executable, "-m", "linkrover", "agent", "--config", str(file)]
        self._start(f"{end}'s agent", command, host=self._hosts[end])

    def _start(self, what: str, command: list[str], host: Host | None = None, keep: tuple[int, ...] = ()) -> None:
        log = Path(self.path(what.replace("'s ", "-") + ".log"))
        file = log.open("wb")
        self._files.append(file)
        netns_fd = -1 if host is None else host.netns_fd
        process = subprocess.Popen(
            [sys.executable, "-I", "-S", enter.__file__, str(netns_fd), "--", *command],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=file,
            pass_fds=(*keep, *(() if host is None else (netns_fd,))),
            env=self._environment,
            start_new_session=True,  # Ctrl-C is for the parent, which ends them in the right order
        )
        self.folder.add(process.pid, what)
        self._parts.append(Part(what, process, log))

    def _until(self, reached: Callable[[], bool], what: str) -> None:
        self.run(START_LIMIT_S, reached, 0.01)
        if not reached():
            raise EmulationError(f"waited {START_LIMIT_S:.0f} s for {what}; is the machine overloaded?")

    def _reflects(self, end: str) -> bool:
        """Whether a reflector listens there, by the kernel's own list of sockets."""

        def read() -> str:
            # a reflector that takes IPv6 too is listed there
            return "".join(Path(f"/proc/thread-self/net/{name}").read_text() for name in ("udp", "udp6"))

        return f":{DEFAULT_PORT:04X} " in in_namespace(self._hosts[end].netns_fd, read)

    def _read_truth(self) -> None:
        while True:
            try:
                data = os.read(self._truth_fd, 1 << 20)
            except BlockingIOError:
                return
            if not data:
                self._forget_truth()
                self._forget_truth = _nothing
                return
            *lines, self._truth_rest = (self._truth_rest + data).split(b"\n")
            self._truth_began = True
            for line in lines:
                self._take(_truth_decoder.decode(line))


def _nothing() -> None:
    """Where there is nothing to undo."""


def _has_files(folder: Path) -> bool:
    return folder.is_dir() and any(folder.iterdir())


@contextlib.contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """While things are put away a second Ctrl-C waits."""
    try:
        before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # not in the main thread: no signals come here
        yield
        return
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
