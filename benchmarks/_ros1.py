"""Two network namespaces joined by a veth pair, a rosmaster on the robot's, programs in both; gone at the end."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ADDRESS = {"robot": "10.79.0.2", "station": "10.79.0.1"}
PLAY = [sys.executable, "-m", "tests.ros1.play"]
LINKROVER = [sys.executable, "-m", "linkrover", "ros1"]


class Pair:
    """A context manager."""

    def __init__(self) -> None:
        self.names = {end: f"lr-{os.getpid()}-{end}" for end in ADDRESS}
        self.devices = {end: f"lr{os.getpid() % 100000}{end[0]}" for end in ADDRESS}
        self.folder = tempfile.TemporaryDirectory()
        self.running: list[subprocess.Popen[str]] = []

    def __enter__(self) -> Pair:
        try:
            for name in self.names.values():
                _ip("netns", "add", name)
            robot, station = self.devices["robot"], self.devices["station"]
            _ip("-n", self.names["robot"], "link", "add", robot, "type", "veth", "peer", "name", station,
                "netns", self.names["station"])  # fmt: skip
            for end, address in ADDRESS.items():
                name, device = self.names[end], self.devices[end]
                _ip("-n", name, "addr", "add", f"{address}/24", "dev", device)
                _ip("-n", name, "link", "set", device, "up")
                _ip("-n", name, "link", "set", "lo", "up")
        except subprocess.CalledProcessError:
            self.__exit__()
            raise
        self.start("robot", ["rosmaster", "--core"])
        time.sleep(1.0)
        return self

    def __exit__(self, *_: object) -> None:
        for process in reversed(self.running):
            self.stop(process)
        for name in self.names.values():
            subprocess.run(["ip", "netns", "del", name], capture_output=True)
        self.folder.cleanup()

    def environment(self, end: str) -> dict[str, str]:
        kept = {k: v for k, v in os.environ.items() if not k.startswith("ROS_")}
        return {
            **kept,
            "ROS_MASTER_URI": f"http://{ADDRESS['robot']}:11311",
            "ROS_IP": ADDRESS[end],
            "ROS_HOME": self.folder.name,
            "ROS_PACKAGE_PATH": f"{ROOT / 'ros'}:/usr/share",
            "PYTHONPATH": f"{ROOT}:{ROOT / 'src/linkrover/ros1/generated'}",
        }

    def command(self, end: str, command: list[str]) -> list[str]:
        return ["ip", "netns", "exec", self.names[end], *command]

    def start(self, end: str, command: list[str], log: str | None = None) -> subprocess.Popen[str]:
        with contextlib.ExitStack() as stack:
            out = subprocess.DEVNULL if log is None else stack.enter_context(Path(self.folder.name, log).open("w"))
            process = subprocess.Popen(
                self.command(end, command), env=self.environment(end), cwd=ROOT, stdout=out, stderr=out, text=True
            )
        self.running.append(process)
        return process

    def stop(self, process: subprocess.Popen[str]) -> None:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.wait(8)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process in self.running:
            self.running.remove(process)

    def run(self, end: str, command: list[str], timeout_s: float = 120) -> str:
        return subprocess.run(
            self.command(end, command), env=self.environment(end), cwd=ROOT, capture_output=True, text=True,
            timeout=timeout_s,
        ).stdout  # fmt: skip

    def bytes(self, end: str = "robot") -> int:
        """Both directions, as the robot's interface counts them (with link-layer headers)."""
        lines = self.run(end, ["cat", "/proc/net/dev"]).splitlines()
        fields = next(line for line in lines if self.devices[end] in line).split(":")[1].split()
        return int(fields[0]) + int(fields[8])

    def silent(self, quiet: bool) -> None:
        """Packets of both ends go to a hardware address nobody has: lost without a word, as beyond radio range."""
        for end, other in (("robot", "station"), ("station", "robot")):
            name, device = self.names[end], self.devices[end]
            if quiet:
                _ip("-n", name, "neigh", "replace", ADDRESS[other], "lladdr", "02:00:00:00:00:01", "dev", device,
                    "nud", "permanent")  # fmt: skip
            else:
                _ip("-n", name, "neigh", "del", ADDRESS[other], "dev", device)


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


def cpu_s(pid: int) -> float:
    """Of the process and of the children it has waited for, seconds (proc(5): utime, stime, cutime, cstime)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    own_ns = sum(int(task.joinpath("schedstat").read_text().split()[0]) for task in Path(f"/proc/{pid}/task").iterdir())
    return own_ns / 1e9 + (int(fields[13]) + int(fields[14])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1000
