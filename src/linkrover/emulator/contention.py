"""Who may send next: IEEE 802.11 DCF among our senders, and the bursts of the channel's other users."""

from __future__ import annotations

import random

from .hop import Hop
from .medium_config import MediumConfig

CCA_NS = 3_000  # senders that begin within this time of each other do not hear each other: a collision
FAR = 1 << 62


class Sender:
    """A node as a contender. since_ns: when it got something to send. ready_ns: when its bus has the next packets."""

    __slots__ = ("backlogged", "backoff", "bus_bps", "cw", "hops", "name", "ready_ns", "since_ns", "turn")

    def __init__(self, name: str, bus_bps: float | None, cw: int) -> None:
        self.name = name
        self.hops: list[Hop] = []
        self.turn = 0
        self.cw = cw
        self.backoff = 0
        self.since_ns = 0
        self.ready_ns = 0
        self.bus_bps = bus_bps
        self.backlogged = False

    def pick(self) -> Hop | None:
        """Round robin over its hops that have something to send."""
        hops = self.hops
        count = len(hops)
        for step in range(count):
            hop = hops[(self.turn + step) % count]
            if hop.pending or hop.queue.packets:
                self.turn = (self.turn + step + 1) % count
                return hop
        return None

    def look(self) -> None:
        """Whether anything is left to send."""
        self.backlogged = any(hop.pending or hop.queue.packets for hop in self.hops)


class Contention:
    """The idle channel: from free_ns on nobody sends. Senders keep what is left of their back-off when one of them, a
    beacon or a burst of others takes it. Other users are an M/M/1 stream of bursts that go before ours.
    """

    def __init__(self, config: MediumConfig, rng: random.Random, start_ns: int) -> None:
        self.senders: dict[str, Sender] = {}
        self.free_ns = start_ns
        self.others_airtime_ns = 0
        self._difs_ns = config.difs_ns
        self._slot_ns = config.slot_ns
        self._config = config
        self._rng = rng
        self._burst_mean_ns = config.others_burst_ns
        share = config.others_share
        self._burst_gap_ns = self._burst_mean_ns / share if share > 0 else 0.0
        self.burst_ns = start_ns + int(rng.expovariate(1.0) * self._burst_gap_ns) if share > 0 else FAR

    def due_ns(self) -> int:
        """When the channel is next taken, by one of ours or by a burst that hinders one of ours."""
        access = FAR
        for sender in self.senders.values():
            if sender.backlogged:
                at = self._access_ns(sender)
                access = min(access, at)
        if access < FAR and self.burst_ns < access:
            return max(self.burst_ns, self.free_ns)
        return access

    def _access_ns(self, sender: Sender) -> int:
        at = self.free_ns + self._difs_ns + sender.backoff * self._slot_ns
        return max(at, sender.since_ns, sender.ready_ns)

    def winners(self, now_ns: int) -> list[Sender]:
        """Who begins to send now: more than one is a collision."""
        found = [s for s in self.senders.values() if s.backlogged and self._access_ns(s) <= now_ns + CCA_NS]
        self._count_down(now_ns, found)
        return found

    def sent(self, sender: Sender, ok: bool, now_ns: int) -> None:
        """A transmission has ended: the window shrinks or doubles, a back-off is drawn."""
        config = self._config
        sender.cw = config.cw_min if ok else min(config.cw_max, 2 * sender.cw + 1)
        sender.backoff = int(self._rng.random() * (sender.cw + 1)) if config.random_backoff else sender.cw // 2
        sender.look()
        if sender.backlogged:
            sender.since_ns = now_ns

    def catch_up(self, now_ns: int) -> None:
        """Bursts that came while nobody of ours wanted to send."""
        while self.burst_ns <= now_ns:
            self.burst(max(self.burst_ns, self.free_ns))

    def burst(self, begin_ns: int) -> None:
        """Other users take the channel."""
        length = int(self._rng.expovariate(1.0) * self._burst_mean_ns)
        self.occupy(begin_ns, length)
        self.others_airtime_ns += length
        self.burst_ns += max(1, int(self._rng.expovariate(1.0) * self._burst_gap_ns))

    def occupy(self, begin_ns: int, length_ns: int) -> None:
        """Somebody else takes the channel at begin_ns."""
        self._count_down(begin_ns, None)
        self.free_ns = begin_ns + length_ns

    def _count_down(self, begin_ns: int, but: list[Sender] | None) -> None:
        slots = (begin_ns - self.free_ns - self._difs_ns) // self._slot_ns
        if slots <= 0:
            return
        for sender in self.senders.values():
            if but is None or sender not in but:
                sender.backoff = max(0, sender.backoff - slots)
