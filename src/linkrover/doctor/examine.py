"""Which checks there are, and where each gets its facts."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from linkrover import __version__
from linkrover.errors import LinkRoverError
from linkrover.loop import Loop
from linkrover.probe import stamps
from linkrover.probe.address import Endpoint, resolve, split_host_port
from linkrover.probe.sender import StampSender
from linkrover.probe.summary import ProbeSummary, summarise
from linkrover.probe.version import ask_version
from linkrover.records import ProbeResult
from linkrover.sources.interface import no_such_interface
from linkrover.sources.wext_ioctl import WirelessIoctls
from linkrover.stress import load
from linkrover.stress.client import StressClient
from linkrover.stress.protocol import DEFAULT_PORT as STRESS_PORT

from . import network, path, permission, radio, ros
from .finding import Check, Finding, unknown
from .machine import Machine, Radio
from .rtnetlink import Owned, Route, RouteTables, shared_networks

DISCOVERY = "239.255.0.1"
PROBES, PROBE_PERIOD_NS = 40, 50_000_000
LARGE_OCTETS, LARGE_PROBES = 9_000, 5
STRESS_SECONDS = 2.0
_T = TypeVar("_T")


class Examination:
    """The checks for one machine, one or several interfaces, and a peer if given.

    Args:
        interface: the one under test; by default every wireless one, else the one towards the peer or the default
            route.
        peer: HOST or HOST:PORT of the other end's reflector.
        key: of authenticated probes.
        stress_token: the peer's consent to the bufferbloat test; without it that check says how to get it.
        machine: where facts are read.
        environ: the environment whose ROS variables are judged.

    Raises:
        ConfigError: no such interface, or the peer's name is not known.
    """

    def __init__(
        self,
        *,
        interface: str | None = None,
        peer: str | None = None,
        key: bytes | None = None,
        stress_token: bytes | None = None,
        stress_port: int = STRESS_PORT,
        machine: Machine | None = None,
        environ: Mapping[str, str] | None = None,
    ) -> None:
        self._machine = machine or Machine()
        self._environ = os.environ if environ is None else environ
        self._key = key
        self._stress_token, self._stress_port = stress_token, stress_port
        there = self._machine.interfaces()
        if interface is not None and interface not in there:
            raise no_such_interface(interface, there)
        self._wanted = interface
        self.peer = peer
        self._endpoint: Endpoint | None = None
        if peer is not None:
            self._endpoint = resolve(*split_host_port(peer))
        self.interfaces = (interface,) if interface is not None else self._choose(there)

    @property
    def _address(self) -> str:
        assert self._endpoint is not None
        return self._endpoint.host

    def checks(self) -> list[Check]:
        """All of them, in the order of a page."""
        found: list[Check] = []
        for iface in self.interfaces:
            found += self._radio_checks(iface)
        if not self.interfaces:
            found.append(Check("interface", lambda: unknown("interface", "no network interface but loopback is here")))
        for iface in self.interfaces:
            found += self._interface_checks(iface)
        found += self._kernel_checks()
        if self._endpoint is not None:
            found += self._peer_checks()
        found.append(Check("ROS", self._ros))
        return found + self._permission_checks()

    def _choose(self, there: list[str]) -> tuple[str, ...]:
        wireless = tuple(name for name in there if self._is_wireless(name))
        if wireless:
            return wireless
        try:
            route = self._route(self._address if self._endpoint is not None else "192.0.2.1")
        except LinkRoverError:
            route = None
        name = None if route is None else self._names.get(route.ifindex)
        return (name,) if name is not None and name != "lo" else tuple(n for n in there if n != "lo")[:1]

    def _is_wireless(self, name: str) -> bool:
        if self._machine.is_wireless(name):
            return True
        ioctls = WirelessIoctls()
        try:
            return ioctls.is_wireless(name)
        finally:
            ioctls.close()

    def _radio_checks(self, iface: str) -> list[Check]:
        radios: list[Radio | LinkRoverError | None] = []

        def seen() -> Radio | None:
            if not radios:
                try:
                    radios.append(self._machine.radio(iface))
                except LinkRoverError as error:
                    radios.append(error)
            if isinstance(radios[0], LinkRoverError):
                raise radios[0]
            return radios[0]

        def of(judge: Callable[[Radio], Finding | list[Finding]]) -> Callable[[], Finding | list[Finding]]:
            def run() -> Finding | list[Finding]:
                one = seen()
                return [] if one is None else judge(one)

            return run

        def present() -> list[Finding]:
            if seen() is not None:
                return []
            return [unknown("radio", f"{iface} is not wireless: no signal, rate, channel or power save to check")]

        def driver() -> Finding:
            info = self._machine.driver(iface)
            return radio.driver(info.driver, info.version, info.firmware, iface)

        def signal(one: Radio) -> list[Finding]:
            if one.mode in ("ap", "p2p-go"):
                return radio.stations(list(one.stations), iface)
            age = one.link.inactive_ms if one.link is not None else None
            return [radio.signal(one.rssi_dbm, iface, inactive_ms=age)]

        def bluetooth(one: Radio) -> Finding:
            return radio.bluetooth(*self._machine.bluetooth(), one.frequency_mhz, iface)

        def busy(one: Radio) -> Finding:
            return radio.busy(self._machine.busy(iface) if one.source == "nl80211" else None, iface)

        return [
            Check("radio", present),
            Check("driver and firmware", driver),
            Check("signal", of(signal)),
            Check("bit rate", of(lambda r: radio.rate(r.link.tx_bitrate if r.link is not None else None, iface))),
            Check("channel and width", of(lambda r: radio.channel(r.frequency_mhz, r.width_mhz, iface))),
            Check("channel busy", of(busy)),
            Check("DFS", of(lambda r: radio.dfs(r.frequency_mhz, r.width_mhz, iface))),
            Check("power save", of(lambda r: radio.power_save(r.power_save, r.mode, iface))),
            Check("regulatory domain", of(lambda r: radio.regulatory(r.alpha2, r.dfs_region))),
            Check("bluetooth coexistence", of(bluetooth)),
        ]

    def _interface_checks(self, iface: str) -> list[Check]:
        machine = self._machine
        wireless = machine.is_wireless(iface)

        def queue() -> Finding:
            index = machine.index(iface)
            mine = [q for q in self._tables(lambda t: t.qdiscs()) if q.ifindex == index]
            kinds = [q.kind for q in sorted(mine, key=lambda q: not q.root)]
            return network.qdisc(kinds, iface, wireless=wireless)

        def multicast() -> Finding:
            route = self._route(DISCOVERY)
            out = None if route is None else self._names.get(route.ifindex)
            return network.multicast(machine.multicast(iface), out, iface, wireless=wireless)

        return [
            Check("MTU", lambda: network.mtu(machine.mtu(iface), iface)),
            Check("queue", queue),
            Check("multicast", multicast),
        ]

    def _kernel_checks(self) -> list[Check]:
        sysctl = self._machine.sysctl
        return [
            Check(
                "fragmentation",
                lambda: network.fragmentation(sysctl("net.ipv4.ipfrag_time"), sysctl("net.ipv4.ipfrag_high_thresh")),
            ),
            Check("buffers", lambda: network.buffers(sysctl("net.core.rmem_max"), sysctl("net.core.wmem_max"))),
            Check("subnets", self._subnets),
            Check("clock source", lambda: path.clock_source(self._machine.clock_source())),
            Check("clock synchronised", self._synchronized),
        ]

    def _synchronized(self) -> Finding:
        error = stamps.clock_error()
        return path.synchronized(error.synchronized, error.error_ns)

    def _subnets(self) -> list[Finding]:
        owned = [(self._names.get(o.ifindex, f"#{o.ifindex}"), o.address) for o in self._addresses]
        return network.subnets(shared_networks(owned))

    def _peer_checks(self) -> list[Check]:
        assert self.peer is not None
        assert self._endpoint is not None
        peer, port = self.peer, self._endpoint.address[1]
        hint = (
            f"start `linkrover reflect` (or an agent with --reflect) there, and let UDP port {port} through firewalls"
        )

        def way() -> Finding:
            route = self._route(self._address)
            out = None if route is None else self._names.get(route.ifindex)
            return network.way_to_peer(self._address, out, self._wanted)

        return [
            Check("route to the peer", way),
            Check("asymmetric routes", self._asymmetry),
            Check("peer", lambda: path.answers(self._probes, peer, hint)),
            Check("large messages", self._large),
            Check("clock offset", lambda: path.offset(self._probes.offset, peer)),
            Check("peer's version", self._version),
            Check("buffer delay", self._bufferbloat),
        ]

    def _asymmetry(self) -> Finding:
        target = self._address
        cases = []
        for owned in self._addresses:
            address = owned.address.ip
            owner = self._names.get(owned.ifindex, f"#{owned.ifindex}")
            if address.version != (6 if ":" in target else 4) or address.is_loopback or address.is_link_local:
                continue
            try:
                route = self._route(target, str(address))
            except LinkRoverError:
                continue  # the kernel does not route from that address
            out = None if route is None else self._names.get(route.ifindex)
            if out is not None and out not in (owner, "lo"):
                cases.append((str(address), owner, out))
        # the kernel takes the greater of the two values; 2 is the loose check
        everywhere = self._machine.sysctl("net.ipv4.conf.all.rp_filter") or "0"
        names = self._names.values()
        strict = [
            n for n in names if max(everywhere, self._machine.sysctl(f"net.ipv4.conf.{n}.rp_filter") or "0") == "1"
        ]
        return network.asymmetry(target, cases, strict)

    def _version(self) -> Finding:
        assert self._endpoint is not None
        # a silent peer would only be waited for again
        told = ask_version(self._address, self._endpoint.address[1], key=self._key) if self._probes.answered else None
        return path.version(__version__, told, str(self.peer))

    def _large(self) -> Finding:
        if not self._probes.answered:
            return unknown("large messages", "the peer does not answer small ones either")
        summary = self._probe(count=LARGE_PROBES, size=LARGE_OCTETS)
        return path.large_messages(summary.answered + summary.late, summary.sent + summary.not_sent, LARGE_OCTETS)

    def _bufferbloat(self) -> list[Finding]:
        if self._stress_token is None:
            return [
                unknown(
                    "buffer delay", "not tested: it loads the link and needs the peer's consent",
                    "when the camera fills the queue, a velocity command waits as long as the queue is deep",
                    "there: linkrover reflect --allow-stress; here: LINKROVER_STRESS_TOKEN=... linkrover doctor --peer",
                )
            ]  # fmt: skip
        client = StressClient(
            self._address, self._stress_token, self._stress_port, key=self._key,
            probe_port=self._endpoint.address[1] if self._endpoint is not None else None,
        )  # fmt: skip
        try:
            client.connect()
            report = client.run(load.profile("tcp"), seconds=STRESS_SECONDS, phases=("idle", "up", "down"))
        finally:
            client.close()
        idle, up, down = (p.probes.rtt for p in report.phases)
        base = None if idle is None else idle.median_ns
        return [
            path.bufferbloat(base, None if one is None else one.mean_ns, way)
            for one, way in ((up, "up"), (down, "down"))
        ]

    def _ros(self) -> list[Finding]:
        def reachable(host: str, port: int) -> bool:
            try:
                socket.create_connection((host, port), timeout=2).close()
            except OSError:
                return False
            return True

        local = {str(o.address.ip) for o in self._addresses}
        return ros.environment(
            self._environ,
            peer=self.peer is not None,
            local=local,
            reachable=reachable,
            exists=lambda p: Path(p).exists(),
        )

    def _permission_checks(self) -> list[Check]:
        machine = self._machine

        def namespaces() -> Finding:
            return permission.namespaces(
                os.geteuid() == 0,
                machine.sysctl("user.max_user_namespaces"),
                machine.sysctl("kernel.unprivileged_userns_clone"),
                machine.sysctl("kernel.apparmor_restrict_unprivileged_userns"),
            )

        return [
            Check("kernel time stamps", lambda: permission.kernel_stamps(machine.kernel_stamps())),
            Check("reading the radio", self._radio_access),
            Check("permission to scan", lambda: permission.scanning(machine.capabilities())),
            Check("/dev/net/tun", lambda: permission.tunnel(*machine.tunnel())),
            Check("network namespaces", namespaces),
        ]

    def _radio_access(self) -> Finding:
        from linkrover.sources.nl80211 import Nl80211

        try:
            Nl80211().close()
        except LinkRoverError as error:
            return permission.radio_access(str(error))
        return permission.radio_access(None)

    def _tables(self, ask: Callable[[RouteTables], _T]) -> _T:
        tables = RouteTables()
        try:
            return ask(tables)
        finally:
            tables.close()

    def _route(self, to: str, source: str | None = None) -> Route | None:
        return self._tables(lambda tables: tables.route(to, source))

    @cached_property
    def _names(self) -> dict[int, str]:
        indexes = ((self._machine.index(name), name) for name in self._machine.interfaces())
        return {index: name for index, name in indexes if index is not None}

    @cached_property
    def _addresses(self) -> list[Owned]:
        return self._tables(lambda tables: tables.addresses())

    @cached_property
    def _probes(self) -> ProbeSummary:
        return self._probe(count=PROBES)

    def _probe(self, *, count: int, size: int = 0) -> ProbeSummary:
        assert self._endpoint is not None
        results: list[ProbeResult] = []
        loop = Loop()
        sender = StampSender(
            loop, self._address, self._endpoint.address[1], on_result=results.append, period_ns=PROBE_PERIOD_NS,
            count=count, key=self._key, size=size,
        )  # fmt: skip
        ends = time.monotonic_ns() + count * PROBE_PERIOD_NS + 2_100_000_000
        try:
            sender.start()
            while (sender.sending or sender.in_flight) and time.monotonic_ns() < ends:
                loop.run(time.monotonic_ns() + 20_000_000)
        finally:
            sender.stop()
            loop.close()
        return summarise(results)
