"""Takes the kernel's answers and events off the wire in the guest, as the fixtures of tests/sources.

python -m tests.wifi.recapture makes tests/sources/captured/nl80211.json anew.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from linkrover.sources.genetlink import Genetlink
from linkrover.sources.netlink import NetlinkError, pack, u32
from linkrover.sources.nl80211_events import GROUPS

from .air import PASSPHRASE, Air, Radio, datagrams, inside, radios, run, scan

NAMESPACES = ["robot", "station", "robot2"]
RATES = {
    "legacy": {"legacy": True},
    "ht": {"more": "ht_capab=[HT40+][SHORT-GI-20][SHORT-GI-40]"},
    "vht": {"more": "ht_capab=[HT40+]\nieee80211ac=1\nvht_oper_chwidth=1\nvht_oper_centr_freq_seg0_idx=42"},
    "he": {
        "more": "ht_capab=[HT40+]\nieee80211ac=1\nieee80211ax=1\nvht_oper_chwidth=1\nvht_oper_centr_freq_seg0_idx=42\n"
        "he_oper_chwidth=1\nhe_oper_centr_freq_seg0_idx=42"
    },
}


def _ask(nl: Genetlink, command: int, payload: bytes, *, dump: bool = False) -> list[str]:
    try:
        return [one.hex() for one in nl.ask(command, payload, dump=dump)]
    except NetlinkError:
        return []


def _answers(radio: Radio) -> dict[str, Any]:
    with inside(radio.ns):
        import socket

        nl = Genetlink("nl80211")
        index = pack(3, u32(socket.if_nametoindex(radio.iface)))
    found: dict[str, Any] = {
        "interface": _ask(nl, 5, index),
        "station": _ask(nl, 17, index, dump=True),
        "survey": _ask(nl, 50, index, dump=True),
        "power_save": _ask(nl, 62, index),
        "regulatory": _ask(nl, 31, b""),
        "scan": _ask(nl, 32, index, dump=True),
        "iw_station": run("iw", "dev", radio.iface, "station", "dump", ns=radio.ns),
        "iw_info": run("iw", "dev", radio.iface, "info", ns=radio.ns),
        "iw_survey": run("iw", "dev", radio.iface, "survey", "dump", ns=radio.ns),
        "iw_scan": run("iw", "dev", radio.iface, "scan", "dump", ns=radio.ns),
    }
    nl.close()
    return found


def main() -> None:
    """Capture and write /result/captured.json."""
    robot, station, robot2 = made = radios(3, NAMESPACES)
    for place, radio in enumerate(made, 1):
        radio.address(f"10.1.0.{place}/24")
    found: dict[str, Any] = {}
    for name, options in RATES.items():
        folder = Path("/tmp") / name
        folder.mkdir(exist_ok=True)
        air = Air(folder)
        passphrase = None if name == "legacy" else PASSPHRASE
        air.access_point(robot, f"rate {name}", 36, passphrase=passphrase, **options)  # type: ignore[arg-type]
        air.station(station, f"rate {name}", [36], passphrase=passphrase)
        robot.level(-47)
        station.level(-61)
        datagrams("station", "10.1.0.1", 150)
        datagrams("robot", "10.1.0.2", 150)
        time.sleep(0.5)
        scan(station, 5180)
        found[name] = {radio.ns: _answers(radio) for radio in (robot, station)}
        air.close()
    found["events"] = _events(robot, station, robot2)
    Path("/result/captured.json").write_text(json.dumps(found, indent=1))


def _events(robot: Radio, station: Radio, robot2: Radio) -> dict[str, list[str]]:
    ears = {}
    for radio in (robot, station):
        with inside(radio.ns):
            ears[radio.ns] = Genetlink("nl80211", receive_buffer=1 << 20)
        for group in GROUPS:
            ears[radio.ns].join(group)
    folder = Path("/tmp/events")
    folder.mkdir(exist_ok=True)
    air = Air(folder)
    air.access_point(robot, "events", 1, more="bss_load_update_period=1")
    client = air.station(station, "events", [1, 6], more='bgscan="simple:1:-65:20"')
    control = f"/run/hostapd-{robot.iface}"
    run("hostapd_cli", "-p", control, "-i", robot.iface, "deauthenticate", station.mac, "reason=5", ns="robot")
    client.wait_said("DISCONNECTED")
    time.sleep(2)
    run("iw", "reg", "set", "DE")
    time.sleep(0.5)
    run("iw", "reg", "set", "US")
    air.access_point(robot2, "events", 6)
    robot.level(-75)
    client.wait_said(f"Connection to {robot2.mac}", 60)
    time.sleep(0.5)
    run("hostapd_cli", "-p", f"/run/hostapd-{robot2.iface}", "-i", robot2.iface, "chan_switch", 5, 2462, ns="robot2")
    time.sleep(2)
    air.daemons[-1].stop(at_once=True)
    run("ip", "link", "set", robot2.iface, "down", ns="robot2")
    client.wait_said("DISCONNECTED bssid=" + robot2.mac, 60)
    time.sleep(0.5)
    air.close()
    return {ns: [one.hex() for one in ear.pending()[0]] for ns, ear in ears.items()}


if __name__ == "__main__":
    main()
