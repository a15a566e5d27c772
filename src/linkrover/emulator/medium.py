"""One shared half-duplex radio channel: who sends when, what comes through, how long it takes.

The medium knows no clock, socket or file: it is told the time. The real-time relay and the virtual-time simulation
use this same object.

    medium = Medium(MediumConfig(band_ghz=5.0), access_point="station", stations=("robot",), seed=1)
    medium.set_link("robot", "station", rssi_dbm=-55.0, distance_m=4.0)      # both directions at 10 to 50 Hz,
    medium.set_link("station", "robot", rssi_dbm=-55.4, distance_m=4.0)      # from channel.Channel or a replay

    cause = medium.offer(now_ns, "robot", "station", 1500, tag=packet)       # None = accepted, else why it is gone
    due_ns = medium.next_event_ns()                                          # wake up then (None: nothing to do)
    for fate in medium.advance(now_ns):                                      # all that happened until now_ns
        if fate.cause is None:
            ...  # hand fate.tag to fate.receiver; it arrived at fate.at_ns (<= now_ns), fate.delay_ns after offer
        else:
            ...  # dropped: fate.cause, a value of Cause
    record = medium.truth("robot", "station", wall_ns, mono_ns)              # records.LinkTruth, cumulative

Rules: now_ns never goes back (an earlier one counts as the latest seen). A packet that offer() refused appears in no
later fate; an accepted one appears in exactly one fate (a multicast in one per receiver). Packets between two
stations (neither is the access point) cross the air twice, through the access point. `receiver=EVERYONE` is a
multicast. Call advance() after set_link()/offer() before trusting next_event_ns() to have moved.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterable
from typing import NamedTuple

from linkrover.errors import ConfigError
from linkrover.records import LinkTruth

from .association import Association
from .contention import FAR, Contention, Sender
from .hop import Cause, Hop
from .medium_config import MediumConfig, NodeConfig
from .queue import Packet

__all__ = ["EVERYONE", "Cause", "Fate", "Medium", "MediumConfig", "NodeConfig"]

EVERYONE = "*"


class Fate(NamedTuple):
    """What became of an accepted packet. cause None: it reached `receiver` at at_ns, delay_ns after it was offered."""

    tag: object
    receiver: str
    at_ns: int
    delay_ns: int
    cause: str | None


class _Transmission:
    __slots__ = ("begin_ns", "collided", "hop", "mcs", "packets")

    def __init__(self, hop: Hop, packets: list[Packet], mcs: int, begin_ns: int) -> None:
        self.hop = hop
        self.packets = packets
        self.mcs = mcs
        self.begin_ns = begin_ns
        self.collided = False


class Medium:
    """See the module's text. Raises ConfigError for names or values that cannot be used."""

    def __init__(
        self,
        config: MediumConfig,
        *,
        access_point: str,
        stations: Iterable[str],
        seed: int = 0,
        nodes: dict[str, NodeConfig] | None = None,
        start_ns: int = 0,
    ) -> None:
        self.config = config
        self.access_point = access_point
        self.stations = tuple(stations)
        names = (access_point, *self.stations)
        if len(set(names)) != len(names) or EVERYONE in names or not self.stations:
            raise ConfigError(f"nodes {', '.join(names)}: need one access point, one or more stations, no name twice")
        for name in nodes or {}:
            if name not in names:
                raise ConfigError(f"nodes.{name}: no such node; there are {', '.join(names)}")
        self._rng = random.Random(seed)
        self._now = start_ns
        self._out: list[Fate] = []
        self._contention = Contention(config, random.Random(self._rng.random()), start_ns)
        self._senders = self._contention.senders
        self._hops: dict[tuple[str, str], Hop] = {}
        for name in names:
            node = (nodes or {}).get(name, NodeConfig())
            self._senders[name] = Sender(name, node.bus_bps, config.cw_min)
        for station in self.stations:
            for sender, receiver in ((station, access_point), (access_point, station)):
                self._add_hop(sender, receiver, (nodes or {}).get(sender, NodeConfig()))
        self._multicast = self._add_hop(access_point, EVERYONE, (nodes or {}).get(access_point, NodeConfig()))
        self._association = {
            name: Association(name, config.association, random.Random(self._rng.random()), start_ns)
            for name in self.stations
        }
        self._on_air: list[_Transmission] = []
        self._end_ns = FAR
        self._defer_ns = 0
        self._timer_ns = FAR
        self._beacon_ns = start_ns + config.association.beacon_ns
        self._renew_timer()
        self.own_airtime_ns = 0
        self.collisions = 0

    def _add_hop(self, sender: str, receiver: str, node: NodeConfig) -> Hop:
        hop = Hop(sender, receiver, self.config, node, random.Random(self._rng.random()))
        self._hops[sender, receiver] = hop
        self._senders[sender].hops.append(hop)
        return hop

    # ---- what the outside says

    @property
    def others_airtime_ns(self) -> int:
        """Air time that other users of the channel took so far (while ours looked)."""
        return self._contention.others_airtime_ns

    def set_link(self, sender: str, receiver: str, *, rssi_dbm: float, distance_m: float = 0.0, walls: int = 0) -> None:
        """The mean received power of one directed hop from now on (dBm, distance and walls only for the truth).

        Raises:
            ConfigError: there is no such hop, or rssi_dbm is not a number.
        """
        hop = self.hop(sender, receiver)
        if not math.isfinite(rssi_dbm):
            raise ConfigError(f"rssi_dbm = {rssi_dbm}: must be a finite number of dBm")
        hop.rssi_dbm = rssi_dbm
        hop.snr_db = rssi_dbm - self.config.noise_dbm
        hop.distance_m = distance_m
        hop.walls = walls

    def limit(self, node: str, bus_bps: float | None) -> None:
        """What the node can send from now on, as NodeConfig.bus_bps (a replayed drive's throughput)."""
        self._senders[node].bus_bps = bus_bps

    def hop(self, sender: str, receiver: str) -> Hop:
        """The directed hop, with its counters.

        Raises:
            ConfigError: there is no such hop.
        """
        found = self._hops.get((sender, receiver))
        if found is None:
            there = ", ".join(f"{a}>{b}" for a, b in self._hops)
            raise ConfigError(f"hop {sender}>{receiver}: no such hop; there are {there}")
        return found

    def hops(self) -> tuple[Hop, ...]:
        """All directed unicast hops."""
        return tuple(hop for (_, receiver), hop in self._hops.items() if receiver != EVERYONE)

    def route(self, source: str, destination: str) -> tuple[Hop, ...]:
        """The hops a packet takes."""
        if self.access_point in (source, destination):
            return (self.hop(source, destination),)
        return (self.hop(source, self.access_point), self.hop(self.access_point, destination))

    def associated(self, station: str) -> bool:
        """Whether the station is associated now; the access point always is."""
        return station == self.access_point or self._association[station].associated

    def association(self, station: str) -> Association:
        """The station's association: losses so far, when it was lost."""
        return self._association[station]

    def offer(self, now_ns: int, sender: str, receiver: str, octets: int, tag: object, flow: int = 0) -> str | None:
        """A node hands the medium a packet. Returns None, or the Cause why it was dropped at once.

        flow tells flows apart where the queue is fair; receiver may be EVERYONE.

        Raises:
            ConfigError: no such node.
        """
        if now_ns > self._now:
            if self._next_ns() <= now_ns:
                self._run(now_ns)
            self._now = now_ns
        else:
            now_ns = self._now
        multicast = receiver == EVERYONE
        if sender == self.access_point:
            hop = self._hops.get((sender, receiver))
        else:
            hop = self._hops.get((sender, self.access_point))
            if not multicast and (self.access_point, receiver) not in self._hops and receiver != self.access_point:
                hop = None
        if hop is None:
            raise ConfigError(f"offer {sender}>{receiver}: nodes are {self.access_point}, {', '.join(self.stations)}")
        return self._enqueue(hop, Packet(tag, octets, sender, receiver, flow, now_ns), now_ns)

    def next_event_ns(self) -> int | None:
        """When advance() has to be called at the latest; None only when nothing will ever happen by itself."""
        due = self._next_ns()
        return None if due >= FAR else due

    def advance(self, now_ns: int) -> list[Fate]:
        """Let everything happen that is due by now_ns, and return the fates since the last call."""
        self._run(now_ns)
        self._now = max(self._now, now_ns)
        if not self._out:
            return []
        out, self._out = self._out, []
        return out

    def advance_to_fate(self, limit_ns: int) -> tuple[int, list[Fate]]:
        """Like advance(limit_ns), but stops at the first event that gives fates: (time reached, fates)."""
        while not self._out:
            due = self._next_ns()
            if due > limit_ns:
                self._now = max(self._now, limit_ns)
                break
            self._event(due)
        out, self._out = self._out, []
        return self._now, out

    def truth(
        self,
        sender: str,
        receiver: str,
        wall_ns: int,
        mono_ns: int,
        *,
        release_error_median_ns: int | None = None,
        release_error_max_ns: int | None = None,
        behind: bool = False,
    ) -> LinkTruth:
        """State and running counters of one hop; delays are of the time since the last call."""
        hop = self.hop(sender, receiver)
        station = sender if sender != self.access_point else receiver
        return hop.truth(
            wall_ns,
            mono_ns,
            associated=self.associated(station),
            release_error_median_ns=release_error_median_ns,
            release_error_max_ns=release_error_max_ns,
            behind=behind,
        )

    # ---- the queue side

    def _enqueue(self, hop: Hop, packet: Packet, now_ns: int) -> str | None:
        hop.offered_packets += 1
        hop.offered_octets += packet.octets
        packet.hop_at_ns = now_ns
        if hop.down:
            hop.dropped_unassociated += 1
            return Cause.UNASSOCIATED
        gone = hop.queue.push(packet)
        if gone is not None:
            hop.dropped_queue += 1
            if gone is packet:
                return Cause.QUEUE
            self._fate(gone, now_ns, Cause.QUEUE)
        sender = self._senders[hop.sender]
        if not sender.backlogged:
            sender.backlogged = True
            sender.since_ns = now_ns
            if not self._on_air:
                self._contention.catch_up(now_ns)
        return None

    def _fate(self, packet: Packet, now_ns: int, cause: str) -> None:
        """A dropped packet. A multicast that dies before the access point repeats it is lost to all."""
        delay_ns = now_ns - packet.at_ns
        if packet.destination != EVERYONE:
            self._out.append(Fate(packet.tag, packet.destination, now_ns, delay_ns, cause))
            return
        for name in self.stations:
            if name != packet.origin:
                self._out.append(Fate(packet.tag, name, now_ns, delay_ns, cause))

    # ---- the channel side

    def _next_ns(self) -> int:
        due = self._timer_ns
        if self._on_air:
            return min(due, self._end_ns)
        return min(due, self._contention.due_ns())

    def _run(self, until_ns: int) -> None:
        while True:
            due = self._next_ns()
            if due > until_ns:
                return
            self._event(due)

    def _event(self, due: int) -> None:
        self._now = max(self._now, due)
        if self._on_air and self._end_ns <= due:
            self._finish(due)
        elif self._timer_ns <= due:
            self._timers(due)
        elif self._contention.burst_ns <= due:
            self._contention.burst(due)
        else:
            self._access(due)

    def _access(self, now_ns: int) -> None:
        longest = 0
        config = self.config
        for sender in self._contention.winners(now_ns):
            hop = sender.pick()
            if hop is None:
                sender.backlogged = False
                continue
            sent = self._assemble(hop, now_ns)
            if sent is None:
                sender.look()
                continue
            octets = sum(p.octets for p in sent.packets)
            frame_ns = hop.frame_ns(sent.packets, sent.mcs)
            answer_ns = 0 if hop.receiver == EVERYONE else config.sifs_ns + hop.answer_ns(len(sent.packets), sent.mcs)
            total = frame_ns + answer_ns
            hop.airtime_ns += total
            self._on_air.append(sent)
            if sender.bus_bps is not None:
                sender.ready_ns = now_ns + int(octets * 8e9 / sender.bus_bps)
            longest = max(longest, total)
        if not self._on_air:
            return
        if len(self._on_air) > 1:
            self.collisions += 1
            for sent in self._on_air:
                sent.collided = True
        self.own_airtime_ns += longest
        self._end_ns = now_ns + longest

    def _assemble(self, hop: Hop, now_ns: int) -> _Transmission | None:
        if hop.receiver == EVERYONE:
            packet = hop.queue.pop(now_ns)
            packets = [packet] if packet is not None else []
            mcs = -1
        else:
            retries = hop.pending[0].retries if hop.pending else 0
            mcs = hop.rate.choose(retries)
            packets = hop.aggregate(mcs, now_ns)
        for dropped in hop.queue.take_dropped():
            hop.dropped_queue += 1
            self._fate(dropped, now_ns, Cause.QUEUE)
        return _Transmission(hop, packets, mcs, now_ns) if packets else None

    def _finish(self, now_ns: int) -> None:
        on_air, self._on_air = self._on_air, []
        self._end_ns = FAR
        self._contention.free_ns = now_ns + self._defer_ns
        self._defer_ns = 0
        for sent in on_air:
            if sent.mcs < 0:
                self._finish_multicast(sent, now_ns)
                ok = True
            else:
                ok = self._finish_unicast(sent, now_ns)
            self._contention.sent(self._senders[sent.hop.sender], ok, now_ns)

    def _finish_unicast(self, sent: _Transmission, now_ns: int) -> bool:
        hop = sent.hop
        packets = sent.packets
        passed, failed = ([], packets) if sent.collided else hop.receive(packets, sent.mcs)
        hop.rate.report(now_ns, sent.mcs, len(packets), len(passed))
        given_up = 0
        if failed:
            given_up = self._repeat(hop, failed, now_ns)
        if passed or hop.held:
            self._deliver(hop, hop.in_order(passed), now_ns)
        if failed or passed:
            station = hop.sender if hop.sender != self.access_point else hop.receiver
            if self._association[station].frame(now_ns, given_up, len(passed)):
                self._disconnected(station, now_ns)
        return bool(passed)

    def _repeat(self, hop: Hop, failed: list[Packet], now_ns: int) -> int:
        limit = self.config.retry_limit
        again: list[Packet] = []
        given_up = 0
        for packet in failed:
            if packet.retries >= limit:
                given_up += 1
                hop.dropped_retries += 1
                self._fate(packet, now_ns, Cause.RETRIES)
            else:
                packet.retries += 1
                hop.retries += 1
                again.append(packet)
        hop.put_back(again)
        return given_up

    def _deliver(self, hop: Hop, packets: list[Packet], now_ns: int) -> None:
        receiver = hop.receiver
        out = self._out
        octets = 0
        delays = hop.delays_ns
        for packet in packets:
            octets += packet.octets
            delays.append(now_ns - packet.hop_at_ns)
            if packet.destination == receiver:
                out.append(Fate(packet.tag, receiver, now_ns, now_ns - packet.at_ns, None))
            else:
                self._forward(packet, now_ns)
        hop.delivered_packets += len(packets)
        hop.delivered_octets += octets

    def _forward(self, packet: Packet, now_ns: int) -> None:
        """The access point passes on what is not for itself alone."""
        if packet.destination == EVERYONE:
            self._out.append(Fate(packet.tag, self.access_point, now_ns, now_ns - packet.at_ns, None))
            following = self._multicast
        else:
            following = self._hops[self.access_point, packet.destination]
        again = Packet(packet.tag, packet.octets, packet.origin, packet.destination, packet.flow, packet.at_ns)
        cause = self._enqueue(following, again, now_ns)
        if cause is not None:
            self._fate(again, now_ns, cause)

    def _finish_multicast(self, sent: _Transmission, now_ns: int) -> None:
        """Basic rate, no acknowledgement, no retry: each station hears it or not."""
        hop = sent.hop
        packet = sent.packets[0]
        hop.delays_ns.append(now_ns - packet.hop_at_ns)
        heard = 0
        for name in self.stations:
            if name == packet.origin:
                continue
            cause: str | None = None
            if not self._association[name].associated:
                cause = Cause.UNASSOCIATED
            elif sent.collided or not self._hops[self.access_point, name].hears_basic(packet.octets):
                cause = Cause.RETRIES
            else:
                heard += 1
            self._out.append(Fate(packet.tag, name, now_ns, now_ns - packet.at_ns, cause))
        if heard:
            hop.delivered_packets += 1
            hop.delivered_octets += packet.octets
        else:
            hop.dropped_retries += 1

    # ---- beacons and association

    def _renew_timer(self) -> None:
        self._timer_ns = self._beacon_ns
        for association in self._association.values():
            if association.due_ns is not None:
                self._timer_ns = min(self._timer_ns, association.due_ns)

    def _timers(self, now_ns: int) -> None:
        if self._beacon_ns <= now_ns:
            self._beacon(now_ns)
            self._beacon_ns += self.config.association.beacon_ns
        for name, association in self._association.items():
            if association.due_ns is None or association.due_ns > now_ns:
                continue
            if association.associated:
                association.drop_out(now_ns)
                self._disconnected(name, now_ns)
            else:
                reachable = self._hops[self.access_point, name].hears_basic(300) and self._hops[
                    name, self.access_point
                ].hears_basic(300)
                if association.step(now_ns, reachable):
                    self._set_down(name, False)
        self._renew_timer()

    def _beacon(self, now_ns: int) -> None:
        airtime_ns = self.config.beacon_airtime_ns
        self.own_airtime_ns += airtime_ns
        if self._on_air:
            self._defer_ns += airtime_ns
        else:
            self._contention.catch_up(now_ns)
            self._contention.occupy(max(now_ns, self._contention.free_ns), airtime_ns)
        for name, association in self._association.items():
            if association.beacon(now_ns, self._hops[self.access_point, name].hears_basic(250)):
                self._disconnected(name, now_ns)

    def _disconnected(self, station: str, now_ns: int) -> None:
        self._set_down(station, True)
        for key in ((station, self.access_point), (self.access_point, station)):
            hop = self._hops[key]
            for packet in hop.clear():
                hop.dropped_unassociated += 1
                self._fate(packet, now_ns, Cause.UNASSOCIATED)
            self._senders[key[0]].look()
        self._renew_timer()

    def _set_down(self, station: str, down: bool) -> None:
        self._hops[station, self.access_point].down = down
        self._hops[self.access_point, station].down = down
