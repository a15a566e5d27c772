"""One ROS 1 node: `linkrover.middleware.Middleware` by rospy, arranged so that sampling never waits for it.

Three threads of ours stand between the sampling loop and the network: one joins the graph and registers topics
(rospy's calls to the master block), one converts and publishes from a bounded queue, one watches the master.
"""

from __future__ import annotations

import collections
import functools
import logging
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rospy
import rospy.core
import rospy.impl.registration as registration
from rosgraph.names import is_legal_base_name

from linkrover.errors import ConfigError
from linkrover.middleware.protocol import Answer, Fields, Graph
from linkrover.records import Pose, VelocityCommand

from .fill import build
from .graph import Parameters, read_graph
from .motion import Odometry, Velocity
from .ping import PingClient, PingServer
from .rosout import forward_internal_errors
from .rpc import Rpc, RpcError, master_uri
from .types import Ros1MissingError, message_class
from .watch import MasterWatch

QUEUE = 1000
"""Messages that may wait for the publishing thread; more are dropped and counted, never waited for."""
JOIN_PERIOD_S = 1.0

log = logging.getLogger("linkrover.ros1")


class Ros1:
    """A ROS 1 node; only one in a process, because rospy keeps its state in modules.

    argv: remappings and private parameters as roslaunch and rosrun pass them (`__ns:=/robot`, `a:=b`).
    """

    name = "ros1"

    def __init__(self, node: str, argv: Sequence[str] = (), *, queue_size: int = QUEUE) -> None:
        remappings = [a for a in argv if ":=" in a]
        given = [a.partition(":=")[2] for a in remappings if a.startswith("__name:=")]
        self._argv = [a for a in remappings if not a.startswith("__name:=")]
        self._node = given[-1] if given else node
        if not is_legal_base_name(self._node):
            raise ConfigError(
                f"'{self._node}' cannot be a ROS node name: letters, digits and _, beginning with a letter"
            )
        self._queue: queue.Queue[tuple[str, str, Fields, bool] | None] = queue.Queue(queue_size)
        self._publishers: dict[str, Any] = {}
        self._wanted: collections.deque[Callable[[], None]] = collections.deque()
        self._wake = threading.Event()
        self._closed = threading.Event()
        self._joined = threading.Event()
        self._ended = False
        self._watch: MasterWatch | None = None
        self._unknown_types: set[str] = set()
        self._parameters: dict[str, str] = {}
        self._threads = [
            threading.Thread(target=self._run, name="ros1 registrar", daemon=True),
            threading.Thread(target=self._publish_from_queue, name="ros1 publisher", daemon=True),
        ]
        self.lost_messages = 0
        self.published = 0
        self.resolved_name = ""

    @property
    def node(self) -> str:
        """The name asked for, without namespace."""
        return self._node

    @property
    def argv(self) -> tuple[str, ...]:
        """Remappings and private parameters."""
        return tuple(self._argv)

    def resolve(self, name: str) -> str:
        """The full name after namespace and remappings; once joined."""
        return str(rospy.resolve_name(name))

    @property
    def joined(self) -> bool:
        """Registered with a master that answers."""
        return self._joined.is_set() and not self._ended and (self._watch is None or self._watch.reachable)

    @property
    def registrations(self) -> int:
        """How often everything was registered again after a restart of the master."""
        return self._watch.registrations if self._watch is not None else 0

    def describe(self) -> str:
        """For the manifest."""
        return f"ros1 {os.environ.get('ROS_DISTRO', 'noetic')} {master_uri()} {self.resolved_name or self._node}"

    def start(self) -> None:
        """Join as soon as there is a master; returns at once."""
        for thread in self._threads:
            thread.start()

    def wait_joined(self, timeout_s: float) -> bool:
        """Wait for the first registration; for tests and tools, not for sampling."""
        return self._joined.wait(timeout_s)

    def publish(self, topic: str, type_name: str, fields: Fields, *, latched: bool = False) -> bool:
        """Queue a message; never blocks. False: the queue was full, the message is counted in lost_messages."""
        if not latched and not self._joined.is_set():
            return True  # nobody could be listening yet
        try:
            self._queue.put_nowait((topic, type_name, fields, latched))
        except queue.Full:
            self.lost_messages += 1
            return False
        return True

    def set_parameter(self, name: str, value: str) -> None:
        """A private parameter of this node on the master; set again when the master was restarted."""
        self._parameters[name] = value
        if self._joined.is_set():
            self._later(self._set_parameters)

    def _set_parameters(self) -> None:
        master = Rpc(master_uri(), self.resolved_name)
        for name, value in self._parameters.items():
            try:
                master.call("setParam", f"{self.resolved_name}/{name}", value)
            except RpcError as error:  # noqa: PERF203
                log.warning("cannot set the parameter %s: %s", name, error)

    def _register_again(self) -> None:
        _register_everything()
        self._set_parameters()

    def answer_pings(self, action: str) -> Callable[[], None]:
        """Serve the ping action; warns where somebody else already does."""
        servers: list[PingServer] = []

        def begin() -> None:
            others = self._publishers_of(rospy.resolve_name(f"{action}/result"))
            if others:
                log.warning(
                    "%s already answers pings on '%s': answers of two servers mix; remap one of them (Ping:=...)",
                    ", ".join(others), action,
                )  # fmt: skip
            servers.append(PingServer(rospy.remap_name(action)))

        self._later(begin)
        return lambda: self._later(lambda: _close_all(servers))

    def pinger(self, action: str, on_answer: Callable[[Answer], None]) -> DeferredPinger:
        """A client of the ping action; says once when the server comes and goes."""
        pinger = DeferredPinger(action, on_answer)
        self._later(pinger.connect)
        return pinger

    def odometry(self, topic: str, take: Callable[[Pose], None]) -> Callable[[], None]:
        """nav_msgs/Odometry as poses, by the definition its publisher sends, so nav_msgs need not be installed."""
        return self._subscribe(lambda: Odometry(topic, take))

    def velocity(self, topic: str, take: Callable[[VelocityCommand], None]) -> Callable[[], None]:
        """geometry_msgs/Twist or TwistStamped as velocity commands."""
        return self._subscribe(lambda: Velocity(topic, take))

    def subscribe_with(self, make: Callable[[], Any]) -> Callable[[], None]:
        """Run `make` once the node has joined; what it returns is closed by the returned function."""
        return self._subscribe(make)

    def graph(self, timeout_s: float = 2.0) -> Graph:
        """Nodes and topics as the master knows them."""
        return read_graph(self.resolved_name or "/linkrover", timeout_s)

    def close(self) -> None:
        """Leave the graph; bounded in time even when the master is away."""
        self._closed.set()
        self._wake.set()
        if self._watch is not None:
            self._watch.close()
        if self._joined.is_set() and not self._ended:
            # rospy unregisters with unbounded waits; a master that is away must not hold up the end of a recording
            last = threading.Thread(target=rospy.signal_shutdown, args=("linkrover ends",), daemon=True)
            last.start()
            last.join(3.0)

    def _later(self, work: Callable[[], None]) -> None:
        self._wanted.append(work)
        self._wake.set()

    def _subscribe(self, make: Callable[[], Any]) -> Callable[[], None]:
        made: list[Any] = []
        self._later(lambda: made.append(make()))
        return lambda: self._later(lambda: _close_all(made))

    def _run(self) -> None:
        if not self._join():
            return
        while not self._closed.is_set():
            self._wake.wait(1.0)
            self._wake.clear()
            while self._wanted and not self._closed.is_set():
                work = self._wanted.popleft()
                try:
                    work()
                except (Ros1MissingError, rospy.ROSException, ValueError) as error:
                    log.error("%s", error)

    def _join(self) -> bool:
        name = self._wait_for_name()
        if name is None:
            return False
        arguments = [sys.argv[0] if sys.argv else "linkrover", *self._argv]
        os.environ.setdefault("ROS_PYTHON_LOG_CONFIG_FILE", str(Path(__file__).with_name("logging.conf")))
        try:
            rospy.init_node(name, argv=arguments, disable_signals=True, disable_rosout=True, disable_rostime=True)
        except (rospy.ROSException, ValueError) as error:
            log.error("cannot join the ROS graph: %s; the recording goes on without it", error)
            return False
        rospy.core.add_preshutdown_hook(self._ended_by)
        self.resolved_name = rospy.get_name()
        forward_internal_errors(log)
        uri = rospy.core.get_node_uri()
        self._watch = MasterWatch(self.resolved_name, uri, self._register_again)
        self._watch.start()
        log.info("joined the ROS graph at %s as %s", master_uri(), self.resolved_name)
        self._set_parameters()
        self._joined.set()
        self._warn_of_simulated_time()
        return True

    def _wait_for_name(self) -> str | None:
        """Wait for the master; then our name, or with a number behind it where that one is taken by a living node."""
        said = False
        while not self._closed.is_set():
            try:
                return self._free_name()
            except RpcError as error:
                if not said:
                    log.warning("no ROS master yet (%s): recording without it, joining when it comes", error)
                    said = True
            self._closed.wait(JOIN_PERIOD_S)
        return None

    def _free_name(self) -> str:
        parameters = Parameters(self._node, self._argv)
        name = self._node
        for number in range(2, 100):
            code, _, uri = Rpc(master_uri(), "/linkrover").raw("lookupNode", f"{parameters.namespace}{name}")
            if code != 1 or not _alive(uri):
                return name
            taken, name = name, f"{self._node}_{number}"
            log.warning("a node %s%s is running already: this one is called %s", parameters.namespace, taken, name)
        return f"{self._node}_{os.getpid()}"

    def _warn_of_simulated_time(self) -> None:
        try:
            if Rpc(master_uri(), self.resolved_name).call("getParam", "/use_sim_time"):
                log.warning(
                    "/use_sim_time is set: LinkRover measures real networks and goes on stamping with real time; "
                    "its stamps do not compare with /clock"
                )
        except RpcError:
            return  # not set

    def _ended_by(self, reason: str) -> None:
        self._ended = True
        if not self._closed.is_set():
            log.error("this ROS node was shut down (%s); the recording goes on, topics end here", reason)

    def _publish_from_queue(self) -> None:
        self._joined.wait()
        while not self._closed.is_set():
            try:
                item = self._queue.get(timeout=0.5)
            except queue.Empty:
                continue
            if item is not None and not self._ended:
                self._publish_one(*item)

    def _publish_one(self, topic: str, type_name: str, fields: Fields, latched: bool) -> None:
        publisher = self._publishers.get(topic)
        if publisher is None:
            if type_name in self._unknown_types:
                return
            if topic not in self._publishers:
                self._publishers[topic] = None
                self._later(lambda: self._advertise(topic, type_name, latched))
            if latched:
                # a latched message is said once: it waits for its topic
                self._later(functools.partial(self._publish_again, topic, type_name, fields))
            return
        if not latched and publisher.get_num_connections() == 0:
            return
        try:
            publisher.publish(build(type_name, fields() if callable(fields) else fields))
            self.published += 1
        except Exception as error:  # noqa: BLE001  one message's fault must not end all topics
            if not self._closed.is_set() and topic not in self._unknown_types:
                self._unknown_types.add(topic)
                log.error("cannot publish on %s: %s", topic, error)

    def _publish_again(self, topic: str, type_name: str, fields: Fields) -> None:
        self.publish(topic, type_name, fields, latched=True)

    def _advertise(self, topic: str, type_name: str, latched: bool) -> None:
        try:
            cls = message_class(type_name)
        except Ros1MissingError:
            self._unknown_types.add(type_name)
            raise
        self._publishers[topic] = rospy.Publisher(topic, cls, queue_size=100, latch=latched, tcp_nodelay=True)

    def _publishers_of(self, topic: str) -> tuple[str, ...]:
        try:
            return next((t.publishers for t in self.graph().topics if t.name == topic), ())
        except RpcError:
            return ()


class DeferredPinger:
    """A Pinger that may be used before the node has joined: until then nothing is sent."""

    def __init__(self, action: str, on_answer: Callable[[Answer], None]) -> None:
        self._action = action
        self._on_answer = on_answer
        self._client: PingClient | None = None
        self._closed = False
        self._was_connected: bool | None = None
        self._began = time.monotonic()

    def connect(self) -> None:
        """Called by the registrar once the node has joined."""
        if not self._closed:
            self._client = PingClient(rospy.remap_name(self._action), self._on_answer)

    def send(self, sequence: int) -> bool:
        """Ask; False without a server."""
        sent = self._client is not None and self._client.send(sequence)
        if sent != self._was_connected and (sent or time.monotonic() - self._began > 2.0):
            if sent and self._client is not None and self._client.servers > 1:
                log.warning("%d ping servers share the name '%s'", self._client.servers, self._action)
            if sent:
                log.info("a ping server answers on '%s'", self._action)
            else:
                log.warning("no ping server on '%s' (start: linkrover ros1 ping-server)", self._action)
            self._was_connected = sent
        return sent

    def cancel(self, sequence: int) -> None:
        """Tell the server."""
        if self._client is not None:
            self._client.cancel(sequence)

    def close(self) -> None:
        """No more."""
        self._closed = True
        if self._client is not None:
            threading.Thread(target=self._client.close, daemon=True).start()


def _close_all(made: Sequence[Any]) -> None:
    for one in made:
        one.close()


def _alive(uri: str) -> bool:
    try:
        return bool(Rpc(uri, "/linkrover", 1.0).call("getPid"))
    except RpcError:
        return False


def _register_everything() -> None:
    """Tell the master again what it forgot; rospy's own registration listener does the calls."""
    topics = registration.get_topic_manager()
    listeners = registration.get_registration_listeners()
    kinds = registration.Registration
    for name, data_type in topics.get_publications():
        listeners.notify_added(name, data_type, kinds.PUB)
    for name, data_type in topics.get_subscriptions():
        listeners.notify_added(name, data_type, kinds.SUB)
    for name, uri in registration.get_service_manager().get_services():
        listeners.notify_added(name, uri, kinds.SRV)
