from __future__ import annotations

import urllib.request

import pytest
from prometheus_client.parser import text_string_to_metric_families

from linkrover.errors import ConfigError, LinkRoverError
from linkrover.live.metrics import Metrics, parse_address
from linkrover.records import LinkUtilization, ProbeResult, ProbeState, WirelessLink


def scrape(metrics: Metrics) -> dict[tuple[str, ...], float]:
    """What Prometheus would read: (metric, label values in the order of their names) -> value."""
    with urllib.request.urlopen(f"http://127.0.0.1:{metrics.port}/metrics", timeout=10) as answer:
        families = text_string_to_metric_families(answer.read().decode())
    return {(s.name, *(v for _, v in sorted(s.labels.items()))): s.value for f in families for s in f.samples}


@pytest.fixture
def metrics():
    found = Metrics(0)
    yield found
    found.close()


def test_the_latest_figures_are_answered_with_their_labels_and_an_unknown_one_is_absent(metrics):
    metrics.take(WirelessLink(wall_ns=1, mono_ns=1, iface="wlan0", source="nl80211", connected=True, rssi_dbm=-61.0))
    metrics.take(WirelessLink(wall_ns=2, mono_ns=2, iface="wlan0", source="nl80211", connected=True, rssi_dbm=-62.5))
    metrics.take(LinkUtilization(wall_ns=1, mono_ns=1, iface="wlan0", rx_bytes=123, tx_rate_bps=2e6))
    found = scrape(metrics)
    assert found["linkrover_rssi_dbm", "wlan0", "", "robot"] == -62.5
    assert found["linkrover_receive_bytes_total", "wlan0", "robot"] == 123
    assert found["linkrover_transmit_bits_per_second", "wlan0", "robot"] == 2e6
    assert not [key for key in found if key[0] == "linkrover_noise_dbm"]


def test_probes_are_counted_by_their_fate_and_round_trips_fill_a_histogram(metrics):
    for state, rtt_ns in ((ProbeState.ANSWERED, 4_000_000), (ProbeState.ANSWERED, 30_000_000), (ProbeState.LOST, None)):
        metrics.take(
            ProbeResult(wall_ns=1, mono_ns=1, peer="10.0.0.1", session=1, sequence=1, state=state, rtt_ns=rtt_ns)
        )
    found = scrape(metrics)
    assert found["linkrover_probes_total", "10.0.0.1", "robot", "answered"] == 2
    assert found["linkrover_probes_total", "10.0.0.1", "robot", "lost"] == 1
    assert found["linkrover_rtt_seconds_bucket", "0.005", "10.0.0.1", "robot"] == 1


def test_a_taken_port_is_said_in_one_line(metrics):
    with pytest.raises(LinkRoverError, match=f"metrics cannot listen on 127.0.0.1:{metrics.port}"):
        Metrics(metrics.port)


@pytest.mark.parametrize(
    ("text", "address"),
    [("9464", ("127.0.0.1", 9464)), ("0.0.0.0:80", ("0.0.0.0", 80)), ("[::1]:9", ("::1", 9))],
)
def test_an_address_is_a_port_on_loopback_or_host_and_port(text, address):
    assert parse_address(text) == address


@pytest.mark.parametrize("text", ["", "x", "host:", "1:99999"])
def test_anything_else_is_refused(text):
    with pytest.raises(ConfigError, match="expected PORT or HOST:PORT"):
        parse_address(text)
