"""The doctor on a real 802.11 stack: a robot that sleeps and hears little on a crowded band, and its access point."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from linkrover.doctor.examine import Examination
from linkrover.doctor.finding import run_checks
from linkrover.doctor.render import as_json

from .air import Air, Radio, datagrams, enter, run, wait_for

RADIO_LINES = {
    "radio", "driver and firmware", "signal", "bit rate", "channel and width", "channel busy", "DFS", "power save",
    "regulatory domain", "bluetooth coexistence", "reading the radio",
}  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def cell(air: Air, station: Radio, robot: Radio) -> None:
    air.access_point(station, "clinic", 1)
    air.station(robot, "clinic", [1])
    datagrams("robot", "10.1.0.2", 3)


def page(radio: Radio) -> dict[str, dict]:
    """The radio's part of the page as the doctor sees it from inside the radio's namespace; forked, as starting
    Python anew takes long here."""
    path = Path(f"/tmp/doctor-{radio.ns}.json")
    pid = os.fork()
    if pid == 0:
        status = 99
        try:
            enter(radio.ns)
            checks = [c for c in Examination(interface=radio.iface, environ={}).checks() if c.name in RADIO_LINES]
            path.write_text(as_json(run_checks(checks)))
            status = 0
        finally:
            os._exit(status)
    assert os.waitpid(pid, 0)[1] == 0
    return {finding["check"]: finding for finding in json.loads(path.read_text())["findings"]}


def test_power_save_a_weak_signal_and_the_crowded_band_are_found_with_what_mends_them(robot: Radio, station: Radio):
    station.level(-72)  # the robot hears the access point so
    run("iw", "dev", robot.iface, "set", "power_save", "on", ns="robot")
    found: dict[str, dict] = {}

    def weak() -> bool:
        found.update(page(robot))
        return "-72 dBm" in found["signal"]["value"]

    wait_for("the weak signal", weak, 20, 0.5)
    assert not [f for f in found.values() if f["failed"]]
    assert found["signal"]["status"] == "WARN"
    assert found["power save"]["status"] == "FAIL"
    assert found["channel and width"]["status"] == "WARN"
    assert "channel 1 (2412 MHz)" in found["channel and width"]["value"]
    assert found["DFS"]["status"] == "OK"
    assert found["regulatory domain"]["status"] == "OK"
    assert found["regulatory domain"]["value"].startswith("US")
    assert "Mbit/s" in found["bit rate"]["value"]
    assert "mac80211_hwsim" in found["driver and firmware"]["value"]
    assert found["reading the radio"]["status"] == "OK"
    command = found["power save"]["mend"].partition(";")[0].removeprefix("sudo ")
    run(*command.split(), ns="robot")
    assert page(robot)["power save"]["status"] == "OK", "the command it gave mended it"


def test_an_access_point_is_judged_by_each_of_its_robots(robot: Radio, station: Radio):
    station.level(-30)
    robot.level(-55)
    datagrams("robot", "10.1.0.2", 3)

    def heard() -> bool:
        datagrams("robot", "10.1.0.2", 1)
        return f"peer {robot.mac}: -55 dBm" in page(station)["signal"]["value"]

    wait_for("the robot's signal", heard, 20, 0.5)
    found = page(station)
    assert found["signal"]["status"] == "OK"
    assert found["power save"]["value"].endswith("an access point does not sleep")
