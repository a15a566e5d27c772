"""One directed hop: its queue, what is being repeated, its rate controller, and its running truth."""

from __future__ import annotations

import math
import random
from statistics import median_low

from linkrover.radio import mcs as phy
from linkrover.records import LinkTruth

from .medium_config import MediumConfig, NodeConfig
from .queue import DropTail, FairCoDel, Packet, Queue
from .rate_control import RateController

SAMPLE_FRAMES = 4  # so long are aggregates that try another rate


class Cause:
    """Why a packet was dropped."""

    QUEUE = "queue"
    RETRIES = "retries"
    UNASSOCIATED = "unassociated"


class Hop:
    """See the module's text; the medium is the only writer. Counters are running totals."""

    def __init__(self, sender: str, receiver: str, config: MediumConfig, node: NodeConfig, rng: random.Random) -> None:
        self.sender = sender
        self.receiver = receiver
        self._config = config
        self._rng = rng
        queue_class = FairCoDel if node.queue == "fair" else DropTail
        self.queue: Queue = queue_class(node.queue_packets, node.queue_octets)
        self.pending: list[Packet] = []  # sent, failed, to be sent again; in order of sequence
        self.held: list[Packet] = []  # received, but an older one is still missing
        self.down = False
        self.rssi_dbm = -50.0
        self.snr_db = self.rssi_dbm - config.noise_dbm
        self.distance_m = 0.0
        self.walls = 0
        self._sequence = 0
        count = config.max_mcs + 1
        self.rates_bps = [phy.rate_bps(index, config.width_mhz, config.streams) for index in range(count)]
        self._penalty_db = config.implementation_loss_db + phy.required_snr_shift_db(config.streams)
        self._bits_per_symbol = [rate * phy.SYMBOL_NS / 1e9 for rate in self.rates_bps]
        budget_ns = config.txop_limit_ns - config.preamble_ns
        self._octet_limit = [min(config.max_aggregate_octets, int(budget_ns * rate / 8e9)) for rate in self.rates_bps]
        overhead_ns = config.difs_ns + config.cw_min * config.slot_ns // 2 + config.preamble_ns + 60_000
        self.rate = (
            RateController(self.rates_bps, rng, overhead_ns=overhead_ns)
            if config.fixed_mcs is None
            else FixedRate(config.fixed_mcs)
        )
        self.offered_packets = self.offered_octets = 0
        self.delivered_packets = self.delivered_octets = 0
        self.dropped_queue = self.dropped_retries = self.dropped_unassociated = 0
        self.retries = 0
        self.airtime_ns = 0
        self.delays_ns: list[int] = []
        self._truth_ns: int | None = None

    # ---- sending

    def aggregate(self, mcs: int, now_ns: int) -> list[Packet]:
        """Takes packets for one A-MPDU: first those to be repeated, then new ones, within all limits."""
        config = self._config
        limit = self._octet_limit[mcs]
        extra = config.overhead_octets + 4
        room = min(config.max_subframes, SAMPLE_FRAMES) if self.rate.sampling else config.max_subframes
        packets: list[Packet] = []
        size = 0
        if self.pending:
            packets = self.pending[:room]
            for index, packet in enumerate(packets):
                size += packet.octets + extra
                if size > limit and index:
                    del packets[index:]
                    size -= packet.octets + extra
                    break
            rest = self.pending[len(packets) :]
            first = self.pending[0].sequence
            self.pending = rest
            if rest:
                return packets
            room = min(room, 64 - (self._sequence - first))  # the block ack window
        pop = self.queue.pop
        while len(packets) < room:
            fresh = pop(now_ns)
            if fresh is None:
                break
            size += fresh.octets + extra
            if size > limit and packets:
                self.queue.unpop(fresh)
                break
            fresh.sequence = self._sequence
            self._sequence += 1
            packets.append(fresh)
        return packets

    def frame_ns(self, packets: list[Packet], mcs: int) -> int:
        """Airtime of preamble and data."""
        config = self._config
        if mcs < 0:
            return config.basic_airtime_ns(packets[0].octets + config.overhead_octets)
        extra = config.overhead_octets
        if len(packets) == 1:
            octets = packets[0].octets + extra
        else:
            octets = sum((p.octets + extra + 7) & ~3 for p in packets)  # delimiter 4, padded to 4
        symbols = -(-(octets * 8 + 22) // self._bits_per_symbol[mcs])
        return config.preamble_ns + int(symbols) * phy.SYMBOL_NS

    def answer_ns(self, count: int, mcs: int) -> int:
        """ACK (14 octets) or block ack (32 octets) at the legacy rate that goes with the MCS."""
        rate = 6e6 if mcs == 0 else 12e6 if mcs <= 2 else 24e6
        return phy.legacy_airtime_ns(14 if count == 1 else 32, rate)

    def put_back(self, packets: list[Packet]) -> None:
        """Failed packets, in order, ahead of what is still pending."""
        self.pending = packets + self.pending

    def clear(self) -> list[Packet]:
        """All packets of the hop, which forgets them. What was received out of order is not among them."""
        out = self.pending + self.queue.clear()
        self.pending = []
        return out

    # ---- receiving

    def effective_snr_db(self) -> float:
        """SNR of this transmission after the receiver's losses, with the per-transmission fading if configured."""
        snr = self.snr_db - self._penalty_db
        m = self._config.fading_m
        if m is not None:
            snr += 10.0 * math.log10(max(1e-9, self._rng.gammavariate(m, 1.0 / m)))
        return snr

    def receive(self, packets: list[Packet], mcs: int) -> tuple[list[Packet], list[Packet]]:
        """Which came through, which did not."""
        slope = phy.log_success(mcs, self.effective_snr_db()) / phy.REFERENCE_OCTETS
        if slope > -1e-9:
            return packets, []
        random_ = self._rng.random
        passed: list[Packet] = []
        failed: list[Packet] = []
        extra = self._config.overhead_octets
        size = -1
        chance = 0.0
        for packet in packets:
            if packet.octets != size:
                size = packet.octets
                chance = math.exp(slope * (size + extra))
            (passed if random_() < chance else failed).append(packet)
        return passed, failed

    def in_order(self, passed: list[Packet]) -> list[Packet]:
        """What the receiver's reordering buffer lets go: nothing behind a packet that is still to be repeated."""
        if self.held:
            passed = sorted(self.held + passed, key=lambda p: p.sequence)
            self.held = []
        if not self.pending:
            return passed
        first = self.pending[0].sequence
        for index, packet in enumerate(passed):
            if packet.sequence > first:
                self.held = passed[index:]
                return passed[:index]
        return passed

    def hears_basic(self, octets: int) -> bool:
        """Whether one frame at the basic rate comes through: like MCS 0, and 3 dB better for DSSS at 2.4 GHz."""
        bonus = 3.0 if self._config.band_ghz == 2.4 else 0.0
        snr = self.effective_snr_db() + phy.required_snr_shift_db(self._config.streams) + bonus
        return self._rng.random() < math.exp(phy.log_success(0, snr) * octets / phy.REFERENCE_OCTETS)

    # ---- truth

    def truth(
        self,
        wall_ns: int,
        mono_ns: int,
        *,
        associated: bool,
        release_error_median_ns: int | None,
        release_error_max_ns: int | None,
        behind: bool,
    ) -> LinkTruth:
        """Record of the hop; the delays seen since the last one are taken out."""
        delays, self.delays_ns = self.delays_ns, []
        interval_ns = 0 if self._truth_ns is None else mono_ns - self._truth_ns
        self._truth_ns = mono_ns
        return LinkTruth(
            wall_ns=wall_ns,
            mono_ns=mono_ns,
            hop=f"{self.sender}>{self.receiver}",
            interval_ns=interval_ns,
            distance_m=self.distance_m,
            walls=self.walls,
            rssi_dbm=self.rssi_dbm,
            snr_db=self.snr_db,
            mcs=self.rate.best if associated else None,
            associated=associated,
            offered_packets=self.offered_packets,
            offered_bytes=self.offered_octets,
            delivered_packets=self.delivered_packets,
            delivered_bytes=self.delivered_octets,
            dropped_queue=self.dropped_queue,
            dropped_retries=self.dropped_retries,
            dropped_unassociated=self.dropped_unassociated,
            retries=self.retries,
            airtime_ns=self.airtime_ns,
            queue_packets=self.queue.packets + len(self.pending),
            queue_bytes=self.queue.octets + sum(p.octets for p in self.pending),
            delay_median_ns=median_low(delays) if delays else None,
            delay_max_ns=max(delays) if delays else None,
            release_error_median_ns=release_error_median_ns,
            release_error_max_ns=release_error_max_ns,
            behind=behind,
        )


class FixedRate:
    """Always the same scheme (for checks against theory)."""

    sampling = False

    def __init__(self, mcs: int) -> None:
        self.best = mcs

    def choose(self, retries: int) -> int:  # noqa: ARG002 - same interface as RateController
        """The scheme."""
        return self.best

    def report(self, now_ns: int, mcs: int, attempts: int, successes: int) -> None:
        """Learns nothing."""
