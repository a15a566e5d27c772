"""A sender and a reflector on one loop, and waiting for conditions instead of sleeping."""

import socket
import time
from contextlib import contextmanager

from linkrover.loop import Loop
from linkrover.probe.reflector import StampReflector


def run_until(loop, condition, timeout_s=20.0):
    """Run the loop until condition() holds; says so when it never does."""
    ends = time.monotonic_ns() + round(timeout_s * 1e9)
    while not condition():
        now = time.monotonic_ns()
        assert now < ends, "the condition was not met in time"
        loop.run(now + 5_000_000)


@contextmanager
def running_reflector(host="127.0.0.1", **options):
    loop = Loop()
    reflector = StampReflector(loop, host, 0, **options)
    reflector.start()
    try:
        yield loop, reflector
    finally:
        reflector.stop()
        loop.close()


def udp(family=socket.AF_INET, host="127.0.0.1"):
    sock = socket.socket(family, socket.SOCK_DGRAM)
    sock.bind((host, 0))
    sock.setblocking(False)
    return sock


def received(sock):
    """Everything that has arrived."""
    found = []
    while True:
        try:
            found.append(sock.recv(65_535))
        except BlockingIOError:
            return found
