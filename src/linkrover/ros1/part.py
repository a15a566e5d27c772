"""What a ROS 1 node measures beyond the agent: application delay, topic traffic, motion; and what it shows."""

from __future__ import annotations

import functools
import logging
import socket
import threading
import time
import urllib.parse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from linkrover.agent import Agent
from linkrover.agent.machine import route_interface
from linkrover.agent.probing import Probing
from linkrover.middleware import DelayProber, Layout, NearestRtt, RecordPublisher
from linkrover.middleware.diagnostics import Diagnostics
from linkrover.middleware.markers import PathMarkers
from linkrover.probe.packet import DEFAULT_PORT
from linkrover.records import ProbeResult, Record, TcpConnection

from .node import Ros1
from .rpc import Rpc, RpcError, master_uri
from .traffic import TrafficReader
from .transform import TransformPoses

if TYPE_CHECKING:
    from .options import Ros1Options

POSE_HZ = 20.0
"""Poses recorded a second at most; odometry often comes faster than a link changes."""
SEEK_PERIOD_S = 1.0
FOUND_PERIOD_S = 30.0
"""Each look asks the master for the whole graph, perhaps over the link under test."""
CONNECTION_KEPT_NS = 3_000_000_000
COMBINED_HZ = 1.0
COMBINED_WINDOW_NS = 3_000_000_000
REFLECTOR_PARAMETER = "stamp_reflector"
"""Private parameter under which a node of ours says where its STAMP reflector listens."""

log = logging.getLogger("linkrover.ros1")


class Ros1Part:
    """A part of the agent (linkrover.agent.Part), and a sink of its records."""

    def __init__(self, node: Ros1, options: Ros1Options, layout: Layout) -> None:
        self.node = node
        self.options = options
        self.publisher = RecordPublisher(node, options.end, layout)
        self.diagnostics = Diagnostics(node, options.end, options.thresholds, self._extra)
        self.markers = PathMarkers(node, f"{layout.end_prefix(options.end)}linkrover/path")
        self.rtt = NearestRtt()
        self.prober: DelayProber | None = None
        self._connections: dict[tuple[str, str], TcpConnection] = {}
        self._agent: Agent | None = None
        self._done = threading.Event()
        self._ends: list[Callable[[], None]] = []
        self._last_pose_ns = 0
        self._reflectors: set[str] = set()

    def take(self, record: Record) -> None:
        """Also a sink: everything the agent measures goes out on topics."""
        self.publisher.take(record)
        if self.options.diagnostics:
            self.diagnostics.take(record)
        if self.options.markers:
            self.markers.take(record)
        if isinstance(record, ProbeResult):
            self.rtt.take(record)
        elif isinstance(record, TcpConnection):
            self._connections[(record.local, record.remote)] = record

    def close(self) -> None:
        """Sink protocol: the node is closed in stop()."""

    def start(self, agent: Agent) -> None:
        """Begin."""
        self._agent = agent
        options = self.options
        agent.add_sink(self)
        self.take(agent.manifest)
        if options.reflect:
            self.node.set_parameter(REFLECTOR_PARAMETER, str(options.reflect))
        if options.answer:
            self._ends.append(self.node.answer_pings(options.answer))
        if options.ping:
            self._start_prober(agent, options.ping)
        if options.odom:
            self._ends.append(self.node.odometry(options.odom, self._moved))
        elif options.frame:
            frame, base = options.frame, options.base_frame
            self._ends.append(
                self.node.subscribe_with(lambda: TransformPoses(frame, base, self._moved, max_hz=POSE_HZ))
            )
        if options.cmd_vel:
            self._ends.append(self.node.velocity(options.cmd_vel, self._hand_over))
        if options.diagnostics:
            agent.every(1.0, self._say_diagnostics, name="diagnostics")
        if options.markers and (options.odom or options.frame):
            agent.every(1.0, self._say_path, name="path")
        agent.every(COMBINED_HZ, self._say_combined, name="combined topic")
        if options.traffic_s:
            threading.Thread(target=self._read_traffic, name="topic traffic", daemon=True).start()

    def stop(self) -> None:
        """End everything on the graph."""
        self._done.set()
        if self.prober is not None:
            self.prober.close()
            if self.prober.late or self.prober.duplicates:
                log.info("%d answers came late, %d twice", self.prober.late, self.prober.duplicates)
        for end in self._ends:
            end()
        self.node.close()

    def _start_prober(self, agent: Agent, action: str) -> None:
        options = self.options
        names = agent.config.interfaces
        self.prober = DelayProber(
            agent.loop,
            lambda on_answer: self.node.pinger(action, on_answer),
            agent.publish,
            iface=names[0] if names else "",
            peer=action,
            method="ros1 action",
            period_ns=round(1e9 / (options.delay_hz or 1.0)),
            deadline_ns=round((options.timeout_s or 2.0) * 1e9),
            rtt=self.rtt,
        )
        self.prober.start(time.monotonic_ns() + 2_000_000)
        threading.Thread(target=self._find_peer, args=(action,), name="peer", daemon=True).start()

    def _find_peer(self, action: str) -> None:
        """Who answers our pings, through which interface, and whether a STAMP reflector is there to probe beside."""
        found = None
        while not self._done.wait(SEEK_PERIOD_S if found is None else FOUND_PERIOD_S):
            if not self.node.joined:
                continue
            try:
                found = self._server_of(self.node.resolve(f"{action}/result"))
            except RpcError as error:
                log.debug("looking for the ping server: %s", error)
                continue
            if found is None:
                continue
            host, reflector_port = found
            try:
                family, _, _, _, address = socket.getaddrinfo(host, DEFAULT_PORT, type=socket.SOCK_DGRAM)[0]
            except OSError as error:
                log.debug("looking for %s: %s", host, error)
                continue
            self._agent_soon(functools.partial(self._found, host, reflector_port, family, address))

    def _server_of(self, topic: str) -> tuple[str, int] | None:
        master = Rpc(master_uri(), self.node.resolved_name)
        publishers = dict(master.call("getSystemState")[0]).get(topic, [])
        if not publishers:
            return None
        uri = master.call("lookupNode", publishers[0])
        code, _, port = master.raw("getParam", f"{publishers[0]}/{REFLECTOR_PARAMETER}")
        host = urllib.parse.urlparse(uri).hostname or ""
        return host, int(port) if code == 1 and str(port).isdigit() else 0

    def _found(self, host: str, reflector_port: int, family: int, address: tuple[Any, ...]) -> None:
        agent = self._agent
        if agent is None or self._done.is_set() or self.prober is None:
            return
        self.prober.peer = host
        self.prober.iface = route_interface(family, address, agent.config.interfaces) or self.prober.iface
        peer = f"{host}:{reflector_port}"
        if not reflector_port or peer in self._reflectors or agent.config.peers:
            return
        self._reflectors.add(peer)
        log.info("the ping server has a STAMP reflector: probing %s beside it", peer)
        probing = Probing(agent, peer)
        probing.start(time.monotonic_ns())
        agent.probings = (*agent.probings, probing)
        self._ends.append(probing.stop)

    def _moved(self, record: Record) -> None:
        if record.mono_ns - self._last_pose_ns >= 1e9 / POSE_HZ:
            self._last_pose_ns = record.mono_ns
            self._hand_over(record)

    def _hand_over(self, record: Record) -> None:
        if self._agent is not None:
            self._agent_soon(functools.partial(self._agent.publish, record))

    def _agent_soon(self, work: Callable[[], None]) -> None:
        def unless_done() -> None:
            if self._done.is_set():
                return
            try:
                work()
            except Exception:  # a fault beside the measuring must not end it
                log.exception("a part of the ROS 1 node failed; measuring goes on")

        if self._agent is not None and not self._done.is_set():
            self._agent.loop.call_soon(unless_done)

    def _say_diagnostics(self) -> tuple[()]:
        self.diagnostics.publish()
        return ()

    def _say_path(self) -> tuple[()]:
        self.markers.publish()
        return ()

    def _say_combined(self) -> tuple[()]:
        self.publisher.publish_combined(time.monotonic_ns() - COMBINED_WINDOW_NS)
        return ()

    def _read_traffic(self) -> None:
        reader: TrafficReader | None = None
        while not self._done.wait(self.options.traffic_s):
            if not self.node.joined:
                continue
            reader = reader or TrafficReader(self.node.resolved_name, only_local=True, refresh_s=FOUND_PERIOD_S)
            try:
                rows = reader.read(self._recent_connections())
            except RpcError as error:
                log.debug("topic traffic: %s", error)
                continue
            for row in rows:
                self._hand_over(row.traffic)

    def _recent_connections(self) -> tuple[TcpConnection, ...]:
        oldest_ns = time.monotonic_ns() - CONNECTION_KEPT_NS
        recent = {ends: found for ends, found in self._connections.copy().items() if found.mono_ns >= oldest_ns}
        self._connections = recent
        return tuple(recent.values())

    def _extra(self) -> dict[str, str]:
        values = {"messages_not_published": str(self.node.lost_messages), "master": master_uri()}
        if self.prober is not None:
            values |= {"pings_late": str(self.prober.late), "pings_answered_twice": str(self.prober.duplicates)}
        return values
