"""The application's round trip on two topics: <name>/goal there, <name>/answer back, both std_msgs/Header.

A goal's frame_id says whose it is and which; an answerer sends it back as it came. Any ROS 2 node can answer: subscribe
to <name>/goal, publish what comes on <name>/answer. A service would bind both ends to one vendor's DDS, an action needs
five endpoints a side.
"""

from __future__ import annotations

import logging
import os
import queue
import threading
import time
from collections.abc import Callable

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant

from linkrover.messages import Message
from linkrover.middleware.protocol import Answer

from .endpoints import PING_DEPTH, Subscription, Writer
from .names import dds_topic

PING_TYPE = "std_msgs/Header"
UNSAID_S = 2.0
"""Discovery takes its time; only then is a missing server worth a word."""

log = logging.getLogger("linkrover.ros2")


class PingServer:
    """Sends every goal back, on the thread that received it."""

    def __init__(self, participant: DomainParticipant, name: str) -> None:
        self.answered = 0
        self._answer = Writer(participant, dds_topic(f"{name}/answer"), PING_TYPE, depth=PING_DEPTH)
        self._goals = Subscription(
            participant, dds_topic(f"{name}/goal"), (PING_TYPE,), self._goal, reliable=True, depth=PING_DEPTH
        )

    def close(self) -> None:
        """No further answers."""
        self._goals.close()

    def _goal(self, _type_name: str, message: Message, _received_ns: int) -> None:
        try:
            self._answer.write(message)
            self.answered += 1
        except DDSException as error:
            log.debug("an answer was not taken: %s", error)


class PingClient:
    """A `linkrover.middleware.Pinger`, which may be used before the node has joined: until then nothing is sent.

    The goal is written on a thread of its own: a write may wait for a reader that does not keep up.
    """

    def __init__(self, node: str, on_answer: Callable[[Answer], None]) -> None:
        self._prefix = f"{node}-{os.getpid()}-{time.time_ns()}-"
        self._on_answer = on_answer
        self._name = ""
        self._goal: Writer | None = None
        self._answers: Subscription | None = None
        self._queue: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self._closed = False
        self._was_connected: bool | None = None
        self._began = time.monotonic()
        self._told_many = False
        self._thread = threading.Thread(target=self._send_from_queue, name="ros2 pings", daemon=True)

    def connect(self, participant: DomainParticipant, name: str) -> None:
        """Called once the node has joined."""
        if self._closed:
            return
        self._name = name
        self._goal = Writer(participant, dds_topic(f"{name}/goal"), PING_TYPE, depth=PING_DEPTH)
        self._answers = Subscription(
            participant,
            dds_topic(f"{name}/answer"),
            (PING_TYPE,),
            self._received,
            reliable=True,
            depth=PING_DEPTH,
            partner=self._goal,
        )
        self._began = time.monotonic()
        self._thread.start()

    @property
    def goal(self) -> Writer | None:
        """Whose readers are the servers; None before the node has joined."""
        return self._goal

    def send(self, sequence: int) -> bool:
        """Ask; False without a server that both hears us and is heard."""
        answers = self._answers
        servers = 0 if answers is None else min(answers.partners, answers.writers)
        connected = servers > 0
        self._say(servers)
        if connected and not self._closed:
            self._queue.put(sequence)
            return True
        return False

    def cancel(self, sequence: int) -> None:
        """Nothing to take back: a goal is answered the moment it is heard."""

    def close(self) -> None:
        """No further pings and answers."""
        self._closed = True
        self._queue.put(None)
        if self._answers is not None:
            self._answers.close()

    def _say(self, servers: int) -> None:
        if servers > 1 and not self._told_many:
            self._told_many = True
            log.warning("%d ping servers share the name '%s': answers come twice", servers, self._name)
        connected = servers > 0
        if connected == self._was_connected or not (connected or time.monotonic() - self._began > UNSAID_S):
            return
        if connected:
            log.info("a ping server answers on '%s'", self._name)
        elif self._name:
            log.warning("no ping server on '%s' (start: linkrover ros2 ping-server)", self._name)
        self._was_connected = connected

    def _send_from_queue(self) -> None:
        while (sequence := self._queue.get()) is not None:
            goal = self._goal
            assert goal is not None
            seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
            stamp = {"sec": seconds, "nanosec": nanoseconds}
            try:
                goal.write({"stamp": stamp, "frame_id": f"{self._prefix}{sequence}"})
            except DDSException as error:
                log.debug("ping %d was not taken: %s", sequence, error)  # its deadline will say so

    def _received(self, _type_name: str, message: Message, received_ns: int) -> None:
        identifier = str(message["frame_id"])
        digits = identifier.removeprefix(self._prefix)
        if digits != identifier and digits.isdecimal():
            self._on_answer(Answer(int(digits), received_ns))
