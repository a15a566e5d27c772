from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import LinkRoverError, ParseError
from linkrover.messages import (
    Codec,
    assign,
    from_message,
    legal_name,
    messages_of,
    record_type,
    record_types,
    texts,
    to_message,
    topics,
    type_name,
)
from linkrover.messages.legacy import from_2021, to_2021
from linkrover.messages.mapping import RENAMED
from linkrover.messages.standard import from_odometry, from_twist, to_standard
from linkrover.records import (
    Bitrate,
    LinkUtilization,
    NetworkDelay,
    NetworkErrors,
    Pose,
    Unknown,
    VelocityCommand,
    WirelessLink,
)

from .strategies import any_record, structs


class Attributes:
    """What rospy and rosbags give: fields as attributes."""

    def __init__(self, message: dict) -> None:
        for name, value in message.items():
            setattr(self, name, _attributes(value))


def _attributes(value: object) -> object:
    if isinstance(value, dict):
        return Attributes(value)
    return [_attributes(one) for one in value] if isinstance(value, list) else value


@given(any_record)
@settings(max_examples=400, deadline=None)
def test_a_record_comes_back_from_its_message(record):
    message = to_message(record, "robot")
    assert from_message(type(record), message) == record
    assert from_message(type(record), Attributes(message)) == record


@given(any_record, st.booleans())
@settings(max_examples=400, deadline=None)
def test_a_record_comes_back_from_its_bytes(record, ros1):
    codec = Codec(type_name(type(record)), texts.definitions(type_name(type(record))), ros1=ros1)
    assert from_message(type(record), codec.decode(codec.encode(to_message(record, "station")))) == record


@pytest.mark.parametrize("kind", record_types(), ids=lambda k: k.__name__)
def test_every_field_of_a_record_has_a_message_field_and_no_more(kind):
    fields = [f.name for f in texts.definitions(type_name(kind))[type_name(kind)]]
    own = [RENAMED.get(f, f) for f in kind.__struct_fields__ if f not in ("wall_ns", "mono_ns", "unknown")]
    assert fields[:2] == ["header", "mono_ns"]
    assert fields[-1] == "unknown"
    assert sorted(fields[2:-1]) == sorted(own)
    assert record_type(type_name(kind)) is kind


def test_field_names_are_legal_in_ros_2_and_in_cpp():
    keywords = {"case", "default", "class", "new", "delete", "union", "operator", "this", "private", "public", "int"}
    for package in texts.PACKAGES:
        for name in texts.names(package):
            for field in texts.definitions(name)[name]:
                assert field.name == field.name.lower()
                assert "__" not in field.name
                assert not field.name.endswith("_")
                assert field.name not in keywords


def test_unknown_travels_as_its_sentinel():
    record = WirelessLink(
        wall_ns=1, mono_ns=2, iface="wlan0", source="wext", unknown={"rssi_dbm": Unknown.NOT_CONNECTED}
    )
    message = to_message(record, "robot")
    assert math.isnan(message["rssi_dbm"])
    assert message["connected"] == message["tx_failed"] == -1
    assert message["ssid"] == ""
    assert message["tx_bitrate"]["known"] is False
    assert message["unknown"] == ["rssi_dbm=not connected"]
    assert message["header"]["frame_id"] == "wlan0"


def test_a_known_bitrate_of_which_nothing_is_known_is_not_an_unknown_bitrate():
    record = WirelessLink(wall_ns=1, mono_ns=2, iface="w", source="nl80211", tx_bitrate=Bitrate())
    assert from_message(WirelessLink, to_message(record, "robot")).tx_bitrate == Bitrate()


@pytest.mark.parametrize("kind", [WirelessLink, LinkUtilization, NetworkErrors, NetworkDelay])
def test_the_2021_messages_fit_their_texts(kind):
    needed = {WirelessLink: {"source": "wext"}, NetworkDelay: {"peer": "p", "method": "stamp"}}.get(kind, {})
    record = kind(wall_ns=5_000_000_007, mono_ns=1, iface="wlan0", **needed)
    name, message = to_2021(record)
    codec = Codec(name, texts.definitions(name))
    (back,) = from_2021(name, codec.decode(codec.encode(message)))
    assert back.wall_ns == 5_000_000_007
    unknown = [f for f in kind.__struct_fields__ if getattr(record, f) is None and f != "connected"]
    assert all(getattr(back, f) is None for f in unknown)


def test_a_lost_delay_is_minus_one_millisecond():
    lost = NetworkDelay(wall_ns=1, mono_ns=1, iface="wlan0", peer="p", method="stamp")
    assert to_2021(lost)[1]["delay"] == -1.0
    answered = NetworkDelay(
        wall_ns=1, mono_ns=1, iface="wlan0", peer="p", method="stamp", delay_ns=1_500_000, alive=True
    )
    assert to_2021(answered)[1]["delay"] == 1.5
    assert from_2021("network_analysis/NetworkDelay", to_2021(answered)[1])[0].delay_ns == 1_500_000


def test_a_missing_signal_is_minus_256():
    _, message = to_2021(WirelessLink(wall_ns=1, mono_ns=1, iface="w", source="wext", connected=False))
    assert (message["rssi"], message["noise"], message["status"]) == (-256, -256, False)
    (back,) = from_2021("network_analysis/WirelessLink", message)
    assert back.rssi_dbm is None
    assert back.connected is False


def test_mbps_is_a_true_rate():
    record = LinkUtilization(wall_ns=1, mono_ns=1, iface="w", rx_rate_bps=20.6e6, rx_bytes=7)
    assert to_2021(record)[1]["total_rx_mbps"] == pytest.approx(20.6)


def test_a_vector_gives_every_record_in_it():
    one = to_2021(WirelessLink(wall_ns=1, mono_ns=1, iface="w", source="wext", rssi_dbm=-40.0))[1]
    found = from_2021("network_analysis/WirelessLinkVector", {"header": one["header"], "wireless_quality": [one, one]})
    assert [r.rssi_dbm for r in found] == [-40.0, -40.0]


@given(structs(Pose))
@settings(max_examples=50, deadline=None)
def test_a_pose_comes_back_from_odometry(pose):
    name, message = to_standard(pose)
    codec = Codec(name, texts.definitions(name))
    back = from_odometry(codec.decode(codec.encode(message)))
    assert (back.x_m, back.y_m, back.wall_ns, back.frame) == (pose.x_m, pose.y_m, pose.wall_ns, pose.frame)
    assert back.forward_m_per_s == pose.forward_m_per_s
    if abs(pose.heading_rad) < 1e6:
        turned = (back.heading_rad - pose.heading_rad + math.pi) % math.tau - math.pi
        assert abs(turned) < 1e-6


def test_a_command_comes_back_from_twist():
    command = VelocityCommand(wall_ns=9, mono_ns=9, forward_m_per_s=0.5, turn_rad_per_s=-1.5, sideways_m_per_s=0.1)
    assert from_twist(to_standard(command)[1], 9) == command


def test_interface_names_become_legal_topic_tokens():
    assert legal_name("wlan0") == "wlan0"
    assert legal_name("wlan0.100") == "wlan0_100"
    assert legal_name("80-mesh") == "if_80_mesh"
    assert legal_name("eth__0_") == "eth_0"
    assert legal_name("../..") == "if"


@given(st.text(max_size=20))
def test_any_interface_name_gives_a_legal_topic(name):
    record = WirelessLink(wall_ns=1, mono_ns=1, iface=name, source="wext")
    for topic, _ in topics(record, "robot"):
        assert "//" not in topic
        assert "__" not in topic
        for token in topic[1:].split("/"):
            assert token.isascii()
            assert token[0].isalpha()
            assert token.replace("_", "").isalnum()


def test_a_record_is_published_in_full_and_in_the_2021_type():
    record = WirelessLink(wall_ns=1, mono_ns=1, iface="wlan0", source="wext")
    assert [(t, n) for t, n, _ in messages_of(record, "robot")] == [
        ("/robot/wlan0/linkrover/wireless_link", "linkrover_msgs/WirelessLink"),
        ("/robot/wlan0/network_analysis/wireless_quality", "network_analysis/WirelessLink"),
    ]


def test_a_message_of_another_type_is_a_parse_error():
    with pytest.raises(ParseError):
        from_message(WirelessLink, {"nothing": 1})
    with pytest.raises(ParseError):
        from_2021("network_analysis/WirelessLink", {"nothing": 1})
    with pytest.raises(LinkRoverError):
        texts.text("../secrets/X")


@given(any_record, st.data())
@settings(max_examples=300, deadline=None)
def test_damaged_bytes_are_a_parse_error_or_a_record(record, data):
    codec = Codec(type_name(type(record)), texts.definitions(type_name(type(record))))
    whole = bytearray(codec.encode(to_message(record, "robot")))
    for at in data.draw(st.lists(st.integers(0, len(whole) - 1), max_size=4)):
        whole[at] ^= data.draw(st.integers(1, 255))
    cut = bytes(whole[: data.draw(st.integers(0, len(whole)))])
    try:
        from_message(type(record), codec.decode(cut))
    except ParseError:
        return


def test_assign_fills_objects_with_attributes():
    record = WirelessLink(wall_ns=3, mono_ns=4, iface="w", source="nl80211", tx_bitrate=Bitrate(mcs=7))
    target = Attributes(to_message(WirelessLink(wall_ns=0, mono_ns=0, iface="", source=""), ""))
    assign(target, to_message(record, "robot"), lambda _: None, "linkrover_msgs/WirelessLink")
    assert from_message(WirelessLink, target) == record
