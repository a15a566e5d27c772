"""The seam to a robot's middleware: what LinkRover asks of it, and nothing more.

ROS 1 is the first implementation (`linkrover.ros1.node.Ros1`). `tests/middleware/contract.py` holds every
implementation to what is said here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import msgspec

from linkrover.records import Pose, VelocityCommand

Fields = Mapping[str, Any] | Callable[[], Mapping[str, Any]]
"""A message by field name, or what makes it, called where it is published and only if somebody listens."""


class Answer(msgspec.Struct, frozen=True):
    """A ping's answer. received_mono_ns: CLOCK_MONOTONIC where the middleware handed it over."""

    sequence: int
    received_mono_ns: int


class TopicInfo(msgspec.Struct, frozen=True):
    """One topic of the graph with the names of the nodes at both of its ends."""

    name: str
    type_name: str | None
    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()


class Graph(msgspec.Struct, frozen=True):
    """Who is there, and what they publish and subscribe to."""

    nodes: tuple[str, ...]
    topics: tuple[TopicInfo, ...]


class Pinger(Protocol):
    """Asks one ping server; many questions may be on their way at once."""

    def send(self, sequence: int) -> bool:
        """Ask. Never blocks and never waits; False: no server is connected, nothing was sent."""
        ...

    def cancel(self, sequence: int) -> None:
        """The asker no longer waits; the server is told so. A late answer is still handed over."""
        ...

    def close(self) -> None:
        """No further answers."""
        ...


class Middleware(Protocol):
    """One node on a robot's graph.

    Every method but graph() returns at once, whatever the state of the network: sampling must never wait for the
    network it samples. Callbacks come on threads of the middleware.
    """

    @property
    def name(self) -> str:
        """Short name for records: "ros1"."""
        ...

    @property
    def joined(self) -> bool:
        """Whether this node is part of the graph now."""
        ...

    @property
    def lost_messages(self) -> int:
        """Messages dropped because the bounded queue to the network was full."""
        ...

    def describe(self) -> str:
        """One line for the manifest: distribution, master or domain, node name."""
        ...

    def start(self) -> None:
        """Announce this node and keep it announced, in the background, for as long as it takes."""
        ...

    def publish(self, topic: str, type_name: str, fields: Fields, *, latched: bool = False) -> bool:
        """Queue a message; `fields` by field name, times as {sec, nanosec}. False: the queue was full.

        A type that is not known here is said on the log, once.
        """
        ...

    def set_parameter(self, name: str, value: str) -> None:
        """Say something of this node that others on the graph can look up by its name, for as long as it lives."""
        ...

    def answer_pings(self, action: str) -> Callable[[], None]:
        """Serve the ping action under this name. Returns what ends it."""
        ...

    def pinger(self, action: str, on_answer: Callable[[Answer], None]) -> Pinger:
        """A client of the ping action of this name."""
        ...

    def odometry(self, topic: str, take: Callable[[Pose], None]) -> Callable[[], None]:
        """Subscribe to nav_msgs/Odometry. Returns what ends it."""
        ...

    def velocity(self, topic: str, take: Callable[[VelocityCommand], None]) -> Callable[[], None]:
        """Subscribe to geometry_msgs/Twist or TwistStamped. Returns what ends it."""
        ...

    def graph(self, timeout_s: float = 2.0) -> Graph:
        """The graph as it is now; the one call that waits, for timeout_s at most.

        Raises:
            LinkRoverError: nobody answers.
        """
        ...

    def close(self) -> None:
        """Leave the graph."""
        ...
