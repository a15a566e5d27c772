"""The TCP model over a hand-made network: fixed delay and rate, losses as told."""

import heapq
import itertools

import pytest

from linkrover.emulator.tcp_model import MSS, Acknowledgement, Segment, TcpConnectionModel

MS = 1_000_000


class Pipe:
    """A bottleneck of rate_bps with a bounded queue, then a delay; acknowledgements come back after the delay."""

    def __init__(self, rate_bps=20e6, delay_ns=10 * MS, queue=60):
        self.rate_bps, self.delay_ns, self.queue = rate_bps, delay_ns, queue
        self.now_ns = self.free_ns = 0
        self.heap, self.order = [], itertools.count()
        self.lose = lambda segment: False
        self.up = True
        self.dropped = 0

    def at(self, due_ns, work):
        heapq.heappush(self.heap, (due_ns, next(self.order), work))

    def offer(self, sender, receiver, octets, tag, flow):
        if not self.up:
            return False
        if isinstance(tag, Acknowledgement):
            self.at(self.now_ns + self.delay_ns, lambda now: tag.connection.acknowledged(tag, now))
            return True
        waiting = (self.free_ns - self.now_ns) * self.rate_bps / 8e9 / 1500
        if waiting >= self.queue or self.lose(tag):
            self.dropped += 1
            return False
        self.free_ns = max(self.free_ns, self.now_ns) + int(octets * 8e9 / self.rate_bps)
        self.at(self.free_ns + self.delay_ns, lambda now: self.deliver(tag, now))
        return True

    def deliver(self, segment, now_ns):
        assert isinstance(segment, Segment)
        segment.connection.arrived(segment, now_ns)
        segment.connection.acknowledge()

    def run(self, until_ns):
        while self.heap and self.heap[0][0] <= until_ns:
            self.now_ns, _, work = heapq.heappop(self.heap)
            work(self.now_ns)
        self.now_ns = until_ns


def bulk(pipe, seconds):
    got = []
    connection = TcpConnectionModel(pipe, "a", "b", 1, lambda meta, now: got.append((meta, now)))
    for index in range(10_000):
        connection.write(10 * MSS, index, 0)
    pipe.run(round(seconds * 1e9))
    return connection, got


def test_a_bulk_transfer_fills_the_bottleneck_within_8_percent():
    connection, got = bulk(Pipe(), 20)
    assert len(got) * 10 * MSS * 8 / 20 == pytest.approx(20e6 * MSS / 1500, rel=0.08)
    assert connection.retransmits > 0


def test_messages_arrive_whole_in_order_and_once_under_random_loss():
    pipe = Pipe(queue=10_000)
    pipe.lose = lambda segment: hash((segment.index, segment.turn)) % 50 == 0
    connection, got = bulk(pipe, 20)
    assert [meta for meta, _ in got] == list(range(len(got)))
    assert len(got) > 100
    assert connection.retransmits >= pipe.dropped - 5


def test_an_outage_lasts_longer_for_the_application_by_the_exponential_back_off():
    pipe = Pipe()
    connection, got = bulk(pipe, 2)
    before = len(got)
    pipe.up = False
    pipe.run(12 * 1000 * MS)
    timeouts = connection.timeouts
    assert 4 <= timeouts <= 8  # 0.2, 0.4, 0.8, 1.6, 3.2 s ... of back-off
    pipe.up = True
    pipe.run(40 * 1000 * MS)
    resumed = next(now for _, now in got[before + 5 :] if now > 12_000 * MS)
    assert 12_000 * MS < resumed < 25_000 * MS
    assert [meta for meta, _ in got] == list(range(len(got)))


def test_what_waits_is_asked_for_again_when_little_is_left_to_send():
    pipe = Pipe()
    asked = []
    connection = TcpConnectionModel(pipe, "a", "b", 1, lambda meta, now: None, lambda: asked.append(pipe.now_ns))
    connection.write(200 * MSS, "big", 0)
    assert not asked
    pipe.run(1_000 * MS)
    assert asked
