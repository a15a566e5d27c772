"""The whole agent at both ends, as a user starts it: access point on the robot, and access point on the station.

The recordings go to the shared folder; tests/wifi/test_report.py reads and reports them outside.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import pytest

import linkrover.agent  # so that the forked agents find them loaded
import linkrover.bag.recorder
import linkrover.cli.agent
import linkrover.live.log  # noqa: F401
from linkrover.cli.main import main

from .air import PASSPHRASE, Air, Radio, enter, inside, run, wait_for

RUNS = Path("/result/runs")
MEASURE_S = 9.0
# All channels would take most of the time under traffic, and stop the probes meanwhile: seen here for 40 s.
SCAN = ("--scan-period", "5", "--scan-mhz", "2437", "--scan-mhz", "5180")


class End:
    """One `linkrover agent` in a namespace, forked from here: starting Python four times takes half a minute."""

    def __init__(self, case: str, radio: Radio, role: str, *more: str) -> None:
        self.log = Path(f"/tmp/{case}-{role}.log")
        self.journal = RUNS / case / role
        arguments = ["agent", "--interface", radio.iface, "--role", role]
        arguments += ["--record", str(RUNS / case), "--case", case, "--plain", *more]
        self.pid = os.fork()
        if self.pid == 0:
            status = 99
            try:
                status = self._be_the_agent(radio.ns, ["linkrover", *arguments])
            finally:
                os._exit(status)

    def _be_the_agent(self, ns: str, arguments: list[str]) -> int:
        out = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        sys.stdout, sys.stderr = (open(number, "w", buffering=1, closefd=False) for number in (1, 2))  # noqa: SIM115
        enter(ns)
        sys.argv = arguments
        try:
            main()
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else 1
        except BaseException:  # noqa: BLE001  # the log is all that is seen of it
            traceback.print_exc()
            return 98
        return 0

    def measuring(self) -> bool:
        """Whether the recording is under way: about a second of records is there."""
        assert os.waitpid(self.pid, os.WNOHANG) == (0, 0), self.log.read_text()
        return self.journal.exists() and sum(file.stat().st_size for file in self.journal.iterdir()) > 30_000

    def ask_to_end(self) -> None:
        """As a service manager does."""
        os.kill(self.pid, signal.SIGTERM)

    def finish(self) -> None:
        """Wait for its end."""
        _, status = os.waitpid(self.pid, 0)
        assert os.waitstatus_to_exitcode(status) == 0, self.log.read_text()


@contextlib.contextmanager
def flow(client: Radio, server: Radio, address: str) -> Iterator[None]:
    """A TCP stream of about 1 Mbit/s."""
    with inside(server.ns):
        listener = socket.create_server((address, 0))
    stop = threading.Event()

    def take() -> None:
        peer, _ = listener.accept()
        with peer:
            while peer.recv(65536):
                pass

    def give() -> None:
        while not stop.wait(0.05):
            sender.sendall(bytes(6000))

    threads = [threading.Thread(target=take, daemon=True), threading.Thread(target=give, daemon=True)]
    threads[0].start()
    with inside(client.ns):
        sender = socket.create_connection(listener.getsockname(), timeout=20)
    threads[1].start()
    yield
    stop.set()
    threads[1].join(20)
    sender.close()
    threads[0].join(20)
    listener.close()


@pytest.fixture(scope="module")
def measured(air: Air, robot: Radio, station: Radio, robot2: Radio, station2: Radio) -> dict[str, tuple[End, End]]:
    """Both cases of the paper at once, on two channels: measured, disturbed once, and finished."""
    air.access_point(robot, "on the robot", 36, passphrase=PASSPHRASE)
    air.station(station, "on the robot", [36], passphrase=PASSPHRASE)
    air.access_point(station2, "on the station", 6)
    air.station(robot2, "on the station", [6])
    ends = {
        "robot-ap": (
            End("robot-ap", robot, "robot", "--peer", "10.1.0.2"),
            End("robot-ap", station, "station", "--reflect"),
        ),
        "station-ap": (
            End("station-ap", robot2, "robot", "--peer", "10.1.0.4", *SCAN),
            End("station-ap", station2, "station", "--reflect"),
        ),
    }
    every = [end for pair in ends.values() for end in pair]
    wait_for("four recordings", lambda: all(end.measuring() for end in every), 90)
    with flow(robot, station, "10.1.0.2"), flow(robot2, station2, "10.1.0.4"):
        began = time.monotonic()
        for step in range(3):
            for radio in (robot, station, robot2, station2):
                radio.level(-42 - 6 * step)
            time.sleep(MEASURE_S / 4)
        control = f"/run/hostapd-{station2.iface}"
        run("hostapd_cli", "-p", control, "-i", station2.iface, "deauthenticate", robot2.mac, ns="station2")
        time.sleep(max(0.0, began + MEASURE_S - time.monotonic()))
    for end in every:
        end.ask_to_end()
    return ends


@pytest.mark.parametrize("case", ["robot-ap", "station-ap"])
def test_both_agents_finish_their_recordings(case: str, measured: dict[str, tuple[End, End]]):
    for end in measured[case]:
        end.finish()
        assert (end.journal / "metadata.yaml").exists()
        assert not list(end.journal.glob("*.journal"))
