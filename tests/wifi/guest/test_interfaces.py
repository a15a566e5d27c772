"""Interfaces that come, go, change their name or their namespace while they are measured."""

from __future__ import annotations

import pytest

from linkrover.records import EventKind, Record, Unknown, WirelessLink
from linkrover.sources.interface import InterfaceSocket, InterfaceWatch
from linkrover.sources.radio import RadioSource

from .air import Air, Eye, Radio, inside, run


@pytest.fixture(scope="module", autouse=True)
def cell(air: Air, robot: Radio, station: Radio) -> None:
    air.access_point(robot, "interfaces", 11)
    air.station(station, "interfaces", [11])


class Followed:
    """What the agent does with an interface: a watch and a source."""

    def __init__(self, radio: Radio) -> None:
        self.ns = radio.ns
        self.changes: list[EventKind] = []
        with inside(self.ns):
            sockets = InterfaceSocket()
            watch = InterfaceWatch(radio.iface, sockets=sockets, on_change=lambda *said: self.changes.append(said[1]))
            self.source = RadioSource(watch, sockets=sockets)

    def sample(self) -> list[Record]:
        with inside(self.ns):
            found = self.source.sample()
        assert self.source.last_error is None
        return found

    def link(self) -> WirelessLink:
        return next(one for one in self.sample() if isinstance(one, WirelessLink))


def test_a_renamed_interface_is_followed(spare: Radio):
    followed = Followed(spare)
    assert followed.link().mode == "station"
    run("ip", "link", "set", spare.iface, "name", "radio0", ns="spare")
    try:
        link = followed.link()
        assert link.mode == "station"
        assert link.iface == spare.iface
        assert followed.changes == [EventKind.INTERFACE_RENAMED]
    finally:
        run("ip", "link", "set", "radio0", "name", spare.iface, ns="spare")
    assert followed.link().mode == "station"
    followed.source.close()


def test_a_radio_moved_to_another_namespace_is_absent_and_then_back(spare: Radio, eyes: dict[str, Eye]):
    moved = Followed(spare)
    assert moved.link().connected is False
    run("iw", "phy", spare.phy, "set", "netns", "name", "robot2", ns="spare")
    assert moved.link().unknown["rssi_dbm"] is Unknown.ABSENT
    assert eyes["spare"].read().links[0].unknown["rssi_dbm"] is Unknown.ABSENT
    run("iw", "phy", spare.phy, "set", "netns", "name", "spare", ns="robot2")
    assert moved.link().connected is False
    assert moved.changes == [EventKind.INTERFACE_GONE, EventKind.INTERFACE_BACK]
    moved.source.close()


def test_an_interface_removed_and_added_again_is_measured_again(spare: Radio):
    followed = Followed(spare)
    assert followed.link().connected is False
    run("iw", "dev", spare.iface, "del", ns="spare")
    assert followed.link().unknown["rssi_dbm"] is Unknown.ABSENT
    run("iw", "phy", spare.phy, "interface", "add", spare.iface, "type", "managed", ns="spare")
    link = followed.link()
    assert link.connected is False
    assert link.mode == "station"
    assert EventKind.INTERFACE_BACK in followed.changes
    followed.source.close()


@pytest.mark.parametrize(("kind", "mode"), [("monitor", "monitor"), ("__ap", "ap"), ("mp", "mesh"), ("ibss", "ibss")])
def test_every_mode_is_named_and_an_empty_dump_is_no_link(kind: str, mode: str, spare: Radio, eyes: dict[str, Eye]):
    run("iw", "phy", spare.phy, "interface", "add", "extra0", "type", kind, ns="spare")
    try:
        with inside("spare"):
            sample = eyes["spare"].nl.read("extra0")
        assert sample.stations == ()
        assert sample.links[0].mode == mode
        assert sample.links[0].connected is False
        assert sample.links[0].rssi_dbm is None
    finally:
        run("iw", "dev", "extra0", "del", ns="spare")


def test_a_wired_interface_gives_no_wireless_record():
    with inside("station"):
        sockets = InterfaceSocket()
        source = RadioSource(InterfaceWatch("lo", sockets=sockets), sockets=sockets)
        assert source.sample() == []
        assert source.last_error is None
        source.close()
