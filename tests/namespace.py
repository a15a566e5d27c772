"""Network namespaces for tests: without a name, gone with the last file descriptor or process in them."""

from __future__ import annotations

import ctypes
import fcntl
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import TypeVar

import pytest

T = TypeVar("T")
_CLONE_NEWNET = 0x40000000
_SIOCGIFFLAGS = 0x8913
_IFF_RUNNING = 0x40  # operational state "up", not only an administrator's wish
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

    def wait_until_up(self, device: str, timeout_s: float = 20.0) -> None:
        """Until the device carries packets: on a busy machine a moment after both of its ends were set up."""
        until = time.monotonic() + timeout_s
        request = struct.pack("16sH14x", device.encode(), 0)

        def running() -> bool:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
                flags = struct.unpack("16sH14x", fcntl.ioctl(any_socket, _SIOCGIFFLAGS, request))[1]
            return bool(flags & _IFF_RUNNING)

        while not self.run(running):
            if time.monotonic() > until:
                raise AssertionError(f"{device} carries no packets after {timeout_s} s")
            time.sleep(0.01)

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
    for end in (one, two):
        end.wait_until_up("v0")
    return one, two
