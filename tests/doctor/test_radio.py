import pytest

from linkrover.doctor import radio
from linkrover.doctor.finding import Status
from linkrover.records import Bitrate, StationLink

OK, WARN, FAIL, UNKNOWN = Status.OK, Status.WARN, Status.FAIL, Status.UNKNOWN


@pytest.mark.parametrize(
    ("dbm", "status"), [(-40, OK), (-67, OK), (-70, WARN), (-75, WARN), (-80, FAIL), (None, UNKNOWN)]
)
def test_signal_is_judged_by_its_strength(dbm, status):
    found = radio.signal(dbm, "wlan0")
    assert found.status is status
    assert (found.mend is None) == (status in (OK, UNKNOWN))


def test_an_old_signal_says_how_old_it_is():
    assert "30 s old" in radio.signal(-50, "wlan0", inactive_ms=30_000).value


def test_an_access_point_lists_each_peer_and_says_when_there_is_none():
    peers = [
        StationLink(wall_ns=0, mono_ns=0, iface="ap0", peer=f"02:00:00:00:00:0{n}", rssi_dbm=-50.0 - n * 20)
        for n in (0, 1, 2)
    ]
    found = radio.stations(peers, "ap0")
    assert [f.status for f in found] == [OK, WARN, FAIL]
    assert "02:00:00:00:00:02" in found[2].value
    assert radio.stations([], "ap0")[0].status is UNKNOWN


@pytest.mark.parametrize(("mbps", "status"), [(300, OK), (12, WARN), (1, FAIL)])
def test_bit_rate(mbps, status):
    found = radio.rate(Bitrate(rate_bps=mbps * 1_000_000, mcs=7, nss=2), "wlan0")
    assert found.status is status
    assert f"{mbps} Mbit/s (MCS 7, streams 2)" in found.value.replace("MCS 7 streams", "MCS 7, streams")
    assert radio.rate(None, "wlan0").status is UNKNOWN


@pytest.mark.parametrize(
    ("mhz", "width", "status", "says"),
    [
        (5180, 80, OK, "channel 36"),
        (5180, 160, WARN, "40 or 80"),
        (2437, 20, WARN, "5 GHz"),
        (2437, 40, WARN, "20 MHz on 2.4"),
        (2447, 20, WARN, "1, 6 or 11"),
        (6115, 80, OK, "channel 33"),
        (2484, 20, WARN, "1, 6 or 11"),
        (None, None, UNKNOWN, "not connected"),
    ],
)
def test_channel_and_width(mhz, width, status, says):
    found = radio.channel(mhz, width, "wlan0")
    assert found.status is status
    assert says in f"{found.value} {found.mend}"


@pytest.mark.parametrize(
    ("mhz", "width", "status"),
    [
        (5180, 20, OK),
        (5260, 20, WARN),
        (5500, 20, WARN),
        (5745, 20, OK),
        (5210, 160, WARN),
        (2437, 20, OK),
        (None, None, UNKNOWN),
    ],
)
def test_radar_channels_are_known_by_what_the_width_covers(mhz, width, status):
    assert radio.dfs(mhz, width, "wlan0").status is status


def test_power_save_fails_for_a_client_and_not_for_an_access_point():
    found = radio.power_save(True, "station", "wlan0")
    assert found.status is FAIL
    assert found.mend.startswith("sudo iw dev wlan0 set power_save off")
    assert radio.power_save(False, "station", "wlan0").status is OK
    assert radio.power_save(None, "station", "wlan0").status is UNKNOWN
    assert radio.power_save(None, "ap", "wlan0").status is OK


def test_an_unset_regulatory_domain_warns():
    assert radio.regulatory("00", None).status is WARN
    assert "iw reg set" in radio.regulatory("00", None).mend
    assert radio.regulatory("DE", "ETSI").status is OK
    assert radio.regulatory(None, None).status is UNKNOWN


def test_bluetooth_matters_on_2_4_ghz_while_it_is_on():
    assert radio.bluetooth([], None, 2437, "wlan0").status is OK
    assert radio.bluetooth(["hci0"], True, 2437, "wlan0").status is OK
    assert radio.bluetooth(["hci0"], False, 2437, "wlan0").status is WARN
    assert radio.bluetooth(["hci0"], False, 5180, "wlan0").status is OK
    assert radio.bluetooth(["hci0"], None, None, "wlan0").status is UNKNOWN


@pytest.mark.parametrize(("share", "status"), [(0.1, OK), (0.6, WARN), (0.9, FAIL), (None, UNKNOWN)])
def test_a_busy_channel(share, status):
    assert radio.busy(share, "wlan0").status is status


def test_driver_and_firmware_are_named():
    assert radio.driver("iwlwifi", "6.1", "77.2", "wlan0").value == "wlan0: iwlwifi (version 6.1, firmware 77.2)"
    assert radio.driver(None, None, None, "wlan0").status is UNKNOWN
