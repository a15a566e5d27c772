"""Checks of a wireless interface. Pure: facts in, findings out."""

from __future__ import annotations

from linkrover.records import Bitrate, StationLink

from .finding import Finding, Status, judged, ok, unknown

SIGNAL_GOOD_DBM, SIGNAL_BAD_DBM = -67.0, -75.0
RATE_GOOD_BPS, RATE_BAD_BPS = 24e6, 6.5e6
BUSY_GOOD, BUSY_BAD = 0.5, 0.8
STALE_MS = 10_000
BAND_5_MHZ, BAND_6_MHZ = 4_900, 5_925
CLEAR_2_4 = (1, 6, 11)
# 5250-5350 and 5470-5725 MHz: radar detection is obligatory (ETSI EN 301 893, FCC 15.407)
DFS_MHZ = ((5_250, 5_350), (5_470, 5_725))


def driver(name: str | None, version: str | None, firmware: str | None, iface: str) -> Finding:
    """Driver and firmware: to know what one has."""
    why = "drivers differ in roaming, power save and in what they report; compare runs on the same firmware only"
    if name is None:
        return unknown("driver and firmware", f"{iface}: the driver does not say", why)
    said = ", ".join(f"{what} {value}" for what, value in (("version", version), ("firmware", firmware)) if value)
    return ok("driver and firmware", f"{iface}: {name}" + (f" ({said})" if said else ""), why)


def signal(rssi_dbm: float | None, iface: str, peer: str | None = None, inactive_ms: int | None = None) -> Finding:
    """Signal strength of the link, or of one peer of an access point."""
    who = iface if peer is None else f"{iface}, peer {peer}"
    why = (
        "below -67 dBm rates fall, below -75 dBm a moving robot loses frames and roams; fading of 10 dB within a metre "
        "is normal"
    )
    if rssi_dbm is None:
        return unknown("signal", f"{who}: not given (not connected, or the driver does not tell)", why)
    age = ""
    if inactive_ms is not None and inactive_ms > STALE_MS:
        age = f", {inactive_ms / 1000:.0f} s old"
    if rssi_dbm >= SIGNAL_GOOD_DBM:
        status = Status.OK
    else:
        status = Status.WARN if rssi_dbm >= SIGNAL_BAD_DBM else Status.FAIL
    mend = "move the access point higher or nearer, turn or extend the antenna, or add an access point"
    return judged("signal", status, f"{who}: {rssi_dbm:.0f} dBm{age}", why, mend)


def rate(bitrate: Bitrate | None, iface: str) -> Finding:
    """Transmit bit rate of the link."""
    why = "a camera and a 3D lidar need some 40 Mbit/s; goodput is about half the bit rate, and falls with every retry"
    if bitrate is None or bitrate.rate_bps is None:
        return unknown("bit rate", f"{iface}: not given", why)
    if bitrate.rate_bps >= RATE_GOOD_BPS:
        status = Status.OK
    else:
        status = Status.WARN if bitrate.rate_bps >= RATE_BAD_BPS else Status.FAIL
    detail = " ".join(
        f"{name} {value}" for name, value in (("MCS", bitrate.mcs), ("streams", bitrate.nss)) if value is not None
    )
    value = f"{iface}: {bitrate.rate_bps / 1e6:g} Mbit/s" + (f" ({detail})" if detail else "")
    return judged("bit rate", status, value, why, "raise the signal first; then look for interference on the channel")


def channel(frequency_mhz: int | None, width_mhz: int | None, iface: str) -> Finding:
    """Channel and width."""
    why = "2.4 GHz has three channels for everybody and their kettles; the wider the channel, the more it hears"
    if frequency_mhz is None:
        return unknown("channel and width", f"{iface}: not connected, or the driver does not tell", why)
    number = channel_number(frequency_mhz)
    value = f"{iface}: channel {number} ({frequency_mhz} MHz)" + (f", {width_mhz} MHz wide" if width_mhz else "")
    if frequency_mhz < BAND_5_MHZ:
        if width_mhz is not None and width_mhz > 20:
            return judged(
                "channel and width", Status.WARN, value, why, "set the access point to 20 MHz on 2.4 GHz, or use 5 GHz"
            )
        if number not in CLEAR_2_4:
            return judged(
                "channel and width", Status.WARN, value, why, "set the access point to channel 1, 6 or 11, or use 5 GHz"
            )
        return judged("channel and width", Status.WARN, value, why, "use 5 GHz where the access point has it")
    if width_mhz is not None and width_mhz > 80:
        return judged("channel and width", Status.WARN, value, why, "set the access point to 40 or 80 MHz")
    return ok("channel and width", value, why)


def dfs(frequency_mhz: int | None, width_mhz: int | None, iface: str) -> Finding:
    """Whether the channel must be left for radar."""
    why = (
        "on a radar (DFS) channel the access point must leave at once when it believes to hear radar, and listen for a "
        "minute before it sends again: the robot is offline meanwhile"
    )
    if frequency_mhz is None:
        return unknown("DFS", f"{iface}: channel not known", why)
    half = (width_mhz or 20) / 2
    hit = any(low < frequency_mhz + half and frequency_mhz - half < high for low, high in DFS_MHZ)
    value = f"{iface}: {frequency_mhz} MHz is {'a' if hit else 'not a'} radar channel"
    mend = "set the access point to channel 36, 40, 44 or 48 (or 149 to 165 where allowed)"
    return judged("DFS", Status.WARN if hit else Status.OK, value, why, mend)


def power_save(on: bool | None, mode: str | None, iface: str) -> Finding:
    """Power save of a client."""
    why = (
        "a client that sleeps gets what is sent to it only at the next beacon: commands wait 100 ms and more, and some "
        "access points drop them"
    )
    if mode in ("ap", "p2p-go", "mesh"):
        return ok("power save", f"{iface}: an access point does not sleep", why)
    if on is None:
        return unknown("power save", f"{iface}: the driver does not tell", why, f"iw dev {iface} get power_save")
    mend = (
        f"sudo iw dev {iface} set power_save off; for good with NetworkManager: nmcli connection modify "
        "NAME 802-11-wireless.powersave 2"
    )
    return judged("power save", Status.FAIL if on else Status.OK, f"{iface}: {'on' if on else 'off'}", why, mend)


def regulatory(alpha2: str | None, dfs_region: str | None) -> Finding:
    """Regulatory domain."""
    why = "with no country set the kernel allows only what is legal everywhere: less power, fewer 5 GHz channels"
    if alpha2 is None:
        return unknown("regulatory domain", "not known", why, "iw reg get")
    if alpha2 in ("00", "99"):
        return judged(
            "regulatory domain", Status.WARN, f"unset ({alpha2}, the world domain)", why,
            "sudo iw reg set XX (your country's two letters)",
        )  # fmt: skip
    return ok("regulatory domain", alpha2 + (f", DFS rules {dfs_region}" if dfs_region else ""), why)


def bluetooth(controllers: list[str], blocked: bool | None, frequency_mhz: int | None, iface: str) -> Finding:
    """Bluetooth beside 2.4 GHz Wi-Fi."""
    why = "bluetooth hops over the same 2.4 GHz band, often through the same antenna: gamepads and headsets cost Wi-Fi"
    name = "bluetooth coexistence"
    if not controllers:
        return ok(name, "no bluetooth controller", why)
    if blocked:
        return ok(name, f"{', '.join(controllers)}: switched off", why)
    if frequency_mhz is None:
        return unknown(name, f"{', '.join(controllers)} is on; the channel of {iface} is not known", why)
    if frequency_mhz >= BAND_5_MHZ:
        return ok(name, f"{', '.join(controllers)} is on, {iface} is not on 2.4 GHz", why)
    return judged(
        name, Status.WARN, f"{', '.join(controllers)} is on and {iface} is on 2.4 GHz", why,
        "sudo rfkill block bluetooth, or use 5 GHz",
    )  # fmt: skip


def busy(utilization: float | None, iface: str) -> Finding:
    """Share of time the channel was busy, from two surveys."""
    why = "others' frames on the channel are waiting time for the robot's"
    if utilization is None:
        return unknown("channel busy", f"{iface}: this driver does not give it", why)
    if utilization < BUSY_GOOD:
        status = Status.OK
    else:
        status = Status.WARN if utilization < BUSY_BAD else Status.FAIL
    mend = "set the access point to a quieter channel (sudo iw dev IFACE scan shows who is where)"
    return judged("channel busy", status, f"{iface}: {utilization * 100:.0f} % of the time", why, mend)


def stations(found: list[StationLink], iface: str) -> list[Finding]:
    """Signal of each peer of an access point."""
    if not found:
        return [unknown("signal", f"{iface}: an access point with nobody connected")]
    return [signal(one.rssi_dbm, iface, one.peer, one.inactive_ms) for one in found]


def channel_number(frequency_mhz: int) -> int:
    """IEEE 802.11 channel number of a frequency."""
    if frequency_mhz == 2_484:
        return 14
    if frequency_mhz < BAND_5_MHZ:
        return (frequency_mhz - 2_407) // 5
    return (frequency_mhz - (5_000 if frequency_mhz < BAND_6_MHZ else 5_950)) // 5
