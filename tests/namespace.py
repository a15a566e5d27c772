"""Network namespaces for tests: without a name, gone with the last file descriptor or process in them."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import TypeVar

import pytest

T = TypeVar("T")
_CLONE_NEWNET = 0x40000000
_libc = ctypes.CDLL(None, use_errno=True)


def _in_thread(work: Callable[[], T]) -> T:
    result: list[T] = []
    failure: list[BaseException] = []

    def run() -> None:
        try:
            result.append(work())
        except BaseException as error:  # noqa: BLE001  # handed on to the caller's thread
            failure.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if failure:
        raise failure[0]
    return result[0]


class Namespace:
    """A fresh network namespace; `lo` is up."""

    def __init__(self) -> None:
        if os.geteuid() != 0:
            pytest.skip("needs root, to make a network namespace")

        def make() -> int:
            if _libc.unshare(_CLONE_NEWNET) != 0:
                raise OSError(ctypes.get_errno(), "unshare(CLONE_NEWNET)")
            return os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)

        self.fd = _in_thread(make)
        self.ip("link set lo up")

    @property
    def path(self) -> str:
        """A path that means this namespace, for other processes."""
        return f"/proc/{os.getpid()}/fd/{self.fd}"

    def run(self, work: Callable[[], T]) -> T:
        """Call it in a thread that has entered the namespace."""

        def entered() -> T:
            if _libc.setns(self.fd, _CLONE_NEWNET) != 0:
                raise OSError(ctypes.get_errno(), "setns")
            return work()

        return _in_thread(entered)

    def ip(self, command: str) -> None:
        """One `ip` command in the namespace."""
        subprocess.run(["nsenter", f"--net={self.path}", "ip", *command.split()], check=True, capture_output=True)

    def start(self, arguments: list[str], **options: object) -> subprocess.Popen[str]:
        """Start `python ARGUMENTS` in the namespace."""
        command = ["nsenter", f"--net={self.path}", sys.executable, *arguments]
        return subprocess.Popen(command, text=True, **options)  # type: ignore[call-overload, no-any-return]

    def close(self) -> None:
        """Give it up."""
        os.close(self.fd)


def joined() -> tuple[Namespace, Namespace]:
    """Two namespaces with a veth pair between them: v0 10.9.0.1/24 in the first, v0 10.9.0.2/24 in the second."""
    one, two = Namespace(), Namespace()
    one.ip(f"link add v0 type veth peer name v0 netns {two.path}")
    for end, address in ((one, "10.9.0.1/24"), (two, "10.9.0.2/24")):
        end.ip(f"address add {address} dev v0")
        end.ip("link set v0 up")
    return one, two
