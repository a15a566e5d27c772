"""What a ROS 2 node measures beyond the agent: application delay and motion; and what it shows."""

from __future__ import annotations

import functools
import logging
import socket
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from linkrover.agent import Agent
from linkrover.agent.machine import route_interface
from linkrover.agent.probing import Probing
from linkrover.middleware import Answer, DelayProber, Layout, NearestRtt, Pinger, RecordPublisher
from linkrover.middleware.diagnostics import Diagnostics
from linkrover.probe.packet import DEFAULT_PORT
from linkrover.records import ProbeResult, Record

from .node import PingPeer, Ros2
from .ping import PingClient

if TYPE_CHECKING:
    from .entry import Ros2Options

METHOD = "ros2 topic"
"""What is timed: std_msgs/Header there and back on two topics, cyclonedds and Python at our end, whatever answers."""
POSE_HZ = 20.0
"""Poses recorded a second at most; odometry often comes faster than a link changes."""
SEEK_PERIOD_S = 1.0
FOUND_PERIOD_S = 10.0
COMBINED_HZ = 1.0
COMBINED_WINDOW_NS = 3_000_000_000
REFLECTOR_PARAMETER = "linkrover_reflector"
"""Under which a node of ours says where its STAMP reflector listens."""

log = logging.getLogger("linkrover.ros2")


class Ros2Part:
    """A part of the agent (linkrover.agent.Part), and a sink of its records."""

    def __init__(self, node: Ros2, options: Ros2Options, layout: Layout) -> None:
        self.node = node
        self.options = options
        self.publisher = RecordPublisher(node, options.end, layout)
        self.diagnostics = Diagnostics(node, options.end, options.thresholds, self._extra)
        self.rtt = NearestRtt()
        self.prober: DelayProber | None = None
        self._client: PingClient | None = None
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
        if isinstance(record, ProbeResult):
            self.rtt.take(record)

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
        if options.cmd_vel:
            self._ends.append(self.node.velocity(options.cmd_vel, self._hand_over))
        if options.diagnostics:
            agent.every(1.0, self._say_diagnostics, name="diagnostics")
        agent.every(COMBINED_HZ, self._say_combined, name="combined topic")

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

    def _start_prober(self, agent: Agent, name: str) -> None:
        options = self.options
        interfaces = agent.config.interfaces

        def connect(on_answer: Callable[[Answer], None]) -> Pinger:
            self._client = self.node.pinger(name, on_answer)
            return self._client

        self.prober = DelayProber(
            agent.loop,
            connect,
            agent.publish,
            iface=interfaces[0] if interfaces else "",
            peer=name,
            method=METHOD,
            period_ns=round(1e9 / (options.delay_hz or 1.0)),
            deadline_ns=round((options.timeout_s or 2.0) * 1e9),
            rtt=self.rtt,
        )
        self.prober.start(time.monotonic_ns() + 2_000_000)
        threading.Thread(target=self._find_peer, name="ros2 peer", daemon=True).start()

    def _find_peer(self) -> None:
        """Who answers our pings, through which interface, and whether a STAMP reflector is there to probe beside."""
        found: PingPeer | None = None
        while not self._done.wait(SEEK_PERIOD_S if found is None else FOUND_PERIOD_S):
            assert self._client is not None
            found = self.node.ping_peer(self._client)
            if found is None:
                continue
            try:
                family, _, _, _, address = socket.getaddrinfo(found.host, DEFAULT_PORT, type=socket.SOCK_DGRAM)[0]
            except OSError as error:
                log.debug("looking for %s: %s", found.host, error)
                continue
            self._agent_soon(functools.partial(self._found, found, family, address))

    def _found(self, peer: PingPeer, family: int, address: tuple[Any, ...]) -> None:
        agent = self._agent
        if agent is None or self.prober is None:
            return
        self.prober.peer = peer.host
        self.prober.iface = route_interface(family, address, agent.config.interfaces) or self.prober.iface
        port = peer.said.get(REFLECTOR_PARAMETER, "")
        reflector = f"[{peer.host}]:{port}" if ":" in peer.host else f"{peer.host}:{port}"
        if not port.isdecimal() or reflector in self._reflectors or agent.config.peers:
            return
        self._reflectors.add(reflector)
        log.info("the ping server (%s) has a STAMP reflector: probing %s beside it", peer.node, reflector)
        probing = Probing(agent, reflector)
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
                log.exception("a part of the ROS 2 node failed; measuring goes on")

        if self._agent is not None and not self._done.is_set():
            self._agent.loop.call_soon(unless_done)

    def _say_diagnostics(self) -> tuple[()]:
        self.diagnostics.publish()
        return ()

    def _say_combined(self) -> tuple[()]:
        self.publisher.publish_combined(time.monotonic_ns() - COMBINED_WINDOW_NS)
        return ()

    def _extra(self) -> dict[str, str]:
        values = {"messages_not_published": str(self.node.lost_messages), "domain": str(self.node.network.domain)}
        if self.prober is not None:
            values |= {"pings_late": str(self.prober.late), "pings_answered_twice": str(self.prober.duplicates)}
        return values
