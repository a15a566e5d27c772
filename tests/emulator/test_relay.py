from __future__ import annotations

import os
import socket
import struct
import threading
import time

import pytest

from linkrover.emulator.medium import Medium, MediumConfig
from linkrover.emulator.relay import Port, Relay
from linkrover.emulator.stamp_truth import probe_truth
from linkrover.probe.packet import DEFAULT_PORT, SenderPacket, answer, encode_sender
from linkrover.records import LinkTruth, Now, ProbeTruth, Role

ADDRESSES = {"station": "10.77.0.1", "robot": "10.77.0.2"}


def ipv4(source, destination, payload, *, protocol=17, ports=(1000, 2000)):
    body = struct.pack(">HHHH", *ports, 8 + len(payload), 0) + payload
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(body), 0, 0, 64, protocol, 0)
    return head + socket.inet_aton(source) + socket.inet_aton(destination) + body


class StillLink:
    def __init__(self, rssi_dbm=-40.0):
        self.rssi_dbm = rssi_dbm

    def tick(self, medium, at):
        for hop in medium.hops():
            medium.set_link(hop.sender, hop.receiver, rssi_dbm=self.rssi_dbm, distance_m=1.0)


class Rig:
    """A relay between socket pairs: a datagram socket hands over whole packets, as a TUN device does."""

    def __init__(self, rssi_dbm=-40.0, robots=("robot",), **config):
        self.pairs = {
            name: socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
            for name in ("station", *robots)
        }
        addresses = {**ADDRESSES, **{name: f"10.77.0.{10 + i}" for i, name in enumerate(robots) if name != "robot"}}
        self.truth = []
        medium = Medium(
            MediumConfig(band_ghz=5.0, **config),
            access_point="station", stations=robots, seed=1, start_ns=time.monotonic_ns(),
        )  # fmt: skip
        ports = [Port(name, addresses[name], pair[1].fileno()) for name, pair in self.pairs.items()]
        self.relay = Relay(medium, ports, StillLink(rssi_dbm), self.truth.append)

    def __enter__(self):
        self.thread = threading.Thread(target=self.relay.run)
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.relay.stop()
        self.thread.join()
        for pair in self.pairs.values():
            pair[0].close()
            pair[1].close()

    def send(self, sender, packet):
        self.pairs[sender][0].send(packet)

    def receive(self, receiver, within_s=10.0):
        until = time.monotonic() + within_s
        while time.monotonic() < until:
            try:
                return self.pairs[receiver][0].recv(2048)
            except BlockingIOError:
                time.sleep(0.002)
        raise AssertionError(f"nothing reached {receiver}")


def wait(condition, within_s=10.0):
    until = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.005)


def test_packets_cross_both_ways_unchanged_and_are_counted_octet_by_octet():
    there, back = (ipv4(ADDRESSES[a], ADDRESSES[b], os.urandom(1000)) for a, b in (("robot", "station"),) * 2)
    back = ipv4(ADDRESSES["station"], ADDRESSES["robot"], b"answer")
    with Rig() as rig:
        for _ in range(20):
            rig.send("robot", there)
        rig.send("station", back)
        assert [rig.receive("station") for _ in range(20)] == [there] * 20
        assert rig.receive("robot") == back
        wait(lambda: any(isinstance(t, LinkTruth) and t.delivered_packets == 20 for t in rig.truth))
    last = {t.hop: t for t in rig.truth if isinstance(t, LinkTruth)}
    assert last["robot>station"].offered_bytes == last["robot>station"].delivered_bytes == 20 * len(there)
    assert last["station>robot"].delivered_bytes == len(back)
    assert max(t.delay_median_ns or 0 for t in rig.truth if isinstance(t, LinkTruth)) > 50_000


def test_foreign_and_broken_packets_are_counted_and_go_nowhere():
    with Rig() as rig:
        for packet in (ipv4("10.77.0.2", "192.0.2.1", b"x"), b"\x60" + bytes(60), b"\x00", b"\x4f\x4f\x4f"):
            rig.send("robot", packet)
        wait(lambda: rig.relay.unroutable == 4)
        rig.send("robot", ipv4("10.77.0.2", "10.77.0.1", b"still alive"))
        assert rig.receive("station").endswith(b"still alive")


def test_a_broadcast_reaches_every_other_host():
    names = ("robot", "robot-2", "robot-3")
    with Rig(robots=names) as rig:
        packet = ipv4("10.77.0.1", "10.77.0.255", b"hello all")
        rig.send("station", packet)
        assert {rig.receive(name) for name in names} == {packet}


def test_ten_robots_share_one_access_point():
    names = ("robot", *(f"robot-{i}" for i in range(2, 11)))
    with Rig(robots=names) as rig:
        for index, name in enumerate(names):
            rig.send(name, ipv4("0.0.0.0", "10.77.0.1", bytes([index]) * 500))
        assert {rig.receive("station")[-1] for _ in names} == set(range(10))


def stamp(sequence, session):
    return encode_sender(SenderPacket(sequence=sequence, timestamp_ns=1_700_000_000_000_000_000, ssid=session))


def test_the_true_delay_of_each_probe_is_known_by_its_session_and_sequence():
    request = stamp(7, 99)
    reply = answer(request, sequence=3, receive_ns=1, send_ns=2, error_estimate=1, ttl=64, ssid=99)
    with Rig() as rig:
        rig.send("robot", ipv4(ADDRESSES["robot"], ADDRESSES["station"], request, ports=(5000, DEFAULT_PORT)))
        rig.receive("station")
        rig.send("station", ipv4(ADDRESSES["station"], ADDRESSES["robot"], reply, ports=(DEFAULT_PORT, 5000)))
        rig.receive("robot")
        wait(lambda: sum(isinstance(t, ProbeTruth) for t in rig.truth) == 2)
    there, back = (t for t in rig.truth if isinstance(t, ProbeTruth))
    assert (there.session, there.sequence, there.direction, there.end) == (99, 7, "forward", Role.ROBOT)
    assert (back.session, back.sequence, back.direction, back.end) == (99, 7, "back", Role.ROBOT)
    assert there.delay_ns > 0
    assert there.dropped is None


def test_a_probe_that_the_link_drops_has_its_cause_in_the_truth():
    with Rig(rssi_dbm=-120.0) as rig:
        for sequence in range(5):
            packet = ipv4(ADDRESSES["robot"], ADDRESSES["station"], stamp(sequence, 1), ports=(5000, DEFAULT_PORT))
            rig.send("robot", packet)
        wait(lambda: sum(isinstance(t, ProbeTruth) for t in rig.truth) == 5)
    causes = {t.dropped for t in rig.truth if isinstance(t, ProbeTruth)}
    assert causes <= {"retries", "unassociated"}
    assert causes


@pytest.mark.parametrize(
    "packet",
    [
        b"", b"\x45" * 10,
        ipv4("10.77.0.2", "10.77.0.1", b"short", ports=(5000, DEFAULT_PORT)),
        ipv4("10.77.0.2", "10.77.0.1", bytes(44), ports=(5000, 5001)),
        ipv4("10.77.0.2", "10.77.0.1", bytes(44), protocol=6, ports=(5000, DEFAULT_PORT)),
        b"\x4f" + ipv4("10.77.0.2", "10.77.0.1", bytes(44), ports=(5000, DEFAULT_PORT))[1:],
    ],
)  # fmt: skip
def test_what_is_no_probe_has_no_probe_truth(packet):
    assert probe_truth(packet, "robot", Now(1, 1), 5, None) is None


def test_a_relay_that_was_held_up_says_so():
    with Rig() as rig:
        slow = rig.relay.link.tick

        def stall(medium, at):
            slow(medium, at)
            time.sleep(0.05)

        rig.relay.link.tick = stall
        deadline = time.monotonic() + 10
        while not any(isinstance(t, LinkTruth) and t.behind for t in rig.truth):
            assert time.monotonic() < deadline
            rig.send("robot", ipv4(ADDRESSES["robot"], ADDRESSES["station"], bytes(1400)))
            rig.receive("station")
    late = [t for t in rig.truth if isinstance(t, LinkTruth) and t.behind]
    assert all(t.release_error_max_ns > 10_000_000 for t in late)
