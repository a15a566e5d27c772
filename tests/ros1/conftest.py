from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.middleware.contract import ROOT, Driver

LINKROVER = [sys.executable, "-m", "linkrover"]
ROS_PARTS = ("rospy", "rosgraph", "actionlib_msgs")
LANGUAGES_LEFT_OUT = "genlisp:geneus:gennodejs:genpy"  # what is tested is C++ against our own Python classes


def missing_ros() -> str | None:
    missing = [name for name in ROS_PARTS if importlib.util.find_spec(name) is None]
    if missing:
        return f"Debian's ROS 1 is not installed ({', '.join(missing)}): scripts/system-packages ros1"
    return None if shutil.which("rosmaster") else "rosmaster is not installed: scripts/system-packages ros1"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    reason = missing_ros()
    for item in items:
        if Path(__file__).parent in item.path.parents:
            if "cpp_peers" in getattr(item, "fixturenames", ()):
                item.add_marker(pytest.mark.timeout(600))  # the first of them builds
            item.add_marker(pytest.mark.ros1)
            if reason is not None:
                item.add_marker(pytest.mark.skip(reason=reason))


def free_port() -> int:
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])


def wait_for(condition: Callable[[], Any], what: str, timeout_s: float = 30.0) -> Any:
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        found = condition()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError(f"not within {timeout_s:.0f} s: {what}")


class Master:
    """A real rosmaster on a port of its own."""

    def __init__(self, home: Path, prefix: tuple[str, ...] = (), host: str = "127.0.0.1") -> None:
        self.port = free_port()
        self.host = host
        self.home = home
        self.prefix = prefix
        self.uri = f"http://{host}:{self.port}"
        self.process: subprocess.Popen[bytes] | None = None

    def environment(self, host: str | None = None) -> dict[str, str]:
        kept = {k: v for k, v in os.environ.items() if not k.startswith("ROS_")}
        return {
            **kept,
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": host or self.host,
            "ROS_HOME": str(self.home),
            "ROS_PACKAGE_PATH": f"{ROOT / 'ros'}:/usr/share",
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT / "src/linkrover/ros1/generated"),
        }

    def start(self) -> Master:
        self.process = subprocess.Popen(
            [*self.prefix, "rosmaster", "--core", "-p", str(self.port)],
            env=self.environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        if not self.prefix:
            wait_for(self._listens, "rosmaster listens")
        return self

    def _listens(self) -> bool:
        try:
            socket.create_connection((self.host, self.port), 0.5).close()
        except OSError:
            return False
        return True

    def stop(self) -> None:
        if self.process is not None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
            self.process = None


def state(master: Master) -> list[list[Any]]:
    """Publishers, subscribers and services, as the master says."""
    from linkrover.ros1.rpc import Rpc, RpcError

    try:
        found: list[list[Any]] = Rpc(master.uri, "/test").call("getSystemState")
    except RpcError:
        return [[], [], []]
    return found


@pytest.fixture
def master(tmp_path: Path) -> Iterator[Master]:
    found = Master(tmp_path / "ros_home").start()
    yield found
    found.stop()


class Programs:
    """Programs of one test; all ended when it ends."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.running: list[subprocess.Popen[str]] = []
        self.logs: dict[int, Path] = {}

    def start(self, command: list[str], environment: dict[str, str], cwd: Path = ROOT) -> subprocess.Popen[str]:
        log = self.directory / f"program{len(self.running)}.log"
        with log.open("w") as file:
            process = subprocess.Popen(command, env=environment, cwd=cwd, stdout=file, stderr=file, text=True)
        self.running.append(process)
        self.logs[process.pid] = log
        return process

    def log(self, process: subprocess.Popen[str]) -> str:
        return self.logs[process.pid].read_text()

    def interrupt(self, process: subprocess.Popen[str], timeout_s: float = 30) -> int:
        process.send_signal(signal.SIGINT)
        return process.wait(timeout_s)

    def stop(self) -> None:
        for process in self.running:
            if process.poll() is None:
                # how a node ends is tested where it matters; roslaunch must end its own children
                process.terminate() if "roslaunch" in process.args else process.kill()
        for process in self.running:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.fixture
def programs(tmp_path: Path) -> Iterator[Programs]:
    found = Programs(tmp_path)
    yield found
    found.stop()


@pytest.fixture
def drivers() -> Iterator[list[Driver]]:
    found: list[Driver] = []
    yield found
    for driver in found:
        driver.stop()


@pytest.fixture(scope="session")
def cpp_peers() -> Path:
    """Folder of the C++ peers, built by catkin once for each state of their sources."""
    return build_peers()


def build_peers() -> Path:
    if shutil.which("catkin_make") is None or shutil.which("g++") is None:
        pytest.skip("catkin or g++ is not installed: scripts/system-packages ros1")
    packages = [ROOT / "ros/network_analysis", ROOT / "ros/linkrover_msgs", ROOT / "tests/ros1/cpp"]
    files = sorted(f for p in packages for f in _files(p))
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.relative_to(ROOT)}\0".encode() + file.read_bytes())
    workspace = ROOT / ".cache" / f"catkin-{digest.hexdigest()[:16]}"
    workspace.parent.mkdir(exist_ok=True)
    with (workspace.parent / "catkin.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # two test runs in one tree build once
        if not (workspace / "built").exists():
            _build(workspace, packages)
    return workspace / "devel/lib/linkrover_test_peers"


def _build(workspace: Path, packages: list[Path]) -> None:
    shutil.rmtree(workspace, ignore_errors=True)
    (workspace / "src").mkdir(parents=True)
    for package in packages:
        (workspace / "src" / package.name).symlink_to(package)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "ROS", "VIRTUAL"))}
    environment |= {
        "PATH": "/usr/bin:/bin:/usr/sbin:/sbin",
        "ROS_LANG_DISABLE": LANGUAGES_LEFT_OUT,
        "PWD": str(workspace),
    }
    built = subprocess.run(
        [
            "catkin_make",
            "-C",
            str(workspace),
            "-DPYTHON_EXECUTABLE=/usr/bin/python3",
            "-DCMAKE_BUILD_TYPE=Release",
            "-j2",
        ],
        cwd=workspace,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert built.returncode == 0, built.stdout[-3000:] + built.stderr[-3000:]
    (workspace / "built").touch()


def _files(package: Path) -> list[Path]:
    return [Path(folder) / name for folder, _, names in os.walk(package, followlinks=True) for name in names]
