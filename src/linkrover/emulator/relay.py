"""The relay: reads packets from the hosts' TUN devices, asks the medium, hands them on when the medium says so.

One thread, no blocking call. Release times are the model's, on CLOCK_MONOTONIC; how late each packet really left is
kept and reported in the truth, so that a machine that cannot keep up is seen.
"""

from __future__ import annotations

import ctypes
import gc
import os
import select
import time
from collections import deque
from collections.abc import Callable
from statistics import median_low
from typing import NamedTuple, Protocol

from linkrover.emulator.medium import EVERYONE, Fate, Medium
from linkrover.emulator.stamp_truth import UDP, is_probe, probe_truth
from linkrover.emulator.tap import Tap
from linkrover.records import Now, Record

CHUNK = 16
"""Packets handed to the medium before the devices are looked at again (about 0.2 ms)."""
DRAIN_MOST = 2000
READ_OCTETS = 2048
BEHIND_NS = 10_000_000
"""A release later than this makes the interval "behind": the link was then slower than the model says."""
ERRORS_KEPT = 20_000
PR_SET_TIMERSLACK = 29


def hurry() -> bool:
    """Real-time priority and exact timers for this process. False: not permitted, it runs at ordinary priority."""
    # the kernel may otherwise wake us up to 50 us late
    ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1000)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except PermissionError:
        return False
    return True


class Port(NamedTuple):
    """One host as the relay sees it. tap: knows when the kernel sent a probe."""

    name: str
    address: str
    tun_fd: int
    tap: Tap | None = None


class Packet:
    """What travels through the medium as a tag."""

    __slots__ = ("data", "mono_ns", "sender", "sent_ns", "wall_ns")

    def __init__(self, data: bytes, sender: str, wall_ns: int, mono_ns: int) -> None:
        self.data = data
        self.sender = sender
        self.wall_ns = wall_ns
        self.mono_ns = mono_ns
        self.sent_ns: int | None = None  # CLOCK_REALTIME, where the kernel told


class Link(Protocol):
    """Whatever moves the radio: the channel model over the robot's position, or a replayed recording."""

    def tick(self, medium: Medium, at: Now) -> None:
        """Set the medium's hops as they are now, and show them to the emulated drivers."""
        ...


class Relay:
    """See the module's text. `take` gets truth records (LinkTruth a tick and hop, ProbeTruth a STAMP packet)."""

    def __init__(
        self, medium: Medium, ports: list[Port], link: Link, take: Callable[[Record], None], tick_ns: int = 20_000_000
    ) -> None:
        self.medium = medium
        self.ports = {port.name: port for port in ports}
        self._by_address = {bytes(map(int, port.address.split("."))): port.name for port in ports}
        self._by_fd = {port.tun_fd: port.name for port in ports}
        self.link = link
        self.take = take
        self.tick_ns = tick_ns
        self.unroutable = 0
        self.refused_writes = 0
        self.forwarded = 0
        self._errors_ns: list[int] = []
        self._readers: dict[int, Callable[[], None]] = {}
        self._backlog: deque[Packet] = deque()
        self._stopped = False

    def reader(self, fd: int, callback: Callable[[], None]) -> None:
        """Call back whenever fd is readable."""
        self._readers[fd] = callback

    def stop(self) -> None:
        """Make run() return; safe in a signal handler."""
        self._stopped = True

    def run(self) -> None:
        """Relay until stop()."""
        # a collection over thousands of queued packets would hold them up by milliseconds, and nothing here is cyclic
        gc.collect()
        gc.freeze()
        gc.disable()
        try:
            self._run()
        finally:
            gc.enable()
            gc.unfreeze()

    def _run(self) -> None:
        medium, mono = self.medium, time.monotonic_ns
        fds = [*self._by_fd, *self._readers]
        next_tick = mono()
        wall_minus_mono = time.time_ns() - mono()
        while not self._stopped:
            now_ns = mono()
            if now_ns >= next_tick:
                wall_minus_mono = time.time_ns() - mono()
                self._tick(Now(now_ns + wall_minus_mono, now_ns))
                next_tick += self.tick_ns * max(1, (now_ns - next_tick) // self.tick_ns)
            backlog = self._backlog
            for _ in range(min(len(backlog), CHUNK)):
                self._offer(backlog.popleft())
            fates = medium.advance(mono())
            if fates:
                self._release(fates)
            if backlog:
                wait_s = 0.0
            else:
                due = medium.next_event_ns()
                wait_s = max(0, (next_tick if due is None else min(due, next_tick)) - mono()) / 1e9
            for fd in select.select(fds, (), (), wait_s)[0]:
                sender = self._by_fd.get(fd)
                if sender is None:
                    self._readers[fd]()
                else:
                    self._drain(fd, sender, wall_minus_mono)

    def _drain(self, fd: int, sender: str, wall_minus_mono: int) -> None:
        """Read all there is, and note when: what a packet waits for us afterwards belongs to its true delay."""
        mono, read, append = time.monotonic_ns, os.read, self._backlog.append
        for _ in range(DRAIN_MOST):
            try:
                data = read(fd, READ_OCTETS)
            except BlockingIOError:
                return
            now_ns = mono()
            append(Packet(data, sender, now_ns + wall_minus_mono, now_ns))

    def _offer(self, packet: Packet) -> None:
        # IPv4 only: the receiver is found by its address; 224/4 and broadcasts go to everyone
        data = packet.data
        receiver = self._by_address.get(data[16:20])
        if receiver is None:
            if len(data) < 20 or data[0] >> 4 != 4 or not (data[16] >= 224 or data[19] == 255):
                self.unroutable += 1
                return
            receiver = EVERYONE
        flow = int.from_bytes(data[20:24], "big") ^ data[9]
        if data[9] == UDP and is_probe(data):
            tap = self.ports[packet.sender].tap
            sent_ns = None if tap is None else tap.sent_ns(data)
            if sent_ns is not None:
                packet.sent_ns = sent_ns
        cause = self.medium.offer(packet.mono_ns, packet.sender, receiver, len(data), packet, flow)
        if cause is not None and data[9] == UDP:
            self._probe(packet, None, cause)

    def _release(self, fates: list[Fate]) -> None:
        ports, errors, mono, write = self.ports, self._errors_ns, time.monotonic_ns, os.write
        for packet, receiver, at_ns, _, cause in fates:
            assert isinstance(packet, Packet)
            if cause is not None:
                if packet.data[9] == UDP:
                    self._probe(packet, None, cause)
                continue
            port = ports.get(receiver)
            if port is None:
                continue  # a multicast as the router itself hears it
            # the receiver's kernel stamps the packet while we are still inside write()
            arrives_ns = time.time_ns() if packet.data[9] == UDP else 0
            try:
                write(port.tun_fd, packet.data)
            except OSError:
                self.refused_writes += 1
                continue
            now_ns = mono()
            errors.append(now_ns - at_ns)
            if packet.data[9] == UDP:
                self._probe(packet, arrives_ns - (packet.sent_ns or packet.wall_ns), None)
        self.forwarded += len(fates)

    def _probe(self, packet: Packet, delay_ns: int | None, cause: str | None) -> None:
        truth = probe_truth(packet.data, packet.sender, Now(packet.wall_ns, packet.mono_ns), delay_ns, cause)
        if truth is not None:
            self.take(truth)

    def _tick(self, at: Now) -> None:
        self.link.tick(self.medium, at)
        errors = self._errors_ns
        median = worst = None
        if errors:
            median, worst = median_low(errors[:ERRORS_KEPT]), max(errors)
            self._errors_ns = []
        for hop in self.medium.hops():
            self.take(
                self.medium.truth(
                    hop.sender,
                    hop.receiver,
                    at.wall_ns,
                    at.mono_ns,
                    release_error_median_ns=median,
                    release_error_max_ns=worst,
                    behind=worst is not None and worst > BEHIND_NS,
                )
            )
