"""The whole agent at both ends, as a user starts it: access point on the robot, and access point on the station.

The recordings go to the shared folder; tests/wifi/test_report.py reads and reports them outside.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from .air import PASSPHRASE, Air, Radio, inside, run, wait_for

RUNS = Path("/result/runs")
MEASURE_S = 9.0
# All channels would take most of the time under traffic, and stop the probes meanwhile: seen here for 40 s.
SCAN = ("--scan-period", "5", "--scan-mhz", "2437", "--scan-mhz", "5180")


class End:
    """One `linkrover agent` in a namespace."""

    def __init__(self, case: str, radio: Radio, role: str, *more: str) -> None:
        self.log = Path(f"/tmp/{case}-{role}.log")
        command = [sys.executable, "-m", "linkrover", "agent", "--interface", radio.iface, "--role", role]
        command += ["--record", str(RUNS / case), "--case", case, "--plain", *more]
        self.process = subprocess.Popen(
            ["ip", "netns", "exec", radio.ns, *command],
            stdout=self.log.open("wb"),
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONPATH": "src"},
        )
        self.journal = RUNS / case / role

    def measuring(self) -> bool:
        """Whether the recording has begun."""
        assert self.process.poll() is None, self.log.read_text()
        return self.journal.exists() and any(self.journal.iterdir())

    def finish(self) -> None:
        """Wait for its end, which was asked for as a service manager does it."""
        assert self.process.wait(60) == 0, self.log.read_text()


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
        end.process.send_signal(signal.SIGTERM)
    return ends


@pytest.mark.parametrize("case", ["robot-ap", "station-ap"])
def test_both_agents_finish_their_recordings(case: str, measured: dict[str, tuple[End, End]]):
    for end in measured[case]:
        end.finish()
        assert (end.journal / "metadata.yaml").exists()
        assert not list(end.journal.glob("*.journal"))
