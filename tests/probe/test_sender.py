import errno
import random
import socket
import struct
import time

import pytest

from linkrover.errors import ConfigError
from linkrover.loop import Loop
from linkrover.probe import stamps
from linkrover.probe.reflector import StampReflector
from linkrover.probe.sender import StampSender
from linkrover.probe.summary import settled, summarise
from linkrover.records import ClockSource, ProbeState

from .exchange import run_until, running_reflector, udp

KEY = b"a shared secret of the two ends"
MS = 1_000_000


@pytest.fixture
def bench():
    """A loop with what was started on it, stopped at the end."""
    loop = Loop()
    started = []

    def start(thing):
        thing.start()
        started.append(thing)
        return thing

    yield loop, start
    for thing in started:
        thing.stop()
    loop.close()


def finish(loop, sender, timeout_s=20.0):
    run_until(loop, lambda: not sender.sending and sender.in_flight == 0, timeout_s)


@pytest.mark.parametrize(("host", "key", "size"), [("127.0.0.1", None, 0), ("127.0.0.1", KEY, 200), ("::1", None, 900)])
def test_every_probe_to_a_living_reflector_is_answered_with_kernel_stamps(bench, host, key, size):
    loop, start = bench
    reflector = start(StampReflector(loop, host, 0, key=key))
    out = []
    sender = start(
        StampSender(loop, host, reflector.port, on_result=out.append, period_ns=2 * MS, count=200, key=key, size=size)
    )
    finish(loop, sender)
    assert [r.sequence for r in out] == list(range(1, len(out) + 1))
    assert len(out) == 200 - sender.counters.missed_slots or sender.counters.sent == len(out)
    assert {r.state for r in out} == {ProbeState.ANSWERED}
    assert {r.send_clock for r in out} == {ClockSource.KERNEL}
    assert {r.receive_clock for r in out} == {ClockSource.KERNEL}
    assert all(r.t1_ns <= r.t2_ns <= r.t3_ns <= r.t4_ns for r in out), "one clock: the four times are in order"
    assert all(r.rtt_ns == (r.t4_ns - r.t1_ns) - (r.t3_ns - r.t2_ns) > 0 for r in out)
    assert [r.reflector_sequence for r in out] == list(range(len(out)))
    assert out[0].packet_bytes == max(size, 112 if key else 44)
    assert not sender.reflector_stateless


def test_probes_leave_at_the_slots_of_an_absolute_schedule(bench):
    loop, start = bench
    reflector = start(StampReflector(loop, "127.0.0.1", 0))
    out = []
    begin = time.monotonic_ns() + 50 * MS
    sender = StampSender(loop, "127.0.0.1", reflector.port, on_result=out.append, period_ns=10 * MS, count=30)
    sender.start(start_ns=begin)
    finish(loop, sender)
    sender.stop()
    for r in out:
        assert (r.mono_ns - r.lateness_ns - begin) % (10 * MS) == 0
        assert r.lateness_ns >= 0


def test_a_silent_peer_holds_nothing_up_and_each_probe_is_lost_at_its_deadline(bench):
    loop, start = bench
    silent = udp()
    out = []
    sender = start(
        StampSender(
            loop, "127.0.0.1", silent.getsockname()[1], on_result=out.append, period_ns=10 * MS,
            deadline_ns=300 * MS, count=50,
        )
    )  # fmt: skip
    run_until(loop, lambda: sender.in_flight >= 10)
    finish(loop, sender)
    assert sender.counters.sent == len(out)
    assert {r.state for r in out} == {ProbeState.LOST}
    silent.close()


def test_a_refused_port_is_lost_and_said(bench):
    loop, start = bench
    port_holder = udp()
    port = port_holder.getsockname()[1]
    port_holder.close()
    out = []
    sender = start(
        StampSender(loop, "127.0.0.1", port, on_result=out.append, period_ns=5 * MS, deadline_ns=200 * MS, count=20)
    )
    finish(loop, sender)
    assert {r.state for r in out} == {ProbeState.LOST}, "a refusal of one probe must not take the next one with it"
    assert sender.counters.refused > 0
    assert sender.counters.not_sent == 0


def test_a_restarted_peer_is_measured_again(bench):
    loop, start = bench
    first = StampReflector(loop, "127.0.0.1", 0)
    first.start()
    out = []
    sender = start(
        StampSender(loop, "127.0.0.1", first.port, on_result=out.append, period_ns=5 * MS, deadline_ns=200 * MS)
    )
    run_until(loop, lambda: sum(r.state is ProbeState.ANSWERED for r in out) >= 20)
    first.stop()
    run_until(loop, lambda: any(r.state is ProbeState.LOST for r in out))
    second = start(StampReflector(loop, "127.0.0.1", first.port))
    run_until(loop, lambda: second.counters.answered >= 20)
    sender.stop_sending()
    finish(loop, sender)
    assert sender.reflector_restarts == 1
    assert settled(out)[-1].state is ProbeState.ANSWERED


class Relay:
    """Between sender and reflector: may lose, double, hold back or forge packets."""

    def __init__(self, loop, to_port):
        self.front, self.back = udp(), udp()
        self.to = ("127.0.0.1", to_port)
        self.client = None
        self.forward = self.backward = lambda n: "pass"
        self.seen = [0, 0]
        self.held = []
        self.removers = [loop.reader(self.front, self.there), loop.reader(self.back, self.home)]
        self.loop = loop

    @property
    def port(self):
        return self.front.getsockname()[1]

    def stop(self):
        for remove in self.removers:
            remove()
        self.front.close()
        self.back.close()

    def pass_on(self, what, send):
        if what == "double":
            send()
        if what == "hold":
            self.loop.at(time.monotonic_ns() + 30 * MS, send)
        elif what != "lose":
            send()

    def there(self):
        data, self.client = self.front.recvfrom(65_535)
        self.seen[0] += 1
        self.pass_on(self.forward(self.seen[0]), lambda: self.back.sendto(data, self.to))

    def home(self):
        data = self.back.recv(65_535)
        self.seen[1] += 1
        self.pass_on(self.backward(self.seen[1]), lambda: self.front.sendto(data, self.client))


@pytest.fixture
def relayed(bench):
    loop, start = bench
    reflector = start(StampReflector(loop, "127.0.0.1", 0))
    relay = Relay(loop, reflector.port)
    out = []

    def go(count, **options):
        sender = start(
            StampSender(
                loop, "127.0.0.1", relay.port, on_result=out.append, period_ns=10 * MS, deadline_ns=500 * MS,
                count=count, **options,
            )
        )  # fmt: skip
        finish(loop, sender)
        return sender, out

    yield relay, go
    relay.stop()


def test_losses_are_told_by_direction_through_a_real_exchange(relayed):
    relay, go = relayed
    relay.forward = lambda n: "lose" if n in (10, 11, 30) else "pass"
    relay.backward = lambda n: "lose" if n in (20, 21) else "pass"
    _, out = go(60)
    s = summarise(out)
    assert (s.lost, s.lost_forward, s.lost_back, s.lost_unknown) == (5, 3, 2, 0)


def test_duplicates_in_either_direction_and_overtaken_answers_are_seen(relayed):
    relay, go = relayed
    relay.forward = lambda n: "double" if n == 5 else "pass"
    relay.backward = lambda n: "double" if n == 15 else "hold" if n == 25 else "pass"
    sender, out = go(50)
    s = summarise(out)
    assert (s.duplicates, s.lost, sender.counters.duplicates) == (2, 0, 2)
    assert s.reordered == 1


def test_forged_and_damaged_answers_are_counted_and_change_nothing(bench):
    loop, start = bench
    server, stranger = udp(), udp()
    out = []
    sender = start(
        StampSender(loop, "127.0.0.1", server.getsockname()[1], on_result=out.append, period_ns=50 * MS,
                    deadline_ns=2_000 * MS, count=1)
    )  # fmt: skip
    requests = []

    def take():
        requests.append(server.recvfrom(100))

    remove = loop.reader(server, take)
    run_until(loop, lambda: requests)
    request, client = requests[0]
    good = bytes(24) + request[:14] + bytes(6)
    chance = random.Random(3)
    wrong = [
        b"", bytes(40), bytes(44), chance.randbytes(44), chance.randbytes(300),
        bytes(24) + request[:4] + bytes(16),  # right sequence, wrong echoed time
        bytes(14) + b"\xff\xff" + bytes(8) + request[:14] + bytes(6),  # another session
    ]  # fmt: skip
    for data in wrong:
        server.sendto(data, client)
    stranger.sendto(good, client)
    run_until(loop, lambda: sender.counters.unexpected + sender.counters.malformed == 8)
    assert out == []
    assert sender.counters.malformed == 2
    server.sendto(good, client)
    run_until(loop, lambda: out)
    assert out[0].state is ProbeState.ANSWERED
    remove()
    server.close()
    stranger.close()


def test_an_answer_with_a_wrong_hmac_is_counted_and_not_believed(bench):
    loop, start = bench
    reflector = start(StampReflector(loop, "127.0.0.1", 0))  # answers 112 octets too, but without an HMAC
    out = []
    sender = start(
        StampSender(loop, "127.0.0.1", reflector.port, on_result=out.append, key=KEY, count=3, period_ns=5 * MS,
                    deadline_ns=200 * MS)
    )  # fmt: skip
    finish(loop, sender)
    assert sender.counters.unauthenticated == sender.counters.sent
    assert {r.state for r in out} == {ProbeState.LOST}


def test_an_independent_twamp_light_responder_written_from_rfc_5357_is_measured(bench):
    """A stateless responder: it copies our sequence, so losses have no direction."""
    loop, start = bench
    server = udp()
    count = 0

    def respond():
        nonlocal count
        data, client = server.recvfrom(100)
        t2 = time.time_ns()
        count += 1
        if count == 7:
            return

        def stamp(ns):
            return struct.pack(">II", ns // 10**9 + 2_208_988_800, ns % 10**9 * 2**32 // 10**9)

        reply = data[0:4] + stamp(time.time_ns()) + b"\x80\x01" + b"\x00\x00" + stamp(t2)
        reply += data[0:4] + data[4:12] + data[12:14] + b"\x00\x00" + b"\x40"
        server.sendto(reply, client)

    remove = loop.reader(server, respond)
    out = []
    sender = start(
        StampSender(loop, "127.0.0.1", server.getsockname()[1], on_result=out.append, period_ns=10 * MS,
                    deadline_ns=300 * MS, count=20)
    )  # fmt: skip
    finish(loop, sender)
    s = summarise(out)
    assert s.lost == s.lost_unknown == 1
    assert s.answered == sender.counters.sent - 1
    assert sender.reflector_stateless
    remove()
    server.close()


def test_without_kernel_stamps_the_user_clocks_do_and_each_result_says_so(bench, monkeypatch):
    monkeypatch.setattr(stamps, "wants_send_stamps", lambda sock: False)
    loop, start = bench
    reflector = start(StampReflector(loop, "127.0.0.1", 0))
    out = []
    sender = start(StampSender(loop, "127.0.0.1", reflector.port, on_result=out.append, period_ns=5 * MS, count=10))
    finish(loop, sender)
    assert {(r.state, r.send_clock, r.receive_clock) for r in out} == {
        (ProbeState.ANSWERED, ClockSource.USER, ClockSource.USER)
    }
    assert all(r.rtt_ns > 0 for r in out)


def test_a_wall_clock_step_in_the_middle_does_not_reach_the_round_trip(relayed, monkeypatch):
    """The clock is set back by an hour while probe 10's answer is held for 30 ms."""
    relay, go = relayed
    relay.backward = lambda n: "hold" if n == 10 else "pass"
    real_time, real_stamp = time.time_ns, stamps.stamp_of
    step = 3_600 * 10**9

    def back():
        return step if relay.seen[1] >= 10 else 0

    monkeypatch.setattr(time, "time_ns", lambda: real_time() - back())
    monkeypatch.setattr(stamps, "stamp_of", lambda a: None if real_stamp(a) is None else real_stamp(a) - back())
    sender, out = go(20)
    held = next(r for r in out if r.sequence == 10)
    assert 29 * MS < held.rtt_ns < 5_000 * MS
    assert held.receive_clock is ClockSource.USER
    assert sender.counters.clock_steps >= 1
    assert all(0 < r.rtt_ns < 5_000 * MS for r in out)


class RefusingSocket:
    """A socket whose sendto fails as a full or absent interface does."""

    def __init__(self, real, errors):
        self.real, self.errors = real, errors

    def sendto(self, data, address):
        if self.errors:
            raise OSError(self.errors.pop(), "refused")
        return self.real.sendto(data, address)

    def __getattr__(self, name):
        return getattr(self.real, name)


@pytest.mark.parametrize("number", [errno.ENETUNREACH, errno.ENOBUFS, errno.EPERM, errno.ENODEV, errno.EADDRNOTAVAIL])
def test_what_the_local_stack_refuses_is_not_sent_and_the_next_stamps_are_right_again(bench, number):
    loop, start = bench
    reflector = start(StampReflector(loop, "127.0.0.1", 0))
    out = []
    sender = start(StampSender(loop, "127.0.0.1", reflector.port, on_result=out.append, period_ns=5 * MS, count=40))
    run_until(loop, lambda: len(out) >= 10)
    errors = [number] * 7
    opened = sender._open
    sender._sock = RefusingSocket(sender._sock, errors)
    sender._open = lambda endpoint: RefusingSocket(opened(endpoint), errors)
    finish(loop, sender)
    states = [r.state for r in out]
    refused = states.count(ProbeState.NOT_SENT)
    assert refused >= 3
    assert states.count(ProbeState.ANSWERED) == len(out) - refused
    answered = [r for r in out if r.state is ProbeState.ANSWERED]
    assert {r.send_clock for r in answered} == {ClockSource.KERNEL}
    assert all(r.t1_ns <= r.t2_ns for r in answered)
    assert sender.last_error.errno == number


def test_a_name_is_looked_up_beside_the_loop_and_probes_wait_for_it_as_not_sent(bench, monkeypatch):
    loop, start = bench
    reflector = start(StampReflector(loop, "127.0.0.1", 0))
    known = []
    real = socket.getaddrinfo

    def slow(host, *rest, **options):
        if host == "robot.test":
            while not known:
                time.sleep(0.005)
            return real("127.0.0.1", *rest, **options)
        return real(host, *rest, **options)

    monkeypatch.setattr(socket, "getaddrinfo", slow)
    out = []
    start(StampSender(loop, "robot.test", reflector.port, on_result=out.append, period_ns=5 * MS))
    run_until(loop, lambda: len(out) >= 5)
    assert {r.state for r in out} == {ProbeState.NOT_SENT}
    known.append(True)
    run_until(loop, lambda: out[-1].state is ProbeState.ANSWERED)
    assert out[-1].peer == f"robot.test:{reflector.port}"


@pytest.mark.parametrize(
    "options",
    [{"period_ns": 100}, {"period_ns": 2 * 10**9}, {"deadline_ns": 0}, {"size": 43}, {"size": 70_000}, {"dscp": 64},
     {"ssid": 0}, {"size": 44, "key": KEY}],
)  # fmt: skip
def test_values_out_of_range_are_refused_with_the_range(options):
    loop = Loop()
    with pytest.raises(ConfigError, match=r"must be"):
        StampSender(loop, "127.0.0.1", 1, on_result=lambda r: None, **options)
    loop.close()


def test_memory_is_bounded_when_nothing_is_ever_answered(bench):
    loop, start = bench
    silent = udp()
    sender = start(
        StampSender(loop, "127.0.0.1", silent.getsockname()[1], on_result=lambda r: None, period_ns=MS,
                    deadline_ns=20 * MS, late_ns=50 * MS)
    )  # fmt: skip
    run_until(loop, lambda: sender.counters.sent >= 600)
    assert len(sender._ledger._flights) <= 200
    assert len(sender._stamped) <= 4_096
    silent.close()


def test_the_reflector_helper_of_these_tests_is_the_real_one():
    with running_reflector() as (_, reflector):
        assert reflector.addresses == (f"127.0.0.1:{reflector.port}",)
