"""MAC retries, failures and signal of each direction, against a medium that knows the truth."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from ..medium import Medium
from .air import Air, Eye, Radio, datagrams, wait_for


@pytest.fixture(scope="module")
def medium(air: Air, robot: Radio, station: Radio) -> Iterator[Medium]:
    made = Medium([robot.mac, station.mac])
    made.start()
    air.access_point(robot, "lossy", 1, legacy=True)  # with 802.11n the driver counts whole aggregates, not retries
    air.station(station, "lossy", [1], more="disable_ht=1")
    datagrams("station", "10.1.0.1", 2)
    yield made
    air.close()
    made.close()


@pytest.mark.parametrize("direction", ["station to access point", "access point to station"])
def test_retries_and_failures_are_the_mediums(
    direction: str, medium: Medium, robot: Radio, station: Radio, eyes: dict[str, Eye]
):
    sender, receiver, address = (station, robot, "10.1.0.1") if direction[0] == "s" else (robot, station, "10.1.0.2")
    hop = medium.hop(sender.mac, receiver.mac)
    before = eyes[sender.ns].quick().stations[0]
    retries, failed, frames = hop.retries, hop.failed, hop.frames
    hop.loss = 0.6
    datagrams(sender.ns, address, 120)
    wait_for("all frames on the air", lambda: hop.frames - frames >= 120, 20)
    hop.loss = 0.0

    def counted() -> tuple[int, int]:
        now = eyes[sender.ns].quick().stations[0]
        return now.tx_retries - before.tx_retries, now.tx_failed - before.tx_failed

    wait_for("the counters", lambda: counted() == (hop.retries - retries, hop.failed - failed), 10)
    assert counted()[0] > 60
    assert eyes[sender.ns].quick().links[0].tx_failed == eyes[sender.ns].quick().stations[0].tx_failed


def test_each_direction_has_its_own_level(medium: Medium, robot: Radio, station: Radio, eyes: dict[str, Eye]):
    medium.hop(robot.mac, station.mac).signal_dbm = -71
    medium.hop(station.mac, robot.mac).signal_dbm = -83
    datagrams("station", "10.1.0.1", 2)
    wait_for("the station's level", lambda: eyes["station"].quick().links[0].rssi_dbm == -71, 10)
    wait_for("the access point's level", lambda: eyes["robot"].quick().links[0].rssi_dbm == -83, 10)
