"""nl80211 multicast events as a timeline: association, roam, peers, CQM, channel, country, scans.

Numbers: linux/nl80211.h (enum nl80211_commands, groups mlme, config, regulatory, scan). The kernel puts no time on
these messages: an event's time is when it was read, which on an idle machine is well below a millisecond later.
"""

from __future__ import annotations

import contextlib
import socket
from typing import NamedTuple

from ..errors import ParseError
from ..records import EventKind, LinkEvent, Now, now
from .genetlink import GENL_HEADER, Genetlink, number, text
from .netlink import NetlinkError, attributes
from .nl80211 import Nl80211
from .nl80211_interface import CLIENT_MODES
from .nl80211_station import mac_text, parse_station

NEW_STATION, DEL_STATION = 19, 20
TRIGGER_SCAN, NEW_SCAN_RESULTS, SCAN_ABORTED = 33, 34, 35
REG_CHANGE, WIPHY_REG_CHANGE = 36, 113
CONNECT, ROAM, DISCONNECT, NOTIFY_CQM, CH_SWITCH_NOTIFY = 46, 47, 48, 64, 88

ATTR_WIPHY, ATTR_IFINDEX, ATTR_MAC, ATTR_STA_INFO, ATTR_REG_ALPHA2, ATTR_WIPHY_FREQ = 1, 3, 6, 21, 33, 38
ATTR_REG_INITIATOR, ATTR_REASON_CODE, ATTR_DISCONNECTED_BY_AP, ATTR_STATUS_CODE, ATTR_CQM = 48, 54, 71, 72, 94
ATTR_TIMED_OUT, ATTR_CHANNEL_WIDTH, ATTR_REG_TYPE = 65, 159, 49
CQM_RSSI_EVENT, CQM_PACKETS_LOST, CQM_BEACON_LOSS, CQM_RSSI_LEVEL = 3, 4, 8, 9
GROUPS = ("mlme", "config", "regulatory", "scan")

ROAM_WITHIN_NS = 10_000_000_000  # another access point after more than this is a new association, not a roam
REASONS = {  # IEEE 802.11-2020, table 9-49, those a robot meets
    1: "unspecified",
    2: "authentication no longer valid",
    3: "the other end is leaving",
    4: "inactivity",
    5: "the access point has too many stations",
    6: "frame before authentication",
    7: "frame before association",
    8: "the station is leaving the BSS",
    9: "not authenticated",
    14: "message integrity failure",
    15: "4-way handshake timed out (wrong passphrase, or a poor link)",
    16: "group key handshake timed out",
    23: "802.1X authentication failed",
    34: "poor channel conditions",
}
_INITIATORS = {0: "the kernel", 1: "a user", 2: "a driver", 3: "the access point's country element"}


class RawEvent(NamedTuple):
    """One message, its attributes taken apart. None where it does not hold one."""

    command: int
    wiphy: int | None = None
    ifindex: int | None = None
    mac: str | None = None
    reason: int | None = None
    status: int | None = None
    by_ap: bool = False
    timed_out: bool = False
    frequency_mhz: int | None = None
    alpha2: str | None = None
    initiator: int | None = None
    reg_type: int | None = None
    cqm_high: bool | None = None
    cqm_level_dbm: int | None = None
    packets_lost: int | None = None
    beacon_loss: bool = False
    rssi_dbm: float | None = None


def parse_event(payload: bytes, file: str = "nl80211 event") -> RawEvent:
    """One multicast message, from its genlmsghdr on; commands not known here come back with their number.

    Raises:
        ParseError: an attribute points outside the message or is too short.
    """
    if len(payload) < GENL_HEADER:
        raise ParseError(file, "start", "a generic netlink header of 4 bytes", f"{len(payload)} bytes")
    found = attributes(payload, file, GENL_HEADER)

    def take(kind: int, form: str) -> int | None:
        return number(found, kind, form, file) if kind in found else None

    command = payload[0]
    cqm = attributes(found.get(ATTR_CQM, b""), file)
    high = level = lost = None
    if CQM_RSSI_EVENT in cqm:
        high = number(cqm, CQM_RSSI_EVENT, "=I", file) == 1
    if CQM_RSSI_LEVEL in cqm:
        level = number(cqm, CQM_RSSI_LEVEL, "=i", file)
    if CQM_PACKETS_LOST in cqm:
        lost = number(cqm, CQM_PACKETS_LOST, "=I", file)
    mac = found.get(ATTR_MAC)
    rssi_dbm = None
    if command in (NEW_STATION, DEL_STATION) and ATTR_STA_INFO in found and mac is not None and len(mac) == 6:
        rssi_dbm = parse_station(payload, Now(0, 0), "", file, tids=False).rssi_dbm
    return RawEvent(
        command=command,
        wiphy=take(ATTR_WIPHY, "=I"),
        ifindex=take(ATTR_IFINDEX, "=I"),
        mac=mac_text(mac) if mac is not None and len(mac) >= 6 else None,
        reason=take(ATTR_REASON_CODE, "=H"),
        status=take(ATTR_STATUS_CODE, "=H"),
        by_ap=ATTR_DISCONNECTED_BY_AP in found,
        timed_out=ATTR_TIMED_OUT in found,
        frequency_mhz=take(ATTR_WIPHY_FREQ, "=I"),
        alpha2=text(found[ATTR_REG_ALPHA2])[:2] if ATTR_REG_ALPHA2 in found else None,
        initiator=take(ATTR_REG_INITIATOR, "=B"),
        reg_type=take(ATTR_REG_TYPE, "=B"),
        cqm_high=high,
        cqm_level_dbm=level,
        packets_lost=lost,
        beacon_loss=CQM_BEACON_LOSS in cqm,
        rssi_dbm=rssi_dbm,
    )


class LinkTimeline:
    """Turns one interface's messages into events; knows what came before, so that a roam is one and gaps have a length.

    mode is the interface's mode, bssid the access point a client is associated to now.
    """

    def __init__(self, iface: str, *, mode: str | None = None, bssid: str | None = None) -> None:
        self.iface = iface
        self.mode = mode
        self._bssid = bssid
        self._previous: str | None = None
        self._lost_ns: int | None = None
        self._left_ns: dict[str, int] = {}
        self._scan_ns: int | None = None

    def take(self, raw: RawEvent, at: Now) -> list[LinkEvent]:
        """The events of one message; none for those that say nothing of the link."""
        if raw.command == CONNECT:
            return self._connect(raw, at)
        if raw.command == DISCONNECT:
            return self._disconnect(raw, at)
        if raw.command == ROAM and raw.mac:
            previous, self._bssid = self._bssid, raw.mac
            detail = f"from {previous or 'an access point not known'} to {raw.mac}, by the driver"
            return [self._event(at, EventKind.ROAMED, detail, bssid=raw.mac, previous_bssid=previous)]
        if raw.command in (NEW_STATION, DEL_STATION) and raw.mac and self.mode not in CLIENT_MODES:
            return self._peer(raw, at)
        if raw.command == NOTIFY_CQM:
            return self._quality(raw, at)
        if raw.command == CH_SWITCH_NOTIFY:
            detail = f"to {raw.frequency_mhz} MHz" if raw.frequency_mhz else ""
            return [
                self._event(at, EventKind.CHANNEL_SWITCH, detail, frequency_mhz=raw.frequency_mhz, bssid=self._bssid)
            ]
        if raw.command in (REG_CHANGE, WIPHY_REG_CHANGE):
            country = raw.alpha2 or ("world" if raw.reg_type in (1, 2) else "an intersection of two countries")
            who = _INITIATORS.get(-1 if raw.initiator is None else raw.initiator, "somebody")
            return [self._event(at, EventKind.REGULATORY, f"{country}, set by {who}")]
        if raw.command in (TRIGGER_SCAN, NEW_SCAN_RESULTS, SCAN_ABORTED):
            return self._scan(raw, at)
        return []

    def _connect(self, raw: RawEvent, at: Now) -> list[LinkEvent]:
        if raw.timed_out or raw.status:
            why = "timed out" if raw.timed_out else f"refused with status {raw.status}"
            return [self._event(at, EventKind.DISCONNECTED, f"joining {why}", bssid=raw.mac, reason_code=None)]
        gap_ns = _since(self._lost_ns, at)
        before = self._bssid or self._previous
        roamed = before is not None and raw.mac != before and (gap_ns or 0) <= ROAM_WITHIN_NS
        self._bssid, self._previous, self._lost_ns = raw.mac, None, None
        after = "" if gap_ns is None else f" after {gap_ns / 1e9:.3g} s"
        if roamed:
            detail = f"from {before} to {raw.mac}{after}"
            return [self._event(at, EventKind.ROAMED, detail, bssid=raw.mac, previous_bssid=before, gap_ns=gap_ns)]
        detail = f"to {raw.mac}{after}"
        return [self._event(at, EventKind.ASSOCIATED, detail, bssid=raw.mac, previous_bssid=before, gap_ns=gap_ns)]

    def _disconnect(self, raw: RawEvent, at: Now) -> list[LinkEvent]:
        if self._bssid is not None:
            self._previous, self._bssid, self._lost_ns = self._bssid, None, at.mono_ns
        who = "by the access point" if raw.by_ap else "by this end"
        reason = "" if not raw.reason else f", reason {raw.reason} ({REASONS.get(raw.reason, 'see IEEE 802.11')})"
        return [
            self._event(
                at,
                EventKind.DISCONNECTED,
                f"{who}{reason}",
                bssid=self._previous,
                reason_code=raw.reason or None,
                locally_generated=not raw.by_ap,
            )
        ]

    def _peer(self, raw: RawEvent, at: Now) -> list[LinkEvent]:
        assert raw.mac is not None
        if raw.command == DEL_STATION:
            self._left_ns[raw.mac] = at.mono_ns
            return [self._event(at, EventKind.PEER_LEFT, "", peer=raw.mac, rssi_dbm=raw.rssi_dbm)]
        left_ns = self._left_ns.pop(raw.mac, None)
        gap_ns = _since(left_ns, at)
        detail = "" if gap_ns is None else f"back after {gap_ns / 1e9:.3g} s"
        return [self._event(at, EventKind.PEER_JOINED, detail, peer=raw.mac, rssi_dbm=raw.rssi_dbm, gap_ns=gap_ns)]

    def _quality(self, raw: RawEvent, at: Now) -> list[LinkEvent]:
        if raw.beacon_loss:
            return [self._event(at, EventKind.BEACON_LOSS, "beacons stopped", bssid=self._bssid)]
        if raw.packets_lost is not None:
            detail = f"{raw.packets_lost} frames in a row not acknowledged"
            return [self._event(at, EventKind.CQM_LOW, detail, peer=raw.mac, bssid=self._bssid)]
        if raw.cqm_high is None:
            return []
        level = None if not raw.cqm_level_dbm else float(raw.cqm_level_dbm)
        kind = EventKind.CQM_HIGH if raw.cqm_high else EventKind.CQM_LOW
        return [self._event(at, kind, "rssi crossed a threshold", bssid=self._bssid, rssi_dbm=level)]

    def _scan(self, raw: RawEvent, at: Now) -> list[LinkEvent]:
        """Whoever asked for it: a scan leaves the channel. gap_ns is how long the whole scan took."""
        if raw.command == TRIGGER_SCAN:
            self._scan_ns = at.mono_ns
            return []
        took_ns = _since(self._scan_ns, at)
        self._scan_ns = None
        ended = "aborted" if raw.command == SCAN_ABORTED else "done"
        detail = ended if took_ns is None else f"{ended}, took {took_ns / 1e9:.3g} s, on and off the channel"
        return [self._event(at, EventKind.SCAN, detail, gap_ns=took_ns)]

    def _event(
        self,
        at: Now,
        kind: EventKind,
        detail: str,
        *,
        peer: str | None = None,
        bssid: str | None = None,
        previous_bssid: str | None = None,
        reason_code: int | None = None,
        locally_generated: bool | None = None,
        frequency_mhz: int | None = None,
        rssi_dbm: float | None = None,
        gap_ns: int | None = None,
    ) -> LinkEvent:
        return LinkEvent(
            wall_ns=at.wall_ns,
            mono_ns=at.mono_ns,
            iface=self.iface,
            kind=kind,
            detail=detail,
            peer=peer,
            bssid=bssid,
            previous_bssid=previous_bssid,
            reason_code=reason_code,
            locally_generated=locally_generated,
            frequency_mhz=frequency_mhz,
            rssi_dbm=rssi_dbm,
            gap_ns=gap_ns,
        )


def _since(then_ns: int | None, at: Now) -> int | None:
    """Time since an earlier message; None where both were read at once, so that their distance is not known."""
    return None if then_ns is None or at.mono_ns == then_ns else at.mono_ns - then_ns


class RadioEvents:
    """Listens for one interface. Register `fileno()` with a loop and call `events()` when it is readable.

    Raises:
        FamilyAbsentError: this kernel has no nl80211.
        NetlinkError: generic netlink cannot be reached.
    """

    def __init__(self, iface: str) -> None:
        # A burst of station events must not be lost while the loop is busy with a slow disk.
        self._nl = Genetlink("nl80211", receive_buffer=1 << 20)
        for group in GROUPS:
            self._nl.join(group)
        self._reader = Nl80211()
        self.damaged = 0
        self._timeline = LinkTimeline(iface)
        self._ifindex: int | None = None
        self._wiphy: int | None = None
        self._look()
        with contextlib.suppress(NetlinkError):
            peers = self._reader.stations(iface) if self._timeline.mode in CLIENT_MODES else []
            self._timeline = LinkTimeline(
                iface, mode=self._timeline.mode, bssid=peers[0].peer if peers and peers[0].associated else None
            )

    def fileno(self) -> int:
        """Readable when events are there."""
        return self._nl.fileno()

    def events(self) -> list[LinkEvent]:
        """What happened since the last call. Damaged messages are counted in `damaged` and left out."""
        payloads, lost = self._nl.pending()
        at = now()
        found: list[LinkEvent] = []
        if lost:
            found.append(
                LinkEvent(
                    wall_ns=at.wall_ns,
                    mono_ns=at.mono_ns,
                    iface=self._timeline.iface,
                    kind=EventKind.RECORDING,
                    detail="nl80211 events were lost: they came faster than they were read",
                )
            )
        for payload in payloads:
            try:
                raw = parse_event(payload)
            except ParseError:
                self.damaged += 1
                continue
            if self._ours(raw):
                found += self._timeline.take(raw, at)
        return found

    def _ours(self, raw: RawEvent) -> bool:
        if raw.command == REG_CHANGE:
            return True
        if raw.command == WIPHY_REG_CHANGE:
            return raw.wiphy == self._wiphy
        if raw.ifindex is None:
            return False
        if raw.ifindex != self._ifindex or raw.command == NEW_STATION or self._timeline.mode is None:
            self._look()  # the interface may be new, or an access point since
        return raw.ifindex == self._ifindex

    def _look(self) -> None:
        try:
            self._ifindex = socket.if_nametoindex(self._timeline.iface)
            info = self._reader.interface(self._timeline.iface)
        except (OSError, NetlinkError):
            return  # not there now: what was known of it still names its last messages
        self._timeline.mode, self._wiphy = info.mode, info.wiphy

    def close(self) -> None:
        """Give back the sockets."""
        self._nl.close()
        self._reader.close()
