"""nl80211 scan results: who else is on the air, and how their channels lie to ours.

Numbers: linux/nl80211.h (enum nl80211_bss). Elements: IEEE 802.11-2020, 9.4.2 (SSID 0, BSS Load 11, HT Operation 61,
VHT Operation 192, HE Operation extension 36).
"""

from __future__ import annotations

import errno
import struct
import time
from collections.abc import Iterator

import msgspec

from ..errors import ParseError
from ..records import Neighbour, Now, Overlap, ScanSnapshot, now
from .genetlink import GENL_HEADER, Genetlink, number
from .netlink import NetlinkError, attributes, pack, u32
from .nl80211_interface import ATTR_IFINDEX, WirelessInterface, ssid_text
from .nl80211_station import mac_text

CMD_GET_SCAN, CMD_TRIGGER_SCAN, CMD_NEW_SCAN_RESULTS, CMD_SCAN_ABORTED = 32, 33, 34, 35
ATTR_SCAN_FREQUENCIES, ATTR_SCAN_SSIDS, ATTR_BSS = 44, 45, 47
_BSSID, _FREQUENCY, _BEACON_INTERVAL, _ELEMENTS, _SIGNAL_MBM = 1, 2, 4, 6, 7
_STATUS, _SEEN, _BEACON_ELEMENTS = 9, 10, 11
_STATUS_ASSOCIATED = 1
_SLACK_MS = 200  # between the end of a scan and our reading of its results


def elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Information elements (id, body); a torn last one ends the list, as it may in a frame off the air."""
    offset = 0
    while offset + 2 <= len(data):
        length = data[offset + 1]
        body = data[offset + 2 : offset + 2 + length]
        if len(body) < length:
            return
        yield data[offset], body
        offset += 2 + length


def channel_mhz(channel: int, near_mhz: int) -> int:
    """Frequency of a channel number in the band of `near_mhz` (IEEE 802.11-2020, 17.3.8.4.2)."""
    if near_mhz < 3000:
        return 2484 if channel == 14 else 2407 + 5 * channel
    if near_mhz >= 5950:
        return 5950 + 5 * channel
    return 5000 + 5 * channel


def _place(frequency_mhz: int, found: dict[int, bytes]) -> tuple[float, int]:
    """Middle and width of the whole channel, from the operation elements."""
    vht = found.get(192, b"")
    if len(vht) >= 3 and vht[0] >= 1:
        middle, other = vht[1], vht[2]
        if vht[0] == 1 and other and abs(other - middle) == 8:
            return channel_mhz(other, frequency_mhz), 160
        return channel_mhz(middle, frequency_mhz), 160 if vht[0] == 2 else 80
    ht = found.get(61, b"")
    if len(ht) >= 2:
        secondary = ht[1] & 3
        if secondary == 1:
            return frequency_mhz + 10, 40
        if secondary == 3:
            return frequency_mhz - 10, 40
    return frequency_mhz, 20


def parse_bss(payload: bytes, file: str = "nl80211 scan") -> Neighbour | None:
    """One message of the scan dump, from its genlmsghdr on; None where it holds no BSS.

    Raises:
        ParseError: an attribute points outside the message or is too short, or BSSID or frequency are absent.
    """
    if len(payload) < GENL_HEADER:
        raise ParseError(file, "start", "a generic netlink header of 4 bytes", f"{len(payload)} bytes")
    nested = attributes(payload, file, GENL_HEADER).get(ATTR_BSS)
    if nested is None:
        return None
    bss = attributes(nested, file)
    bssid = bss.get(_BSSID, b"")
    if len(bssid) < 6:
        raise ParseError(file, "BSSID", "6 bytes", f"{len(bssid)} bytes")
    frequency_mhz = number(bss, _FREQUENCY, "=I", file)
    found = dict(elements(bss.get(_BEACON_ELEMENTS) or b""))
    found.update(elements(bss.get(_ELEMENTS) or b""))
    ssid = found.get(0, b"").strip(b"\0")
    load = found.get(11, b"")
    signal = bss.get(_SIGNAL_MBM)
    center_mhz, width_mhz = _place(frequency_mhz, found)
    if signal is not None and len(signal) < 4:
        raise ParseError(file, "signal", "4 bytes", f"{len(signal)} bytes")
    return Neighbour(
        bssid=mac_text(bssid),
        ssid=ssid_text(ssid) if ssid else None,
        frequency_mhz=frequency_mhz,
        center_mhz=float(center_mhz),
        width_mhz=width_mhz,
        rssi_dbm=None if signal is None else struct.unpack_from("=i", signal)[0] / 100 or None,
        seen_ms_ago=number(bss, _SEEN, "=I", file) if _SEEN in bss else None,
        beacon_interval_tu=number(bss, _BEACON_INTERVAL, "=H", file) if _BEACON_INTERVAL in bss else None,
        associated=_STATUS in bss and number(bss, _STATUS, "=I", file) == _STATUS_ASSOCIATED,
        load_stations=struct.unpack_from("<H", load)[0] if len(load) >= 5 else None,
        load_utilization=load[2] / 255 if len(load) >= 5 else None,
    )


def overlap(ours: WirelessInterface, other: Neighbour) -> Overlap | None:
    """How a neighbour's channel lies to ours; None where ours is not known.

    On 2.4 GHz a 20 MHz channel is counted as 22 MHz wide, which is what its spectral mask leaves.
    """
    if ours.frequency_mhz is None or other.center_mhz is None:
        return None
    if ours.frequency_mhz == other.frequency_mhz:
        return Overlap.CO_CHANNEL
    widths = [float(ours.width_mhz or 20), float(other.width_mhz or 20)]
    if ours.frequency_mhz < 3000:
        widths = [22.0 if width == 20 else width for width in widths]
    apart = abs((ours.center_mhz or ours.frequency_mhz) - other.center_mhz)
    return Overlap.ADJACENT if apart < sum(widths) / 2 else Overlap.NONE


def snapshot(
    iface: str, ours: WirelessInterface, found: list[Neighbour], at: Now, duration_ns: int | None = None
) -> ScanSnapshot:
    """Scan results with each neighbour's overlap; our own access point is in the list but not counted."""
    placed = tuple(msgspec.structs.replace(one, overlap=overlap(ours, one)) for one in found)
    others = [one for one in placed if not one.associated and one.bssid != ours.mac]
    known = ours.frequency_mhz is not None
    return ScanSnapshot(
        wall_ns=at.wall_ns,
        mono_ns=at.mono_ns,
        iface=iface,
        frequency_mhz=ours.frequency_mhz,
        width_mhz=ours.width_mhz,
        duration_ns=duration_ns,
        triggered=duration_ns is not None,
        neighbours=placed,
        co_channel=sum(one.overlap is Overlap.CO_CHANNEL for one in others) if known else None,
        adjacent=sum(one.overlap is Overlap.ADJACENT for one in others) if known else None,
    )


def scan_results(nl: Genetlink, ifindex: int) -> list[Neighbour]:
    """The kernel's list of what was heard lately. Disturbs nothing and needs no privileges.

    Raises:
        NetlinkError: ENODEV where the interface is absent or not wireless.
    """
    answers = nl.ask(CMD_GET_SCAN, pack(ATTR_IFINDEX, u32(ifindex)), dump=True, asked="scan results")
    return [one for one in map(parse_bss, answers) if one is not None]


def heard_within(found: list[Neighbour], took_ms: int) -> list[Neighbour]:
    """Those heard in a scan that took so long; the kernel's list keeps others for half a minute."""
    return [one for one in found if one.associated or one.seen_ms_ago is None or one.seen_ms_ago <= took_ms + _SLACK_MS]


class Scanner:
    """Scans without waiting: start(), then let the loop call `ready()` whenever `fileno()` is readable.

    A scan leaves the channel for some 30 to 110 ms a channel: traffic stands still meanwhile. Needs CAP_NET_ADMIN.

    Raises:
        FamilyAbsentError: this kernel has no nl80211.
    """

    def __init__(self, *, timeout_s: float = 30.0) -> None:
        self._ask = Genetlink("nl80211")
        self._listen = Genetlink("nl80211")
        self._listen.join("scan")
        self._timeout_ns = int(timeout_s * 1e9)
        self._began_ns: int | None = None
        self._ifindex = 0

    @property
    def busy(self) -> bool:
        """Whether a scan of ours is under way (one that never ends counts as failed after the time-out)."""
        return self._began_ns is not None and time.monotonic_ns() - self._began_ns < self._timeout_ns

    def fileno(self) -> int:
        """Readable when a scan may have ended."""
        return self._listen.fileno()

    def start(self, ifindex: int, frequencies_mhz: tuple[int, ...] = ()) -> None:
        """Begin a scan of all channels, or of some.

        Raises:
            NetlinkError: EPERM without CAP_NET_ADMIN, EBUSY while another program scans, ENETDOWN, EOPNOTSUPP.
        """
        payload = pack(ATTR_IFINDEX, u32(ifindex)) + pack(ATTR_SCAN_SSIDS, pack(1, b""))
        if frequencies_mhz:
            listed = b"".join(pack(place, u32(mhz)) for place, mhz in enumerate(frequencies_mhz))
            payload += pack(ATTR_SCAN_FREQUENCIES, listed)
        self._listen.pending()  # ends of earlier scans are not ours
        self._ask.ask(CMD_TRIGGER_SCAN, payload, asked="scan")
        self._began_ns, self._ifindex = time.monotonic_ns(), ifindex

    def ready(self, iface: str, ours: WirelessInterface) -> ScanSnapshot | None:
        """The snapshot if our scan has ended, else None.

        Raises:
            NetlinkError: the scan was aborted by somebody (ECANCELED).
        """
        found, _ = self._listen.pending()
        for payload in found:
            ended = payload[:1] in (bytes([CMD_NEW_SCAN_RESULTS]), bytes([CMD_SCAN_ABORTED]))
            if not ended or self._began_ns is None:
                continue
            about = attributes(payload, "scan event", GENL_HEADER)
            if ATTR_IFINDEX not in about or number(about, ATTR_IFINDEX, "=I", "scan event") != self._ifindex:
                continue
            took_ns, self._began_ns = time.monotonic_ns() - self._began_ns, None
            if payload[0] == CMD_SCAN_ABORTED:
                raise NetlinkError(errno.ECANCELED, "scan", "aborted by another program or the driver")
            found_now = heard_within(scan_results(self._ask, self._ifindex), took_ns // 1_000_000)
            return snapshot(iface, ours, found_now, now(), took_ns)
        return None

    def close(self) -> None:
        """Give back the sockets."""
        self._ask.close()
        self._listen.close()
