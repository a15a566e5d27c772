"""The working folder of a run, and finding and removing what a killed run left.

Namespaces, devices and addresses vanish with their processes; what a `kill -9` can leave is this folder and, where
the kernel could not tell them, processes. The folder says who owns it, so that a later run can judge.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import stat
import tempfile
import time
from pathlib import Path

import msgspec

from linkrover.errors import LinkRoverError

OWNER_FILE = "owner.json"
LONGEST_BASE = 60


class Process(msgspec.Struct, frozen=True):
    """A process that cannot be confused with a later one of the same id: start_ticks is field 22 of its stat."""

    pid: int
    start_ticks: int
    what: str


class Owner(msgspec.Struct, frozen=True):
    """What a run's folder says of itself."""

    process: Process
    boot_id: str
    out: str
    started_wall_ns: int
    children: tuple[Process, ...] = ()


class Leftover(msgspec.Struct, frozen=True):
    """A folder whose run is no more."""

    folder: Path
    owner: Owner | None
    alive: tuple[Process, ...]


def start_ticks(pid: int) -> int | None:
    """When the process started (clock ticks since boot); None when there is none."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    fields = text.rpartition(")")[2].split()
    return None if fields[0] in "ZX" else int(fields[19])


def identify(pid: int, what: str) -> Process:
    """The process as it is now."""
    return Process(pid, start_ticks(pid) or 0, what)


def is_alive(process: Process) -> bool:
    """Whether this very process still runs."""
    return process.start_ticks != 0 and start_ticks(process.pid) == process.start_ticks


def boot_id() -> str:
    """Identifies this boot of the machine."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def base_folder() -> Path:
    """Where runs keep their working folders: of this user alone.

    Raises:
        LinkRoverError: the folder exists but belongs to somebody else or is open to others.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    uid = os.geteuid()
    # within a user namespace of ours we are called 0, and another user's folder of that name is not ours
    real = next((int(line[1]) + uid - int(line[0]) for line in _uid_map() if int(line[0]) <= uid), uid)
    # Unix socket paths hold 107 octets, so a deep folder is of no use here
    fits = bool(runtime) and len(os.fsencode(runtime or "")) <= LONGEST_BASE and os.access(runtime or "", os.W_OK)
    base = Path(runtime or "") / "linkrover" if fits else Path(f"/tmp/linkrover-{real}")  # noqa: S108
    with contextlib.suppress(FileExistsError):
        base.mkdir(mode=0o700)
    status = base.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != uid or status.st_mode & 0o022:
        raise LinkRoverError(f"{base} is not a folder that only you can write to; remove it and try again")
    return base


def _uid_map() -> list[list[str]]:
    return [line.split() for line in Path("/proc/self/uid_map").read_text().splitlines()]


class RunFolder:
    """The working folder of the run of this process; remove() at its end."""

    def __init__(self, out: Path) -> None:
        self.path = Path(tempfile.mkdtemp(prefix=f"run-{os.getpid()}-", dir=base_folder()))
        me = identify(os.getpid(), "linkrover")
        self._owner = Owner(me, boot_id(), str(out.absolute()), time.time_ns())
        self._save()

    def add(self, pid: int, what: str) -> None:
        """Note a child process."""
        children = (*self._owner.children, identify(pid, what))
        self._owner = msgspec.structs.replace(self._owner, children=children)
        self._save()

    def remove(self) -> None:
        """The run is over."""
        shutil.rmtree(self.path, ignore_errors=True)

    def _save(self) -> None:
        new = self.path / (OWNER_FILE + ".new")
        new.write_bytes(msgspec.json.encode(self._owner))
        new.replace(self.path / OWNER_FILE)


def find_leftovers() -> list[Leftover]:
    """Folders of runs whose owner is no more."""
    found = []
    for folder in sorted(base_folder().glob("run-*")):
        try:
            owner = msgspec.json.decode((folder / OWNER_FILE).read_bytes(), type=Owner)
        except FileNotFoundError:
            if time.time() - folder.lstat().st_mtime > 60:
                found.append(Leftover(folder, None, ()))
            continue
        except msgspec.DecodeError:
            found.append(Leftover(folder, None, ()))
            continue
        same_boot = owner.boot_id == boot_id()
        if same_boot and is_alive(owner.process):
            continue
        alive = tuple(child for child in owner.children if same_boot and is_alive(child))
        found.append(Leftover(folder, owner, alive))
    return found


def clean(leftover: Leftover, patience_s: float = 5.0) -> None:
    """End its processes (SIGTERM, then SIGKILL after patience_s) and remove its folder."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        for process in leftover.alive:
            if is_alive(process):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process.pid, number)
        give_up = time.monotonic() + patience_s
        while any(map(is_alive, leftover.alive)) and time.monotonic() < give_up:
            time.sleep(0.02)
    shutil.rmtree(leftover.folder, ignore_errors=True)
