"""One node on a ROS 2 graph: `linkrover.middleware.Middleware` on pip's cyclonedds, no ROS 2 installation needed.

One thread of ours stands between the sampling loop and the network: it joins the domain, makes writers and readers,
and writes what waits in a bounded queue. Each subscription has a thread of its own.
"""

from __future__ import annotations

import collections
import contextlib
import ipaddress
import logging
import queue
import struct
import threading
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

import msgspec
from cyclonedds.core import DDSException, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant

from linkrover.errors import LinkRoverError
from linkrover.messages import Message
from linkrover.messages.standard import from_odometry, from_twist
from linkrover.middleware.protocol import Answer, Fields, Graph
from linkrover.records import Now, Pose, VelocityCommand, now

from .endpoints import Subscription, Writer
from .graph import Discovery, Participant
from .names import Names, dds_topic
from .network import Network, read_network
from .ping import PingClient, PingServer
from .types import dds_name, ros_name

QUEUE = 1000
"""Messages that may wait for the writing thread; more are dropped and counted, never waited for."""
JOIN_PERIOD_S = 1.0
REJOIN_PERIOD_S = 5.0
LOOK_PERIOD_S = 1.0
LOOK_PERIOD_LONGEST_S = 30.0
QUIET_S = 0.5
"""A graph that has not changed for so long counts as known."""

log = logging.getLogger("linkrover.ros2")

_Work = Callable[[], None]


class PingPeer(msgspec.Struct, frozen=True):
    """Who answers a ping: the host its data go to, and what it says of itself."""

    node: str
    host: str
    said: dict[str, str]


class Ros2:
    """A node on a ROS 2 graph, as a DDS participant of its own.

    remappings: `__ns:=/r1`, `/odom:=/r1/odom`. network: domain and configuration, from ROS 2's variables by default.

    Raises:
        ConfigError: a name or variable that cannot be used.
    """

    name = "ros2"

    def __init__(
        self, node: str, remappings: Sequence[str] = (), *, network: Network | None = None, queue_size: int = QUEUE
    ) -> None:
        self.names = Names(node, remappings)
        self.network = read_network() if network is None else network
        self._limit = queue_size
        self._queue: queue.SimpleQueue[tuple[str, str, Fields, bool] | _Work | None] = queue.SimpleQueue()
        self._early: collections.deque[tuple[str, str, Fields, bool]] = collections.deque(maxlen=100)
        self._joined = threading.Event()
        self._closed = threading.Event()
        self._domain: Domain | None = None
        self._participant: DomainParticipant | None = None
        self._discovery: Discovery | None = None
        self._discovering = threading.Lock()
        self._joined_s = 0.0
        self._writers: dict[tuple[str, str], Writer | None] = {}
        self._subscriptions: list[Subscription] = []
        self._parameters: dict[str, str] = {}
        self._told: set[str] = set()
        self._ends: list[_Work] = []
        self._thread = threading.Thread(target=self._run, name="ros2 node", daemon=True)
        self.lost_messages = 0
        self.published = 0

    @property
    def joined(self) -> bool:
        """Part of the domain. DDS has no master: being alone is no fault."""
        return self._joined.is_set() and not self._closed.is_set()

    def describe(self) -> str:
        """For the manifest."""
        return f"ros2 cyclonedds {version('cyclonedds')} domain {self.network.domain} {self.names.full_name}"

    def start(self) -> None:
        """Join as soon as there is a network; returns at once."""
        self._thread.start()

    def wait_joined(self, timeout_s: float) -> bool:
        """For tests and tools, not for sampling."""
        return self._joined.wait(timeout_s)

    def publish(self, topic: str, type_name: str, fields: Fields, *, latched: bool = False) -> bool:
        """Queue a message; never blocks. False: the queue was full, the message is counted in lost_messages."""
        message = (topic, type_name, fields, latched)
        if not self._joined.is_set():
            if latched:
                self._early.append(message)
            return True  # nobody could be listening yet
        if self._queue.qsize() >= self._limit:
            self.lost_messages += 1
            return False
        self._queue.put(message)
        return True

    def set_parameter(self, name: str, value: str) -> None:
        """Say it in the participant's user data, where every peer's discovery carries it."""
        self._parameters[name] = value
        self._later(self._say_parameters)

    def answer_pings(self, action: str) -> Callable[[], None]:
        """Serve pings on <action>/goal; warns where somebody else already does."""
        servers: list[PingServer] = []
        name = self.names.resolve(action)

        def begin() -> None:
            assert self._participant is not None
            servers.append(PingServer(self._participant, name))

        self._later(begin)
        return self._ender(servers)

    def pinger(self, action: str, on_answer: Callable[[Answer], None]) -> PingClient:
        """A client of the pings of this name; says once when the server comes and goes."""
        client = PingClient(self.names.full_name, on_answer)
        name = self.names.resolve(action)

        def begin() -> None:
            assert self._participant is not None
            client.connect(self._participant, name)

        self._later(begin)
        self._ends.append(client.close)
        return client

    def odometry(self, topic: str, take: Callable[[Pose], None]) -> Callable[[], None]:
        """nav_msgs/Odometry as poses, stamped on arrival by this machine's clocks."""

        def received(_type_name: str, message: Message, received_ns: int) -> None:
            instant = _at(received_ns)
            pose = from_odometry(message)
            take(msgspec.structs.replace(pose, wall_ns=instant.wall_ns, mono_ns=instant.mono_ns))

        return self._subscribe(topic, ("nav_msgs/Odometry",), received)

    def velocity(self, topic: str, take: Callable[[VelocityCommand], None]) -> Callable[[], None]:
        """geometry_msgs/Twist or TwistStamped as velocity commands, stamped on arrival."""

        def received(_type_name: str, message: Message, received_ns: int) -> None:
            instant = _at(received_ns)
            command = from_twist(message, instant.wall_ns)
            take(msgspec.structs.replace(command, wall_ns=instant.wall_ns, mono_ns=instant.mono_ns))

        return self._subscribe(topic, ("geometry_msgs/Twist", "geometry_msgs/TwistStamped"), received)

    def graph(self, timeout_s: float = 2.0) -> Graph:
        """Participants, ROS topics and who is at their ends, once discovery has come to rest.

        Raises:
            LinkRoverError: this node has not joined.
        """
        until_s = time.monotonic() + timeout_s
        if not self._joined.wait(timeout_s) or self._closed.is_set():
            raise LinkRoverError(f"not part of DDS domain {self.network.domain}: {self.network.problem() or 'joining'}")
        found, since_s = self._read_graph(), time.monotonic()
        while time.monotonic() < until_s:
            if time.monotonic() - max(since_s, self._joined_s) >= QUIET_S and _all_shown(found):
                break
            time.sleep(0.05)
            newer = self._read_graph()
            if newer != found:
                found, since_s = newer, time.monotonic()
        return found

    def ping_peer(self, client: PingClient) -> PingPeer | None:
        """Who answers this client's pings; None: nobody, or not known. Reads what discovery knows, asks nobody."""
        goal = client.goal
        if goal is None or not self.joined or self._discovery is None:
            return None
        with self._discovering, contextlib.suppress(DDSException):
            keys = [key.bytes for key in goal.matched_participants()]
            people = {p.key: p for p in self._discovery.participants()}
            for key in keys:
                person = people.get(key)
                host = None if person is None else _host(person)
                if person is not None and host is not None:
                    return PingPeer(person.name, host, person.said)
        return None

    def close(self) -> None:
        """Leave the domain."""
        if self._closed.is_set():
            return
        self._closed.set()
        for end in self._ends:
            end()
        self._queue.put(None)
        if self._thread.is_alive():
            self._thread.join(5.0)

    def _ender(self, made: Sequence[Any]) -> Callable[[], None]:
        def end() -> None:
            for one in made:
                one.close()

        self._ends.append(end)
        return end

    def _later(self, work: _Work) -> None:
        self._queue.put(work)

    def _subscribe(
        self, topic: str, type_names: tuple[str, ...], take: Callable[[str, Message, int], None]
    ) -> Callable[[], None]:
        made: list[Subscription] = []
        full = self.names.resolve(topic)

        def begin() -> None:
            assert self._participant is not None
            made.append(Subscription(self._participant, dds_topic(full), type_names, take))
            self._subscriptions.append(made[0])

        self._later(begin)
        return self._ender(made)

    def _run(self) -> None:
        try:
            if self._join():
                self._work()
        finally:
            self._leave()

    def _join(self) -> bool:
        told = ""
        while not self._closed.is_set():
            problem, pause_s = self.network.problem(), JOIN_PERIOD_S
            if problem is None:
                try:
                    self._enter()
                except DDSException as error:
                    problem, pause_s = f"Cyclone DDS refuses ({error}); what it said is above", REJOIN_PERIOD_S
                else:
                    log.info("joined DDS domain %d as %s", self.network.domain, self.names.full_name)
                    return True
            if problem != told:
                told = problem
                log.warning(
                    "cannot join DDS domain %d: %s; recording without it, joining when it can be",
                    self.network.domain, problem,
                )  # fmt: skip
            self._closed.wait(pause_s)
        return False

    def _enter(self) -> None:
        if self._domain is None and self.network.config:
            self._domain = _domain(self.network)
        qos = Qos(Policy.EntityName(self.names.full_name), self._user_data())
        participant = DomainParticipant(self.network.domain, qos=qos)
        self._discovery = Discovery(participant)
        self._participant = participant
        self._joined_s = time.monotonic()
        self._joined.set()
        while self._early:
            self._queue.put(self._early.popleft())

    def _user_data(self) -> Policy.Userdata:
        said = {"enclave": "/", **self._parameters}
        return Policy.Userdata("".join(f"{name}={value};" for name, value in said.items()).encode())

    def _say_parameters(self) -> None:
        assert self._participant is not None
        self._participant.set_qos(Qos(self._user_data()))

    def _work(self) -> None:
        period_s = LOOK_PERIOD_S
        look_s = time.monotonic() + period_s
        while not self._closed.is_set():
            try:
                item = self._queue.get(timeout=max(0.0, look_s - time.monotonic()))
            except queue.Empty:
                period_s = min(2 * period_s, LOOK_PERIOD_LONGEST_S)
                look_s = time.monotonic() + period_s
                item = self._look
            if item is None:
                return
            try:
                if callable(item):
                    item()
                else:
                    self._publish_one(*item)
            except (DDSException, LinkRoverError, struct.error) as error:
                self._tell(f"{error}")
            except Exception as error:  # one message's fault must not end all topics
                if self._first(repr(error)):
                    log.exception("a message or topic failed; the others go on")

    def _publish_one(self, topic: str, type_name: str, fields: Fields, latched: bool) -> None:
        place = (topic, type_name)
        if place not in self._writers:
            self._writers[place] = None  # a type that is not known is said once
            assert self._participant is not None
            full = self.names.resolve(topic)
            self._writers[place] = Writer(self._participant, dds_topic(full), type_name, latched=latched)
        writer = self._writers[place]
        if writer is None or not (latched or writer.readers):
            return
        try:
            writer.write(fields() if callable(fields) else fields)
            self.published += 1
        except DDSException as error:
            self.lost_messages += 1
            self._tell(f"{topic}: a message was not taken: {error}")

    def _look(self) -> None:
        """A subscription nobody matches, though somebody publishes: another type, or none of the kind we hear."""
        alone = {s.topic: s for s in self._subscriptions if s.writers == 0}
        if not alone or self._discovery is None:
            return
        with self._discovering:
            publishers = self._discovery.publishers()
        for found in publishers:
            subscription = alone.get(dds_topic(found.topic))
            if subscription is None:
                continue
            wanted = [ros_name(dds_name(name)) or name for name in subscription.type_names]
            if found.type_name not in wanted:
                self._tell(f"{found.topic} carries {found.type_name}, expected {' or '.join(wanted)}: not recorded")

    def _read_graph(self) -> Graph:
        assert self._discovery is not None
        with self._discovering:
            return self._discovery.graph()

    def _leave(self) -> None:
        self._closed.set()
        participant, self._participant = self._participant, None
        with self._discovering:
            self._discovery = None
        for subscription in self._subscriptions:
            subscription.close()
        if participant is not None:
            # takes all that belongs to it along, and tells the peers
            participant.__del__()

    def _first(self, text: str) -> bool:
        if text in self._told:
            return False
        self._told.add(text)
        return True

    def _tell(self, text: str) -> None:
        if self._first(text) and not self._closed.is_set():
            log.error("%s", text)


def _domain(network: Network) -> Domain | None:
    """The domain with our configuration; None: this process is in it already (rclpy, another node), with its own."""
    try:
        return Domain(network.domain, network.config)
    except DDSException as error:
        if error.code != DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
            raise
        log.info("this process is in DDS domain %d already: its configuration holds", network.domain)
        return None


def _at(mono_ns: int) -> Now:
    """Both clocks at a time shortly ago."""
    instant = now()
    return Now(instant.wall_ns - (instant.mono_ns - mono_ns), mono_ns)


def _all_shown(found: Graph) -> bool:
    """Whether every participant has shown a topic: what it is known by comes first, its endpoints after."""
    shown = {name for topic in found.topics for name in (*topic.publishers, *topic.subscribers)}
    return shown >= set(found.nodes)


def _host(person: Participant) -> str | None:
    """An address of a participant to which datagrams can be sent; its own process is 127.0.0.1."""
    for text in person.addresses:
        if text == "localprocess":
            return "127.0.0.1"
        try:
            address = ipaddress.ip_address(text.partition("%")[0])
        except ValueError:
            continue
        if not address.is_multicast and not address.is_unspecified:
            return text
    return None
