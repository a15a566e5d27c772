from __future__ import annotations

import socket
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.records import Continuity, Unknown
from linkrover.sources.interface import InterfaceSocket, InterfaceWatch
from linkrover.sources.netdev import DeviceCounters, NetdevReader
from linkrover.sources.network_errors import NetworkErrorsSource
from linkrover.sources.snmp import NetstatReader, SnmpReader
from linkrover.sources.utilization import UtilizationSource
from tests.namespace import Namespace, joined

from .captured import NETDEV, SNMP

ETHERNET_IP_UDP = 14 + 20 + 8


@pytest.fixture
def pair():
    one, two = joined()
    yield one, two
    one.close()
    two.close()


def opened(space, *names):
    """Sources that live in the namespace, each file and socket opened there."""

    def make():
        sockets = InterfaceSocket()
        watches = [InterfaceWatch(name, sockets=sockets) for name in names]
        netdev, snmp, netstat = NetdevReader(), SnmpReader(), NetstatReader()
        utilization = UtilizationSource(watches, netdev=netdev, snmp=snmp)
        errors = NetworkErrorsSource(watches, sockets=sockets, netdev=netdev, snmp=snmp, netstat=netstat)
        # /proc/thread-self is looked up at the first reading: make it here
        return utilization, errors, utilization.sample(), errors.sample()

    return space.run(make)


def send(space, count, size):
    def work():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            for _ in range(count):
                sock.sendto(bytes(size), ("10.9.0.2", 9))

    space.run(work)


def test_counters_agree_with_the_bytes_truly_sent_and_rates_with_the_time(pair):
    one, two = pair
    send(one, 1, 10)  # address resolution happens here
    sender, receiver = opened(one, "v0"), opened(two, "v0")
    began = time.monotonic_ns()
    send(one, 50, 1000)
    (sent,), (received,) = sender[0].sample(), receiver[0].sample()
    took = time.monotonic_ns() - began
    on_wire = 50 * (1000 + ETHERNET_IP_UDP)
    assert sent.continuity is Continuity.STEADY
    # the kernel may also send a few of its own (neighbour discovery)
    assert on_wire <= sent.tx_bytes - sender[2][0].tx_bytes < on_wire + 2000
    assert on_wire <= received.rx_bytes - receiver[2][0].rx_bytes < on_wire + 2000
    assert sent.udp_tx_datagrams - sender[2][0].udp_tx_datagrams == 50
    increment = sent.tx_bytes - sender[2][0].tx_bytes
    assert sent.tx_rate_bps == pytest.approx(increment * 8e9 / sent.interval_ns)
    assert sent.interval_ns >= took * 0.5
    assert sent.interval_ns == sent.mono_ns - sender[2][0].mono_ns


def test_the_first_sample_has_counters_and_no_rate(pair):
    first = opened(pair[0], "v0")[2][0]
    assert first.continuity is Continuity.FIRST
    assert first.tx_bytes is not None
    assert (first.tx_rate_bps, first.unknown["tx_rate_bps"]) == (None, Unknown.NO_BASE)


def test_measuring_goes_on_through_gone_back_and_renamed(pair):
    one, _ = pair
    utilization, errors, *_ = opened(one, "v0", "lo")
    one.ip("link delete v0")
    gone, loopback = utilization.sample()
    assert (gone.continuity, gone.rx_bytes, gone.unknown["rx_bytes"]) == (Continuity.GONE, None, Unknown.ABSENT)
    assert gone.tcp_tx_segments is not None
    assert loopback.continuity is Continuity.STEADY
    assert errors.sample()[0].continuity is Continuity.GONE
    one.ip("link add v0 type veth peer name v1")
    back = utilization.sample()[0]
    assert (back.continuity, back.rx_rate_bps) == (Continuity.BACK, None)
    assert errors.sample()[0].continuity is Continuity.BACK
    steady = utilization.sample()[0]
    assert (steady.continuity, steady.rx_rate_bps) == (Continuity.STEADY, 0.0)
    one.ip("link set v0 name w0")
    renamed = utilization.sample()[0]
    assert (renamed.iface, renamed.continuity, renamed.rx_rate_bps) == ("v0", Continuity.STEADY, 0.0)
    assert errors.sample()[0].nic_rx_errors == 0


def test_a_replacement_between_two_samples_gives_no_rate(pair):
    one, _ = pair
    utilization, *_ = opened(one, "v0")
    one.ip("link delete v0")
    one.ip("link add v0 type veth peer name v1")
    replaced = utilization.sample()[0]
    assert (replaced.continuity, replaced.tx_rate_bps) == (Continuity.BACK, None)


def test_a_reader_stays_in_its_namespace_when_its_process_does_not(pair):
    one, two = pair
    utilization, *_ = opened(one, "v0")
    before = utilization.sample()[0].tx_bytes
    send(one, 10, 500)
    seen = two.run(lambda: utilization.sample()[0].tx_bytes)
    assert seen - before >= 10 * (500 + ETHERNET_IP_UDP)


def test_real_tcp_retransmits_are_counted(pair):
    one, _ = pair
    _, errors, _, first = opened(one, "v0")

    def refused():
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as sock:
            sock.settimeout(1.6)
            with pytest.raises(OSError):
                sock.connect(("10.9.0.2", 5))  # the SYN is dropped below: it is sent again after 1 s

    one.ip("neighbour replace 10.9.0.2 lladdr 02:00:00:00:00:99 dev v0")  # a stranger's address: nobody takes it
    one.run(refused)
    last = errors.sample()[0]
    assert last.tcp_retransmits > first[0].tcp_retransmits
    assert last.tcp_timeouts >= first[0].tcp_timeouts


def test_udp_that_does_not_fit_into_its_buffer_is_an_error(pair):
    one, two = pair
    errors = opened(two, "v0")

    def flood():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sink:
            sink.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            sink.bind(("10.9.0.2", 9))
            send(one, 100, 1000)

    two.run(flood)
    last = errors[1].sample()[0]
    assert last.udp_buffer_errors > errors[3][0].udp_buffer_errors


def test_a_sysfs_of_another_namespace_is_not_believed():
    """A thread that entered a namespace still sees the old /sys: lo's counters there are a stranger's."""
    space = Namespace()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.sendto(bytes(100), ("127.0.0.1", 9))  # the outer lo has traffic, the inner has none
    _, errors, _, first = opened(space, "lo")
    assert errors._sysfs_refused == {"lo": 0}
    assert first[0].nic_rx_errors == 0
    space.close()


def fed(tmp_path, netdev=NETDEV, snmp=SNMP):
    (tmp_path / "dev").write_bytes(netdev)
    (tmp_path / "snmp").write_bytes(snmp)


def from_files(tmp_path):
    return UtilizationSource(
        [InterfaceWatch("lo")],
        netdev=NetdevReader(str(tmp_path / "dev")),
        snmp=SnmpReader(str(tmp_path / "snmp")),
    )


def test_a_wrapped_byte_counter_gives_the_true_rate(tmp_path):
    fed(tmp_path, NETDEV.replace(b"    lo:    3393      33", b"    lo: 4294967000   33"))
    source = from_files(tmp_path)
    source.sample()
    fed(tmp_path, NETDEV.replace(b"    lo:    3393      33", b"    lo:    704       40"))
    (record,) = source.sample()
    assert record.continuity is Continuity.WRAPPED
    assert record.rx_rate_bps == pytest.approx(1000 * 8e9 / record.interval_ns)


def test_reset_counters_give_no_rate_and_say_so(tmp_path):
    fed(tmp_path)
    source = from_files(tmp_path)
    source.sample()
    fed(tmp_path, NETDEV.replace(b"3393      33", b"   3       1"))
    (record,) = source.sample()
    assert (record.continuity, record.rx_rate_bps) == (Continuity.RESET, None)
    (record,) = source.sample()
    assert (record.continuity, record.rx_rate_bps) == (Continuity.STEADY, 0.0)


def test_a_damaged_file_is_unknown_and_named_not_raised(tmp_path):
    fed(tmp_path, snmp=b"garbage\n")
    source = from_files(tmp_path)
    (record,) = source.sample()
    assert record.rx_bytes == 3393
    assert (record.tcp_tx_segments, record.unknown["tcp_tx_segments"]) == (None, Unknown.UNSUPPORTED)
    assert isinstance(source.last_error, ParseError)


class Scripted:
    """A reader that gives what it is told, in place of the kernel."""

    def __init__(self):
        self.devices = {}

    def read(self, only=None):
        return {name: self.devices[name] for name in only if name in self.devices}

    def close(self):
        pass


COUNTER = st.one_of(st.integers(0, 2**64 - 1), st.integers(2**32 - 5000, 2**32 + 5000), st.integers(0, 5000))
STEPS = st.lists(st.none() | st.tuples(COUNTER, COUNTER, COUNTER, COUNTER), min_size=2, max_size=8)


@given(STEPS)
@settings(max_examples=150, deadline=None)
def test_whatever_the_counters_do_a_rate_is_the_true_increment_or_none(steps):
    reader = Scripted()
    source = UtilizationSource([InterfaceWatch("lo")], netdev=reader, snmp=SnmpReader())
    before = None
    for step in steps:
        if step is None:
            reader.devices = {}
        else:
            rx, rx_packets, tx, tx_packets = step
            reader.devices = {"lo": DeviceCounters(rx, rx_packets, 0, 0, tx, tx_packets, 0, 0)}
        (record,) = source.sample()
        if step is None:
            assert (record.continuity, record.rx_bytes, record.rx_rate_bps) == (Continuity.GONE, None, None)
        elif record.rx_rate_bps is not None:
            rose = step[0] - before[0]
            true = rose if rose >= 0 else rose + 2**32
            assert record.rx_rate_bps == pytest.approx(true * 8e9 / record.interval_ns)
            assert (record.continuity is Continuity.WRAPPED) or rose >= 0
        else:
            assert record.unknown["rx_rate_bps"] is Unknown.NO_BASE
            assert record.continuity in {Continuity.FIRST, Continuity.BACK, Continuity.RESET}
        before = step
    source.close()
