"""Keeps a node registered: rospy itself never notices that the master was restarted."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from .rpc import Rpc, RpcError, master_uri

PERIOD_S = 2.0
"""One small call to the master this often (0.7 kB)."""

log = logging.getLogger("linkrover.ros1")


class MasterWatch:
    """A thread that asks the master for our own entry, and registers everything again when it is not there."""

    def __init__(
        self, node: str, node_uri: str, register_again: Callable[[], None], period_s: float = PERIOD_S
    ) -> None:
        self._node = node
        self._node_uri = node_uri
        self._register_again = register_again
        self._period_s = period_s
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name="master watch", daemon=True)
        self._master: Rpc | None = None
        self.reachable = True
        self.registrations = 0

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """Ask no more."""
        self._done.set()

    def _run(self) -> None:
        due = time.monotonic()
        while not self._done.wait(max(0.0, due - time.monotonic())):
            due = max(due + self._period_s, time.monotonic())
            self._look()

    def _look(self) -> None:
        try:
            # one kept connection: a new one for each look would be most of its cost on the link
            self._master = self._master or Rpc(master_uri(), self._node)
            code, _, uri = self._master.raw("lookupNode", self._node)
        except (RpcError, ValueError) as error:
            if self.reachable:
                log.warning(
                    "the ROS master is not reachable (%s); recording goes on, topics resume by themselves", error
                )
            self.reachable = False
            self._master = None
            return
        if not self.reachable:
            log.warning("the ROS master is reachable again")
        self.reachable = True
        if code == 1 and uri == self._node_uri:
            return
        if code == 1:
            log.error(
                "another node took the name %s (%s): the master no longer leads to this one; "
                "start one of them with another __name:=",
                self._node,
                uri,
            )
            return
        log.warning("the ROS master has forgotten this node (was it restarted?): registering again")
        self._register_again()
        self.registrations += 1
