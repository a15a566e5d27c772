import ipaddress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkrover.doctor import network, permission, rtnetlink
from linkrover.doctor.finding import Status
from linkrover.errors import ParseError

OK, WARN, FAIL, UNKNOWN = Status.OK, Status.WARN, Status.FAIL, Status.UNKNOWN


@pytest.mark.parametrize(("octets", "status"), [(1500, OK), (1400, WARN), (9000, WARN), (1000, FAIL), (None, UNKNOWN)])
def test_mtu(octets, status):
    assert network.mtu(octets, "wlan0").status is status


def test_fragmentation_and_buffers_name_the_sysctl_that_mends_them():
    good = network.fragmentation("3", "134217728") + network.buffers("8388608", "8388608")
    assert {f.status for f in good} == {OK}
    poor = network.fragmentation("30", "4194304") + network.buffers("212992", "212992")
    assert {f.status for f in poor} == {WARN}
    assert poor[0].mend.startswith("sudo sysctl -w net.ipv4.ipfrag_time=3")
    absent = network.fragmentation(None, None) + network.buffers(None, "nonsense")
    assert [f.status for f in absent] == [UNKNOWN, UNKNOWN, UNKNOWN, WARN]


@pytest.mark.parametrize(
    ("kinds", "wireless", "status"),
    [
        (["fq_codel"], False, OK), (["mq", "fq_codel", "fq_codel"], False, OK), (["noqueue"], True, OK),
        (["pfifo_fast"], False, WARN), (["mq", "pfifo_fast"], True, WARN), (["htb"], False, UNKNOWN),
        ([], False, UNKNOWN),
    ],
)  # fmt: skip
def test_queueing_disciplines(kinds, wireless, status):
    assert network.qdisc(kinds, "wlan0", wireless=wireless).status is status


def interface(text):
    return ipaddress.ip_interface(text)


def test_two_interfaces_in_one_subnet_are_found_and_fail():
    owned = [
        ("lo", interface("127.0.0.1/8")), ("wlan0", interface("192.168.1.5/24")), ("eth0", interface("192.168.1.6/24")),
        ("eth0", interface("fe80::1/64")), ("wlan0", interface("fe80::2/64")), ("wg0", interface("192.168.1.9/32")),
        ("wlan1", interface("10.0.0.1/24")), ("wlan0", interface("192.168.1.50/24")),
    ]  # fmt: skip
    shared = rtnetlink.shared_networks(owned)
    assert set(shared) == {("192.168.1.0/24", "wlan0", "eth0"), ("192.168.1.0/24", "eth0", "wlan0")}
    assert network.subnets(shared)[0].status is FAIL
    assert network.subnets([])[0].status is OK


def test_ways_to_the_peer():
    assert network.way_to_peer("10.0.0.2", "wlan0", "wlan0").status is OK
    assert network.way_to_peer("10.0.0.2", "wlan0", None).status is OK
    assert network.way_to_peer("127.0.0.1", "lo", "wlan0").status is OK
    wrong = network.way_to_peer("10.0.0.2", "eth0", "wlan0")
    assert wrong.status is FAIL
    assert "dev wlan0" in wrong.mend
    assert network.way_to_peer("10.0.0.2", None, None).status is FAIL


def test_asymmetric_routes_warn_and_fail_where_rp_filter_drops():
    assert network.asymmetry("10.0.0.2", [], []).status is OK
    case = [("192.168.1.5", "wlan0", "eth0")]
    assert network.asymmetry("10.0.0.2", case, []).status is WARN
    strict = network.asymmetry("10.0.0.2", case, ["wlan0"])
    assert strict.status is FAIL
    assert "wlan0 drops such packets" in strict.value


def test_multicast():
    assert network.multicast(True, "wlan0", "wlan0", wireless=True).status is OK
    assert network.multicast(True, "eth0", "wlan0", wireless=True).status is WARN
    assert network.multicast(True, None, "wlan0", wireless=False).status is WARN
    assert network.multicast(False, "wlan0", "wlan0", wireless=False).status is WARN
    assert network.multicast(None, None, "wlan0", wireless=False).status is UNKNOWN


def test_permissions():
    assert permission.kernel_stamps(False).status is WARN
    assert "sudo" in permission.scanning(0).value
    assert permission.scanning(1 << 12).value.startswith("yes")
    assert [permission.tunnel(*t).status for t in ((True, True), (True, False), (False, False))] == [OK, WARN, WARN]
    assert permission.namespaces(True, "0", "0", "1").status is OK
    for state in (("0", None, None), (None, "0", None), ("100", "1", "1")):
        assert permission.namespaces(False, *state).status is WARN
    assert permission.namespaces(False, "100", None, None).status is OK
    assert permission.radio_access("not in this kernel").status is UNKNOWN


@given(st.binary(max_size=120))
def test_any_octets_are_a_message_of_the_kernel_or_a_parse_error(data):
    for parse in (rtnetlink.parse_address, rtnetlink.parse_qdisc, rtnetlink.parse_route):
        try:
            parse(data)
        except ParseError:
            continue


def test_the_running_kernel_tells_addresses_queues_and_routes():
    tables = rtnetlink.RouteTables()
    owned = tables.addresses()
    assert ipaddress.ip_address("127.0.0.1") in [o.address.ip for o in owned]
    assert all(q.kind for q in tables.qdiscs())
    assert tables.route("127.0.0.1").source == "127.0.0.1"
    tables.close()
