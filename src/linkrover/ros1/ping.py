"""The ping action on its bare topics: actionlib's wire protocol without its state machines.

A SimpleActionClient allows one goal at a time and rospy's ActionClient walks every status message of the server
under a lock; the round trip itself is two messages. Goals go to <action>/goal with an identifier of ours, answers
come on <action>/result. The server keeps what actionlib clients wait for: all five topics, and the status list.
Both ends therefore talk to actionlib's Python and C++ counterparts.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable
from typing import Any

import rospy
from genpy.rostime import Time

from linkrover.middleware.protocol import Answer

from .types import message_class

STATUS_PERIOD_S = 0.2
"""actionlib's status rate, 5 Hz; ours is published only while somebody listens."""
STATUS_KEPT_S = 5.0
"""How long a finished goal stays in the status list, as in actionlib."""
QUEUE = 256
"""Goals that may wait for a stalled connection: older ones are dropped, so nothing grows in an outage."""
SUCCEEDED = 3  # actionlib_msgs/GoalStatus
PREEMPTED = 2
RECALLED = 8

log = logging.getLogger("linkrover.ros1")


def wall_time() -> Time:
    """Now on CLOCK_REALTIME, whatever /use_sim_time says."""
    ns = time.time_ns()
    return Time(ns // 1_000_000_000, ns % 1_000_000_000)


class PingClient:
    """Asks a ping action server; a `linkrover.middleware.Pinger`.

    The identifier of a goal is "<node>-<pid>-<sequence>-<nanoseconds>": unique over restarts and clients.
    """

    def __init__(self, action: str, on_answer: Callable[[Answer], None]) -> None:
        self._goal_class = message_class("network_analysis/PingActionGoal")
        self._id_class = message_class("actionlib_msgs/GoalID")
        result_class = message_class("network_analysis/PingActionResult")
        self._on_answer = on_answer
        self._prefix = f"{rospy.get_name()}-{os.getpid()}-"
        self._suffix = f"-{time.time_ns()}"
        self._closed = False
        self._goal = rospy.Publisher(f"{action}/goal", self._goal_class, queue_size=QUEUE, tcp_nodelay=True)
        self._cancel = rospy.Publisher(f"{action}/cancel", self._id_class, queue_size=QUEUE, tcp_nodelay=True)
        self._result = rospy.Subscriber(f"{action}/result", result_class, self._received, tcp_nodelay=True)

    @property
    def connected(self) -> bool:
        """Whether a server listens to goals and its results reach us."""
        return bool(self._goal.get_num_connections() and self._result.get_num_connections())

    @property
    def servers(self) -> int:
        """How many servers listen to goals of this name; more than one is a mistake of set-up."""
        return int(self._goal.get_num_connections())

    def send(self, sequence: int) -> bool:
        """Ask; False when no server is connected."""
        if self._closed or not self.connected:
            return False
        goal = self._goal_class()
        stamp = wall_time()
        goal.header.stamp = stamp
        goal.goal_id.stamp = stamp
        goal.goal_id.id = f"{self._prefix}{sequence}{self._suffix}"
        goal.goal.inp = True
        self._goal.publish(goal)
        return True

    def cancel(self, sequence: int) -> None:
        """Tell the server that this goal is stale."""
        if not self._closed and self._cancel.get_num_connections():
            self._cancel.publish(self._id_class(id=f"{self._prefix}{sequence}{self._suffix}"))

    def close(self) -> None:
        """Unregister."""
        self._closed = True
        for endpoint in (self._goal, self._cancel, self._result):
            endpoint.unregister()

    def _received(self, message: Any) -> None:
        received_ns = time.monotonic_ns()
        identifier = message.status.goal_id.id
        if identifier.startswith(self._prefix) and identifier.endswith(self._suffix):
            digits = identifier[len(self._prefix) : -len(self._suffix)]
            if digits.isdigit():
                # Whatever the verdict (a server may recall stale goals after an outage), the round trip was made.
                self._on_answer(Answer(int(digits), received_ns))


class PingServer:
    """Answers the ping action at once, in the thread that received the goal."""

    def __init__(self, action: str) -> None:
        self._status_class = message_class("actionlib_msgs/GoalStatus")
        self._array_class = message_class("actionlib_msgs/GoalStatusArray")
        self._result_class = message_class("network_analysis/PingActionResult")
        self._feedback_class = message_class("network_analysis/PingActionFeedback")
        self._lock = threading.Lock()
        self._recent: dict[str, tuple[float, Any]] = {}
        self._cancelled: dict[str, float] = {}
        self._done = threading.Event()
        self.answered = 0
        options = {"queue_size": QUEUE, "tcp_nodelay": True}
        self._result = rospy.Publisher(f"{action}/result", self._result_class, **options)
        self._feedback = rospy.Publisher(f"{action}/feedback", self._feedback_class, **options)
        self._status = rospy.Publisher(f"{action}/status", self._array_class, latch=True, **options)
        goal_class = message_class("network_analysis/PingActionGoal")
        self._cancel = rospy.Subscriber(
            f"{action}/cancel", message_class("actionlib_msgs/GoalID"), self._on_cancel, tcp_nodelay=True
        )
        self._goal = rospy.Subscriber(f"{action}/goal", goal_class, self._on_goal, tcp_nodelay=True)
        self._thread = threading.Thread(target=self._publish_status, name="ping status", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Unregister."""
        self._done.set()
        for endpoint in (self._goal, self._cancel, self._result, self._feedback, self._status):
            endpoint.unregister()

    def _on_goal(self, goal: Any) -> None:
        identifier = goal.goal_id.id
        if not identifier:
            return  # actionlib would make one up, which the asker cannot know
        cancelled = self._cancelled.pop(identifier, None) is not None
        status = self._status_class(goal_id=goal.goal_id, status=RECALLED if cancelled else SUCCEEDED)
        stamp = wall_time()
        if goal.goal.inp and not cancelled and self._feedback.get_num_connections():
            feedback = self._feedback_class(status=status)
            feedback.header.stamp = stamp
            feedback.feedback.fb = True
            self._feedback.publish(feedback)
        result = self._result_class(status=status)
        result.header.stamp = stamp
        result.result.outp = bool(goal.goal.inp) and not cancelled
        self._result.publish(result)
        with self._lock:
            self._recent[identifier] = (time.monotonic(), status)
            self.answered += 1

    def _on_cancel(self, goal_id: Any) -> None:
        # Answered goals cannot be cancelled any more; one that is still behind the cancel on its own connection is.
        if goal_id.id and goal_id.id not in self._recent:
            now_s = time.monotonic()
            self._cancelled = {i: t for i, t in self._cancelled.items() if now_s - t < STATUS_KEPT_S}
            self._cancelled[goal_id.id] = now_s

    def _publish_status(self) -> None:
        # Latched and sent at once: a client that joins learns of the server by its first status message.
        while True:
            with self._lock:
                limit = time.monotonic() - STATUS_KEPT_S
                self._recent = {i: kept for i, kept in self._recent.items() if kept[0] >= limit}
                listed = [status for _, status in self._recent.values()]
            array = self._array_class(status_list=listed)
            array.header.stamp = wall_time()
            try:
                self._status.publish(array)
            except rospy.ROSException:
                return  # closed meanwhile
            if self._done.wait(STATUS_PERIOD_S):
                return
