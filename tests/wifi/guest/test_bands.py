"""Station and access point on both bands, open and WPA2, as hostapd and wpa_supplicant make them."""

from __future__ import annotations

from pathlib import Path

import pytest

from .air import FREQUENCIES, PASSPHRASE, Air, Eye, Radio, datagrams, wait_for


@pytest.mark.parametrize("passphrase", [None, PASSPHRASE], ids=["open", "wpa2"])
@pytest.mark.parametrize("channel", [1, 36])
def test_both_ends_show_the_link(
    channel: int, passphrase: str | None, tmp_path: Path, robot: Radio, station: Radio, eyes: dict[str, Eye]
):
    air = Air(tmp_path)
    try:
        air.access_point(robot, "Füchse 🤖", channel, passphrase=passphrase)
        before = eyes["station"].quick().links[0]
        assert before.connected is False
        assert before.ssid is None
        air.station(station, "Füchse 🤖", [channel], passphrase=passphrase)
        datagrams("station", "10.1.0.1", 5)
        wait_for("the peer", lambda: eyes["robot"].quick().links[0].peer == station.mac)
        # the channel is read once a second or after refresh(); the last test's may still be remembered
        for eye in (eyes["station"], eyes["robot"]):
            wait_for("the channel", lambda eye=eye: eye.quick().links[0].frequency_mhz == FREQUENCIES[channel])
        client, host = eyes["station"].quick().links[0], eyes["robot"].quick()
        for link in (client, host.links[0]):
            assert link.connected
            assert link.ssid == "Füchse 🤖"
            assert link.frequency_mhz == FREQUENCIES[channel]
            assert link.bssid == robot.mac
            assert link.rssi_dbm == -30
        assert len(host.links) == 1
        assert host.stations[0].authorized
    finally:
        air.close()
    gone = eyes["station"].quick().links[0]
    assert gone.connected is False
    assert gone.rssi_dbm is None
    assert gone.unknown["rssi_dbm"].value == "not connected"
