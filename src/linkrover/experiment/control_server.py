"""The serving side of the control port: `linkrover agent --control KEY_FILE` at each end of a real campaign."""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from linkrover import __version__
from linkrover.agent.config import AgentConfig, check, to_toml
from linkrover.errors import ConfigError, LinkRoverError, ParseError
from linkrover.experiment.control import (
    ANSWER_MOST,
    CHUNK_OCTETS,
    DEFAULT_PORT,
    REQUEST_MOST,
    RUN_NAME,
    Answer,
    Check,
    Chunk,
    Fetch,
    Hello,
    Refusal,
    Request,
    Start,
    Started,
    Status,
    Stop,
    Stopped,
    read_line,
    seal,
    unseal,
)

CONNECTIONS_MOST = 8
HANDSHAKE_S = 5.0
START_S = 20.0
STOP_S = 20.0
WRONG_KEY_S = 0.5
PROBES = 20
TARGET = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.:%-]*|\[[0-9A-Fa-f:.%a-z]+\](:\d+)?")


class ControlServer:
    """Answers requests on a TCP port; the measuring is done by an agent process of its own for each recording.

    Args:
        config: what the agent measures by default; config.record is the folder below which runs are recorded.
        key: the campaign's.
        host, port: where to listen; port 0 takes any free one (see `port`).
        tell: gets a sentence for the log.

    Raises:
        ConfigError: config.record is missing, or the port cannot be had.
    """

    def __init__(
        self,
        config: AgentConfig,
        key: bytes,
        host: str = "",
        port: int = DEFAULT_PORT,
        tell: Callable[[str], None] = lambda _text: None,
    ) -> None:
        if config.record is None:
            raise ConfigError("the control port needs --record DIR: the folder below which it records runs")
        self.config = config
        self.root = Path(config.record).absolute()
        self.root.mkdir(parents=True, exist_ok=True)
        self.tell = tell
        self.refused = 0
        self._key = key
        self._lock = threading.Lock()
        self._agent: subprocess.Popen[bytes] | None = None
        self._reflector: subprocess.Popen[bytes] | None = None
        self._run: Start | None = None
        self._began = 0.0
        self._slots = threading.BoundedSemaphore(CONNECTIONS_MOST)
        self._scratch = tempfile.TemporaryDirectory(prefix="linkrover-control-")
        try:
            self._listener = _listen(host, port)
        except OSError as error:
            raise ConfigError(f"control: TCP port {port}: {error.strerror}") from error
        self.port: int = self._listener.getsockname()[1]

    def serve(self) -> None:
        """Accept until close()."""
        while True:
            try:
                handle, address = self._listener.accept()
            except OSError:
                return  # closed
            if not self._slots.acquire(blocking=False):
                handle.close()
                continue
            threading.Thread(target=self._one, args=(handle, str(address[0])), daemon=True).start()

    def close(self) -> None:
        """Stop listening; a recording under way is ended whole."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        with self._lock:
            self._end_processes()
        self._scratch.cleanup()

    def _one(self, handle: socket.socket, source: str) -> None:
        try:
            with handle:
                self._converse(handle, source)
        except (OSError, EOFError):
            return  # it went away: nobody waits for an answer
        finally:
            self._slots.release()

    def _converse(self, handle: socket.socket, source: str) -> None:
        nonce = secrets.token_hex(16)
        handle.settimeout(HANDSHAKE_S)
        handle.sendall(msgspec.json.encode(Hello(linkrover=__version__, nonce=nonce)) + b"\n")
        try:
            theirs, request = unseal(read_line(handle, REQUEST_MOST, HANDSHAKE_S), self._key, "ask", nonce, Request)  # type: ignore[arg-type]
        except ParseError as error:
            # nothing is said to who cannot prove the key, and not quickly
            self.refused += 1
            self.tell(f"control: refused {source}: {error}")
            time.sleep(WRONG_KEY_S)
            return
        try:
            answer = self._answer(request)
        except LinkRoverError as error:
            answer = Refusal(reason=str(error))
        handle.settimeout(30.0)
        line = seal(self._key, "answer", nonce, theirs, answer)
        assert len(line) <= ANSWER_MOST
        handle.sendall(line)

    def _answer(self, request: Request | Answer) -> Answer:
        with self._lock:
            if isinstance(request, Check):
                return self._check(request)
            if isinstance(request, Start):
                return self._start(request)
            if isinstance(request, Stop):
                return self._stop()
            if isinstance(request, Fetch):
                return self._fetch(request)
        return Refusal(reason="not a request")

    # ---- the four requests

    def _check(self, request: Check) -> Status:
        if request.reflect and self._agent is None and self._reflector is None:
            command = [sys.executable, "-m", "linkrover", "reflect", "--quiet"]
            if self.config.reflector.port is not None:
                command += ["--port", str(self.config.reflector.port)]
            self._reflector = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                               stderr=subprocess.DEVNULL, start_new_session=True)  # fmt: skip
        sent, answered, problem = (None, None, "") if request.probe is None else _probe(request.probe)
        space = os.statvfs(self.root)
        running = self._agent is not None and self._agent.poll() is None
        return Status(
            role=self.config.role.value,
            host=os.uname().nodename,
            version=__version__,
            wall_ns=time.time_ns(),
            interfaces={name: _state(name) for name in request.interfaces},
            free_bytes=space.f_bavail * space.f_frsize,
            recording=self._run.run if running and self._run is not None else None,
            probes_sent=sent,
            probes_answered=answered,
            probe_problem=problem,
        )

    def _start(self, request: Start) -> Started | Refusal:
        if self._agent is not None and self._agent.poll() is None:
            assert self._run is not None
            raise ConfigError(f"a recording is under way already: {self._run.run}")
        folder = self._folder(request.run)
        directory = folder / self.config.role.value
        if directory.exists():
            return Refusal(reason=f"{directory} holds a recording already; it is not overwritten", exists=True)
        self._end_processes()
        config = msgspec.structs.replace(
            self.config,
            record=str(folder),
            interfaces=request.interfaces or self.config.interfaces,
            peers=(request.peer,) if request.peer is not None else self.config.peers,
            reflect=request.reflect or self.config.reflect,
            duration_s=request.duration_s,
            case=request.case,
            trial=request.trial,
            run=request.run,
        )
        check(config, "the request")
        file = Path(self._scratch.name) / "agent.toml"
        file.write_text(to_toml(config))
        log = (Path(self._scratch.name) / "agent.log").open("wb")
        with log:
            self._agent = subprocess.Popen(
                [sys.executable, "-m", "linkrover", "agent", "--plain", "--config", str(file)],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        self._run, self._began = request, time.monotonic()
        give_up = time.monotonic() + START_S
        while not (directory.is_dir() and any(directory.iterdir())):
            if self._agent.poll() is not None or time.monotonic() > give_up:
                self._end_processes()
                raise LinkRoverError(f"the agent did not begin to record: {self._last_words()}")
            time.sleep(0.02)
        self.tell(f"control: recording {request.run}")
        return Started(directory=str(directory))

    def _stop(self) -> Stopped:
        if self._run is None:
            raise LinkRoverError("nothing is being recorded")
        run, seconds = self._run, time.monotonic() - self._began
        self._end_processes()
        self._run = None
        directory = self._folder(run.run) / self.config.role.value
        from linkrover.bag.reading import read_recording

        recording = read_recording(directory)
        self.tell(f"control: recorded {run.run}, {recording.messages} messages")
        return Stopped(
            run=run.run,
            directory=str(directory),
            problems=recording.problems,
            seconds=seconds,
            topics={topic.name: topic.count for topic in recording.topics},
            files={path.name: path.stat().st_size for path in sorted(directory.iterdir()) if path.is_file()},
        )

    def _fetch(self, request: Fetch) -> Chunk:
        directory = self._folder(request.run) / self.config.role.value
        path = directory / request.file
        if path.parent != directory or not path.is_file() or path.is_symlink():
            raise LinkRoverError(f"{request.file}: no such file of the recording {request.run}")
        with path.open("rb") as file:
            file.seek(max(0, request.offset))
            return Chunk(data=file.read(CHUNK_OCTETS), total=path.stat().st_size)

    # ---- within

    def _folder(self, run: str) -> Path:
        if not RUN_NAME.fullmatch(run):
            raise ConfigError(f"run {run!r}: up to four names of letters, digits, '.', '_', '-', separated by '/'")
        return self.root / run

    def _end_processes(self) -> None:
        for process in (self._agent, self._reflector):
            if process is not None and process.poll() is None:
                process.send_signal(signal.SIGTERM)
                try:
                    process.wait(STOP_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
        self._agent = self._reflector = None

    def _last_words(self) -> str:
        text = (Path(self._scratch.name) / "agent.log").read_text(errors="replace").strip()
        return text[-500:] or "it said nothing"


def serve(config: AgentConfig, key: bytes, port: int = DEFAULT_PORT, host: str = "") -> int:
    """Serve until SIGINT or SIGTERM; the exit status."""
    server = ControlServer(config, key, host, port, tell=lambda text: print(text, file=sys.stderr, flush=True))

    def end(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)
    print(f"control port {server.port}, recording below {server.root}", file=sys.stderr, flush=True)
    try:
        server.serve()
    except KeyboardInterrupt:
        pass
    finally:
        server.close()
    return 0


def _listen(host: str, port: int) -> socket.socket:
    if not host and socket.has_dualstack_ipv6():
        with contextlib.suppress(OSError):
            return socket.create_server(("", port), family=socket.AF_INET6, dualstack_ipv6=True, backlog=8)
    return socket.create_server((host, port), backlog=8)


def _state(name: str) -> str:
    folder = Path("/sys/class/net") / name
    if "/" in name or not folder.is_dir():
        return "absent"
    try:
        state = (folder / "operstate").read_text().strip()
        flags = int((folder / "flags").read_text().strip(), 16)
    except OSError:
        return "absent"
    # a TUN device and some drivers never say more than "unknown" although they carry packets
    return "up" if flags & 1 and state in ("up", "unknown") else "down"


def _probe(target: str) -> tuple[int | None, int | None, str]:
    if not TARGET.fullmatch(target):
        return None, None, f"{target!r} is no HOST or HOST:PORT"
    command = [sys.executable, "-m", "linkrover", "probe", target, "--count", str(PROBES), "--rate", "20", "--json",
               "--deadline", "1"]  # fmt: skip
    try:
        done = subprocess.run(command, capture_output=True, timeout=30, text=True, check=False)
        found = json.loads(done.stdout)["summary"]
        return int(found["sent"]), int(found["answered"]), ""
    except (subprocess.TimeoutExpired, ValueError, KeyError, TypeError) as error:
        return PROBES, 0, f"{type(error).__name__}: {error}"
