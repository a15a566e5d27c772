"""The medium as its users meet it: fates, routes, multicast, queues, association."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.emulator.association import AssociationConfig
from linkrover.emulator.medium import EVERYONE, Cause, Medium, MediumConfig, NodeConfig
from linkrover.errors import ConfigError

MS = 1_000_000


def make(stations=("robot",), point="station", seed=1, nodes=None, rssi_dbm=-50.0, **more):
    medium = Medium(
        MediumConfig(**{"band_ghz": 5.0, **more}), access_point=point, stations=stations, seed=seed, nodes=nodes
    )
    for hop in medium.hops():
        medium.set_link(hop.sender, hop.receiver, rssi_dbm=rssi_dbm)
    return medium


def drain(medium, until_ns):
    return medium.advance(until_ns)


@settings(max_examples=30, deadline=None)
@given(
    rssi=st.floats(-95, -40),
    seed=st.integers(0, 1000),
    queue=st.sampled_from(["drop-tail", "fair"]),
    offers=st.lists(
        st.tuples(st.integers(0, 3 * MS), st.sampled_from(["a", "b", "ap"]), st.integers(40, 1500)), max_size=300
    ),
)
def test_every_accepted_packet_has_exactly_one_fate_and_counters_add_up(rssi, seed, queue, offers):
    nodes = {name: NodeConfig(queue_packets=40, queue=queue) for name in ("a", "b", "ap")}
    medium = make(("a", "b"), "ap", seed, nodes, rssi)
    now_ns, accepted, fates = 0, set(), []
    for index, (gap, sender, octets) in enumerate(offers):
        now_ns += gap
        receiver = {"a": "b", "b": "ap", "ap": "a"}[sender]
        if medium.offer(now_ns, sender, receiver, octets, index, flow=index % 3) is None:
            accepted.add(index)
        fates += medium.advance(now_ns)
    fates += medium.advance(now_ns + 60_000 * MS)
    assert sorted(fate.tag for fate in fates) == sorted(accepted)
    for hop in medium.hops():
        gone = hop.delivered_packets + hop.dropped_queue + hop.dropped_retries + hop.dropped_unassociated
        assert hop.offered_packets == gone
        assert hop.queue.packets == 0
    assert all(fate.at_ns <= now_ns + 60_000 * MS and fate.delay_ns >= 0 for fate in fates)


def test_packets_of_one_hop_arrive_in_order_though_some_are_repeated():
    medium = make(rssi_dbm=-71.9, fixed_mcs=7, nodes={"robot": NodeConfig(queue_packets=5000)})
    for index in range(2000):
        assert medium.offer(0, "robot", "station", 1500, index) is None
    arrived = [fate.tag for fate in medium.advance(5_000 * MS) if fate.cause is None]
    assert medium.hop("robot", "station").retries > 20
    assert arrived == sorted(arrived)
    assert len(arrived) > 1900


def test_the_same_seed_gives_the_same_fates_and_another_seed_others():
    def fates(seed):
        medium = make(seed=seed, rssi_dbm=-78.0)
        for index in range(200):
            medium.offer(index * MS, "robot", "station", 1000, index)
        return medium.advance(10_000 * MS)

    assert fates(4) == fates(4)
    assert fates(4) != fates(5)


def test_delivery_is_never_before_the_air_time_of_the_packet():
    medium = make()
    medium.offer(1000, "robot", "station", 1500, "x")
    (fate,) = medium.advance(50 * MS)
    assert fate.receiver == "station"
    assert fate.delay_ns > 1500 * 8 / 72.2e6 * 1e9


def test_between_two_stations_a_packet_crosses_two_hops():
    medium = make(("robot", "station"), "router")
    medium.offer(0, "robot", "station", 1500, "x")
    (fate,) = medium.advance(100 * MS)
    assert (fate.receiver, fate.cause) == ("station", None)
    assert medium.hop("robot", "router").delivered_packets == medium.hop("router", "station").delivered_packets == 1


def test_a_multicast_of_a_station_reaches_all_others_once_through_the_access_point():
    medium = make(("a", "b", "c"), "ap")
    medium.offer(0, "a", EVERYONE, 300, "hello")
    fates = medium.advance(100 * MS)
    assert sorted(fate.receiver for fate in fates) == ["ap", "b", "c"]
    assert {fate.cause for fate in fates} == {None}


def test_multicast_is_sent_once_at_the_basic_rate_and_lost_without_retry():
    medium = make(("a",), "ap", rssi_dbm=-92.5)
    for index in range(300):
        medium.offer(index * 20 * MS, "ap", EVERYONE, 1400, index)
    lost = [fate for fate in medium.advance(7_000 * MS) if fate.cause is not None]
    assert len(lost) > 30
    assert medium.hop("ap", EVERYONE).retries == 0


def test_a_full_queue_drops_the_newest_and_says_so_at_once():
    medium = make(nodes={"robot": NodeConfig(queue_packets=10)})
    causes = [medium.offer(0, "robot", "station", 1500, index) for index in range(15)]
    assert causes[:10] == [None] * 10
    assert causes[-1] == Cause.QUEUE
    assert medium.hop("robot", "station").dropped_queue >= 4


def test_a_fair_queue_keeps_a_thin_flow_fast_beside_a_greedy_one():
    def thin_delay_ms(queue):
        medium = make(nodes={"robot": NodeConfig(queue_packets=1000, queue=queue)}, fixed_mcs=2)
        delays = []
        now_ns = 0
        for turn in range(1500):
            now_ns = turn * 2 * MS
            for _ in range(6):
                medium.offer(now_ns, "robot", "station", 1500, "greedy", flow=1)
            if turn % 10 == 0:
                medium.offer(now_ns, "robot", "station", 100, "thin", flow=2)
            delays += [f.delay_ns for f in medium.advance(now_ns) if f.tag == "thin" and f.cause is None]
        return sorted(delays)[len(delays) // 2] / 1e6

    assert thin_delay_ms("fair") < 25
    assert thin_delay_ms("drop-tail") > 200


def test_codel_keeps_the_standing_queue_of_one_greedy_flow_short():
    medium = make(nodes={"robot": NodeConfig(queue_packets=1000, queue="fair")}, fixed_mcs=2)
    delays = []
    for turn in range(3000):
        # 24 Mbit/s into some 18: CoDel has to drop about a quarter
        medium.offer(turn * MS // 2, "robot", "station", 1500, "greedy", flow=1)
        delays += [f.delay_ns for f in medium.advance(turn * MS // 2) if f.cause is None]
    late = sorted(delays[len(delays) // 2 :])
    assert late[len(late) // 2] < 200 * MS
    assert medium.hop("robot", "station").dropped_queue > 0


def test_a_bus_limit_bounds_throughput_without_using_air_time():
    medium = make(nodes={"robot": NodeConfig(bus_bps=10e6)})
    delivered = now_ns = 0
    while now_ns < 1_000 * MS:
        while medium.offer(now_ns, "robot", "station", 1500, None) is None:
            pass
        now_ns = medium.next_event_ns()
        delivered += sum(fate.cause is None for fate in medium.advance(now_ns))
    assert delivered * 12_000 == pytest.approx(10e6, rel=0.05)
    assert medium.hop("robot", "station").airtime_ns < 300 * MS


def test_out_of_range_the_association_is_lost_after_missed_beacons_and_won_again_by_a_scan():
    medium = make()
    medium.set_link("station", "robot", rssi_dbm=-120.0)
    medium.set_link("robot", "station", rssi_dbm=-120.0)
    config = medium.config.association
    medium.advance(config.beacon_ns * (config.missed_beacons - 1) + MS)
    assert medium.associated("robot")
    medium.advance(config.beacon_ns * (config.missed_beacons + 1))
    assert not medium.associated("robot")
    assert medium.offer(1_400 * MS, "robot", "station", 100, "x") == Cause.UNASSOCIATED
    lost_ns = medium.association("robot").lost_at_ns
    medium.advance(6_000 * MS)
    for hop in medium.hops():
        medium.set_link(hop.sender, hop.receiver, rssi_dbm=-60.0)
    medium.advance(6_000 * MS + config.pause_ns + config.scan_ns + config.join_ns + MS)
    assert medium.associated("robot")
    assert medium.offer(11_000 * MS, "robot", "station", 100, "x") is None
    assert lost_ns == pytest.approx(config.beacon_ns * config.missed_beacons, abs=config.beacon_ns)


def test_an_adapter_that_drops_out_by_itself_comes_back_and_carries_again():
    association = AssociationConfig(drop_out_up_ns=3_000 * MS, drop_out_down_ns=2_000 * MS)
    medium = make(association=association, others_share=0.4)
    up = sum(medium.advance(t * 100 * MS) is not None and medium.associated("robot") for t in range(1, 3000))
    # the time down ends with a scan of 1.5 s and a hand-shake of 0.25 s
    assert up / 3000 == pytest.approx(3.0 / (3.0 + 2.0 + 1.75), abs=0.06)
    while not medium.associated("robot"):
        medium.advance(medium.next_event_ns())
    now_ns = medium.next_event_ns()
    medium.offer(now_ns, "robot", "station", 100, "x")
    assert [fate.cause for fate in medium.advance(now_ns + 200 * MS)] == [None]


def test_retries_cost_air_time_and_delay():
    good, bad = make(fixed_mcs=4), make(fixed_mcs=4, rssi_dbm=-94.0 + 4 + 10.55)
    for medium in (good, bad):
        for index in range(200):
            medium.offer(index * 20 * MS, "robot", "station", 1500, index)
        medium.advance(10_000 * MS)
    easy, hard = good.hop("robot", "station"), bad.hop("robot", "station")
    assert hard.retries > 50
    assert hard.airtime_ns > 1.3 * easy.airtime_ns
    assert sum(hard.delays_ns) > 1.3 * sum(easy.delays_ns)


def test_the_truth_record_counts_from_the_start_and_its_delays_from_the_last_one():
    medium = make()
    medium.offer(0, "robot", "station", 1500, 1)
    medium.advance(100 * MS)
    first = medium.truth("robot", "station", 5, 100 * MS)
    second = medium.truth("robot", "station", 6, 150 * MS)
    assert (first.hop, first.offered_packets, first.delivered_bytes) == ("robot>station", 1, 1500)
    assert first.delay_median_ns is not None
    assert second.delay_median_ns is None
    assert second.delivered_packets == 1
    assert second.interval_ns == 50 * MS


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"band_ghz": 3.0}, "band_ghz"),
        ({"width_mhz": 30}, "width_mhz"),
        ({"max_mcs": 12}, "max_mcs"),
        ({"others_share": 1.0}, "others_share"),
        ({"streams": 0}, "streams"),
        ({"noise_dbm": float("nan")}, "noise_dbm"),
        ({"max_subframes": 0}, "max_subframes"),
        ({"fading_m": 0.2}, "fading_m"),
    ],
)
def test_a_bad_parameter_is_named_with_what_is_allowed(change, named):
    with pytest.raises(ConfigError, match=rf"medium\.{named} = .*must be"):
        MediumConfig(**change)


def test_bad_nodes_and_hops_are_named():
    with pytest.raises(ConfigError, match="no name twice"):
        Medium(MediumConfig(), access_point="a", stations=("a",))
    with pytest.raises(ConfigError, match=r"nodes\.ghost"):
        Medium(MediumConfig(), access_point="a", stations=("b",), nodes={"ghost": NodeConfig()})
    medium = make()
    with pytest.raises(ConfigError, match="robot>mars"):
        medium.set_link("robot", "mars", rssi_dbm=-40)
    with pytest.raises(ConfigError, match="offer mars>station"):
        medium.offer(0, "mars", "station", 100, None)
    with pytest.raises(ConfigError, match="rssi_dbm"):
        medium.set_link("robot", "station", rssi_dbm=float("inf"))
    with pytest.raises(ConfigError, match="queue_packets"):
        NodeConfig(queue_packets=0)
    with pytest.raises(ConfigError, match="drop-tail, fair"):
        NodeConfig(queue="red")
    with pytest.raises(ConfigError, match="beacon_ns"):
        AssociationConfig(beacon_ns=0)
