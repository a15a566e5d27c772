"""Reads the radio from the kernel by nl80211: link, peers, channel, power save, regulatory domain.

Reading needs no privileges. What changes with every frame (the station dump) is asked at every sample; what changes
rarely (channel, tx power, survey, power save) once a second, the country every ten seconds, both after `refresh()`.
"""

from __future__ import annotations

import errno
import socket
from typing import NamedTuple

import msgspec

from ..records import ChannelSurvey, Now, RadioCapability, StationLink, Unknown, WirelessLink, now
from .genetlink import Genetlink
from .netlink import NetlinkError, pack, u32
from .nl80211_interface import (
    ATTR_IFINDEX,
    ATTR_MAC,
    ATTR_WIPHY,
    CLIENT_MODES,
    Regulatory,
    WirelessInterface,
    parse_interface,
    parse_power_save,
    parse_regulatory,
    parse_survey,
)
from .nl80211_link import ALL_FIELDS, Settings, links, settings
from .nl80211_scan import scan_results
from .nl80211_station import parse_station

CMD_GET_INTERFACE, CMD_GET_STATION, CMD_GET_REG, CMD_GET_SURVEY, CMD_GET_POWER_SAVE = 5, 17, 31, 50, 62

GONE = (errno.ENODEV, errno.ENXIO)
_NOT_GIVEN = (errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOENT)
_RARE_PERIOD_NS = 10_000_000_000  # the country's rules are the longest answer of all, and what a driver gives is fixed


class RadioSample(NamedTuple):
    """One reading. surveys is empty where the slow values were not due. links has at least one entry."""

    links: tuple[WirelessLink, ...]
    stations: tuple[StationLink, ...]
    surveys: tuple[ChannelSurvey, ...]


class _Peer:
    """When a peer was last heard, as far as its counters tell."""

    __slots__ = ("fresh_ns", "heard")

    def __init__(self, heard: tuple[int | None, int | None]) -> None:
        self.heard = heard
        self.fresh_ns: int | None = None


class _Interface:
    """What is remembered of one interface between samples."""

    def __init__(self, index: int) -> None:
        self.index = index
        self.due_ns = 0
        self.rare_due_ns = 0
        self.settings: Settings | None = None
        self.alpha2: str | None = None
        self.peers: dict[str, _Peer] = {}
        self.ssid: str | None = None
        self.ssid_of: str | None = None  # the access point whose SSID that is
        self.busy: dict[int, tuple[int, int]] = {}


class Nl80211:
    """The radio of this network namespace.

    stale_after_ms: a peer not heard for so long has an old RSSI. slow_period_ns: how often rare things are asked.

    Raises:
        FamilyAbsentError: this kernel has no nl80211 (no wireless driver is loaded).
        NetlinkError: generic netlink cannot be reached.
    """

    def __init__(self, *, stale_after_ms: int = 1000, slow_period_ns: int = 1_000_000_000) -> None:
        self._nl = Genetlink("nl80211")
        self._stale_after_ms = stale_after_ms
        self._slow_period_ns = slow_period_ns
        self._known: dict[str, _Interface] = {}
        self._given: dict[str, set[str]] = {}

    def interfaces(self) -> list[WirelessInterface]:
        """Every wireless interface of this namespace."""
        answers = self._nl.ask(CMD_GET_INTERFACE, dump=True, asked="list wireless interfaces")
        return [parse_interface(one) for one in answers]

    def interface(self, iface: str) -> WirelessInterface:
        """One interface.

        Raises:
            NetlinkError: ENODEV where it is absent or not wireless.
        """
        return self._interface(_index(iface))

    def stations(self, iface: str) -> list[StationLink]:
        """The station dump: the access point of a client, or every client of an access point.

        Raises:
            NetlinkError: ENODEV where the interface is absent or not wireless.
        """
        return self._stations(_index(iface), iface, now())

    def surveys(self, iface: str) -> list[ChannelSurvey]:
        """The survey dump, raw (utilization needs two of them: see read()). Empty where the driver has none.

        Raises:
            NetlinkError: ENODEV where the interface is absent or not wireless.
        """
        return self._surveys(_index(iface), iface, now())

    def power_save(self, iface: str) -> bool | None:
        """Power-save state, None where the driver does not tell.

        Raises:
            NetlinkError: ENODEV where the interface is absent or not wireless.
        """
        return self._power_save(_index(iface))

    def regulatory(self, wiphy: int | None = None) -> Regulatory:
        """The regulatory domain in force, of one radio or the global one."""
        payload = b"" if wiphy is None else pack(ATTR_WIPHY, u32(wiphy))
        return parse_regulatory(self._nl.one(CMD_GET_REG, payload, asked="regulatory domain"))

    def wireless_link(self, iface: str) -> WirelessLink:
        """The link of an interface; on an access point of its first peer. All of it: read()."""
        return self.read(iface).links[0]

    def refresh(self, iface: str | None = None) -> None:
        """Ask the rare things again at the next read(), of one interface or of all: an event says they changed."""
        for name, state in self._known.items():
            if iface in (None, name):
                state.due_ns = state.rare_due_ns = 0
                state.ssid_of = None

    def read(self, iface: str, at: Now | None = None) -> RadioSample:
        """One sample of the interface that has this name now.

        A client has one link, to its access point. An access point has one link per peer, or one without a peer
        while nobody is there. An absent interface gives one link with the reason ABSENT.

        Raises:
            NetlinkError: the kernel did not answer for another reason than an absent interface.
            ParseError: the kernel's answer is damaged.
        """
        at = at or now()
        try:
            return self.read_index(iface, _index(iface), at)
        except NetlinkError as reason:
            if reason.code not in GONE:
                raise
            self._known.pop(iface, None)
            unknown = dict.fromkeys(ALL_FIELDS, Unknown.ABSENT)
            gone = WirelessLink(wall_ns=at.wall_ns, mono_ns=at.mono_ns, iface=iface, source="nl80211", unknown=unknown)
            return RadioSample((gone,), (), ())

    def read_index(self, iface: str, ifindex: int, at: Now | None = None) -> RadioSample:
        """One sample of the interface with this index, whatever it is called; records bear the name `iface`.

        Raises:
            NetlinkError: ENODEV where there is none or it is not wireless; else as read().
            ParseError: as read().
        """
        at = at or now()
        state = self._known.get(iface)
        if state is None or state.index != ifindex:
            state = self._known[iface] = _Interface(ifindex)
        slow = at.mono_ns >= state.due_ns
        stations = [] if slow else self._access_point(state, iface, at)
        if not stations:
            stations = self._stations(ifindex, iface, at, tids=slow)
        if {one.peer for one in stations} != state.peers.keys():
            slow = True  # somebody came or went: channel and SSID may be others
            state.ssid_of = None
        surveys: tuple[ChannelSurvey, ...] = ()
        if slow:
            surveys = tuple(self._slow(state, iface, at, stations))
        stations = [self._with_age(state, one) for one in stations]
        for peer in state.peers.keys() - {one.peer for one in stations}:
            del state.peers[peer]
        if slow and at.mono_ns >= state.rare_due_ns:
            self._note_given(iface, stations, surveys)
            if stations:
                state.rare_due_ns = at.mono_ns + _RARE_PERIOD_NS
        assert state.settings is not None  # the first sample asks for them
        return RadioSample(links(state.settings, iface, at, stations), tuple(stations), surveys)

    def capability(self, iface: str, driver: str | None = None) -> RadioCapability:
        """Which values the driver gave so far in read(), which it did not, and which could not show yet."""
        at = now()
        seen = self._given.get(iface, set())
        given, not_given, undecided = [], [], []
        for kind, room in ((StationLink, "station_link"), (ChannelSurvey, "channel_survey")):
            for name in kind.__struct_fields__:
                if name in ("wall_ns", "mono_ns", "unknown", "iface", "peer", "rssi_stale", "utilization", "in_use"):
                    continue
                full = f"{room}.{name}"
                if full in seen:
                    given.append(full)
                elif room in seen:
                    not_given.append(full)
                else:
                    undecided.append(full)
        return RadioCapability(
            wall_ns=at.wall_ns,
            mono_ns=at.mono_ns,
            iface=iface,
            driver=driver,
            given=tuple(given),
            not_given=tuple(not_given),
            undecided=tuple(undecided),
        )

    def close(self) -> None:
        """Give back the socket."""
        self._nl.close()

    def _interface(self, index: int) -> WirelessInterface:
        payload = pack(ATTR_IFINDEX, u32(index))
        return parse_interface(self._nl.one(CMD_GET_INTERFACE, payload, asked="wireless interface"))

    def _stations(self, index: int, iface: str, at: Now, *, tids: bool = True) -> list[StationLink]:
        payload = pack(ATTR_IFINDEX, u32(index))
        answers = self._nl.ask(CMD_GET_STATION, payload, dump=True, asked=f"stations of {iface}")
        return [parse_station(one, at, iface, tids=tids) for one in answers]

    def _access_point(self, state: _Interface, iface: str, at: Now) -> list[StationLink]:
        """A client's one peer, asked for by name: half the cost of a dump. Empty where it is no longer the one."""
        if len(state.peers) != 1 or state.settings is None or state.settings.info.mode not in CLIENT_MODES:
            return []
        (peer,) = state.peers
        payload = pack(ATTR_IFINDEX, u32(state.index)) + pack(ATTR_MAC, bytes.fromhex(peer.replace(":", "")))
        try:
            answer = self._nl.one(CMD_GET_STATION, payload, asked=f"access point of {iface}")
        except NetlinkError as reason:
            if reason.code == errno.ENOENT:
                return []
            raise
        return [parse_station(answer, at, iface, tids=False)]

    def _surveys(self, index: int, iface: str, at: Now) -> list[ChannelSurvey]:
        payload = pack(ATTR_IFINDEX, u32(index))
        try:
            answers = self._nl.ask(CMD_GET_SURVEY, payload, dump=True, asked=f"survey of {iface}")
        except NetlinkError as reason:
            if reason.code in _NOT_GIVEN:
                return []
            raise
        return [one for one in (parse_survey(answer, at, iface) for answer in answers) if one is not None]

    def _power_save(self, index: int) -> bool | None:
        try:
            return parse_power_save(self._nl.one(CMD_GET_POWER_SAVE, pack(ATTR_IFINDEX, u32(index))))
        except NetlinkError as reason:
            if reason.code in _NOT_GIVEN:
                return None
            raise

    def _slow(self, state: _Interface, iface: str, at: Now, stations: list[StationLink]) -> list[ChannelSurvey]:
        info = self._interface(state.index)
        if info.ssid is None and stations and info.mode in CLIENT_MODES:
            info = info._replace(ssid=self._associated_ssid(state, stations[0].peer))
        surveys = [self._with_utilization(state, one) for one in self._surveys(state.index, iface, at)]
        # Some drivers mark no channel as in use; then the survey of our frequency is the one.
        ours = [one for one in surveys if one.in_use] or [
            one for one in surveys if one.frequency_mhz == info.frequency_mhz
        ]
        noise_dbm = ours[0].noise_dbm if ours else None
        power_save = self._power_save(state.index) if info.mode in CLIENT_MODES else None
        if at.mono_ns >= state.rare_due_ns:
            state.alpha2 = self._country(info.wiphy)
        state.settings = settings(info, noise_dbm, power_save, state.alpha2)
        state.due_ns = at.mono_ns + self._slow_period_ns
        return surveys

    def _associated_ssid(self, state: _Interface, bssid: str) -> str | None:
        """The SSID of our access point: kernels tell it in the scan list where the supplicant does the joining."""
        if state.ssid_of != bssid:
            found = scan_results(self._nl, state.index)
            # The list may hold the same BSSID twice, with the SSID it had before.
            state.ssid = next((one.ssid for one in found if one.associated), None)
            state.ssid_of = bssid if state.ssid is not None else None
        return state.ssid

    def _country(self, wiphy: int) -> str | None:
        try:
            return self.regulatory(wiphy).alpha2
        except NetlinkError as reason:
            if reason.code in _NOT_GIVEN:
                return None
            raise

    def _with_utilization(self, state: _Interface, survey: ChannelSurvey) -> ChannelSurvey:
        if survey.active_ms is None or survey.busy_ms is None:
            return survey
        before = state.busy.get(survey.frequency_mhz)
        state.busy[survey.frequency_mhz] = (survey.active_ms, survey.busy_ms)
        if before is not None:
            active, busy = survey.active_ms - before[0], survey.busy_ms - before[1]
            if active > 0 and 0 <= busy <= active:
                return msgspec.structs.replace(survey, utilization=busy / active)
        reason = {**survey.unknown, "utilization": Unknown.NO_BASE}
        return msgspec.structs.replace(survey, unknown=reason)

    def _with_age(self, state: _Interface, station: StationLink) -> StationLink:
        """Whether the RSSI is old. A client hears beacons, which do not count as activity: its counters tell."""
        heard = (station.rx_packets, station.rx_beacons)
        peer = state.peers.get(station.peer)
        if peer is None:
            peer = state.peers[station.peer] = _Peer(heard)
        elif heard != peer.heard:
            peer.heard = heard
            peer.fresh_ns = station.mono_ns
        if station.inactive_ms is None:
            return station
        age_ms: float = station.inactive_ms
        if peer.fresh_ns is not None:
            age_ms = min(age_ms, (station.mono_ns - peer.fresh_ns) / 1e6)
        elif age_ms > self._stale_after_ms and station.rx_beacons:
            return station  # a first sample of a client: beacons may have come since its last frame
        return msgspec.structs.replace(station, rssi_stale=age_ms > self._stale_after_ms)

    def _note_given(self, iface: str, stations: list[StationLink], surveys: tuple[ChannelSurvey, ...]) -> None:
        seen = self._given.setdefault(iface, set())
        rooms: tuple[tuple[str, list[StationLink] | tuple[ChannelSurvey, ...]], ...] = (
            ("station_link", stations),
            ("channel_survey", surveys),
        )
        for room, records in rooms:
            for one in records:
                seen.add(room)
                for name in one.__struct_fields__:
                    if getattr(one, name) not in (None, ()):
                        seen.add(f"{room}.{name}")


def _index(iface: str) -> int:
    try:
        return socket.if_nametoindex(iface)
    except OSError as reason:
        raise NetlinkError(errno.ENODEV, f"interface {iface}") from reason
