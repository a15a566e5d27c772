from __future__ import annotations

from typing import Any, cast

import pytest

from linkrover.errors import ConfigError
from linkrover.middleware import Layout, Middleware, RecordPublisher
from linkrover.records import LinkUtilization, NetworkDelay, NetworkErrors, Pose, WirelessLink

from .recording import Recording

AT: dict[str, Any] = {"wall_ns": 5, "mono_ns": 7}
UTILIZATION = LinkUtilization(**AT, iface="wlan0", rx_bytes=10, rx_rate_bps=2e6)


def published(layout: Layout, *records: Any, end: str = "robot") -> Recording:
    found = Recording()
    sink = RecordPublisher(cast("Middleware", found), end, layout)
    for record in records:
        sink.take(record)
    return found


def test_the_default_layout_is_that_of_a_recording() -> None:
    assert published(Layout(), UTILIZATION).topics() == [
        "robot/wlan0/linkrover/link_utilization",
        "robot/wlan0/network_analysis/link_utilization",
    ]


def test_an_empty_prefix_gives_the_names_of_2021() -> None:
    found = published(Layout(prefix=""), UTILIZATION, NetworkDelay(**AT, iface="wlan0", peer="p", method="ros1 action"))
    assert "network_analysis/link_utilization" in found.topics()
    assert "network_analysis/network_delay" in found.topics()


def test_aliases_give_the_interfaces_of_the_2021_recordings() -> None:
    layout = Layout(prefix="server/{iface}", aliases={"wlan0": "iface1"})
    assert "server/iface1/network_analysis/link_utilization" in published(layout, UTILIZATION).topics()


def test_two_interfaces_on_one_topic_are_refused() -> None:
    with pytest.raises(ConfigError, match="would share their topics"):
        Layout(prefix="robot").check(("wlan0", "wlan1"))


@pytest.mark.parametrize("prefix", ["{", "{host}", "{0}"])
def test_a_prefix_that_cannot_be_filled_in_is_refused(prefix: str) -> None:
    with pytest.raises(ConfigError, match="prefix"):
        Layout(prefix=prefix).check(("wlan0",))


def test_the_delay_topic_of_2021_carries_each_application_ping_once() -> None:
    def delay(method: str, **more: Any) -> NetworkDelay:
        return NetworkDelay(**AT, iface="wlan0", peer="p", method=method, **more)

    found = published(
        Layout(), delay("stamp"), delay("ros1 action"), delay("ros1 action late", late=True, delay_ns=3_000_000_000)
    )
    compatible = [m for m in found.messages if m[1] == "network_analysis/NetworkDelay"]
    assert len(compatible) == 1
    assert compatible[0][2]["delay"] == -1.0
    assert len([m for m in found.messages if m[1] == "linkrover_msgs/NetworkDelay"]) == 3


def test_poses_are_not_sent_back_to_the_topic_they_came_from() -> None:
    found = published(Layout(), Pose(**AT, x_m=1, y_m=2, heading_rad=0))
    assert [m[1] for m in found.messages] == ["linkrover_msgs/Pose"]


def test_the_combined_message_has_the_newest_of_each_kind_and_leaves_out_the_stale() -> None:
    found = Recording()
    sink = RecordPublisher(cast("Middleware", found), "robot", Layout())
    sink.take(LinkUtilization(wall_ns=1, mono_ns=1, iface="wlan1", rx_bytes=1))
    sink.take(LinkUtilization(wall_ns=1, mono_ns=100, iface="wlan0", rx_bytes=1))
    sink.take(LinkUtilization(wall_ns=1, mono_ns=200, iface="wlan0", rx_bytes=2))
    sink.take(NetworkErrors(wall_ns=1, mono_ns=200, iface="wlan0", tcp_retransmits=3))
    sink.take(WirelessLink(wall_ns=1, mono_ns=200, iface="wlan0", source="wext", rssi_dbm=-60.0))
    sink.publish_combined(50)
    topic, kind, message, _ = found.messages[-1]
    assert (topic, kind) == ("robot/network_analysis/network_analysis", "network_analysis/NetworkAnalysis")
    assert [u["total_rx_bytes"] for u in message["utilization"]] == [2]
    assert [e["retransmits"] for e in message["errors"]] == [3]
    assert [q["rssi"] for q in message["quality"]] == [-60]
    assert message["delay"] == []
