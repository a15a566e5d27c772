"""The log: to standard error at once, to /rosout through the publishing queue, never by rospy's blocking calls."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .node import Ros1

_LEVELS = {logging.DEBUG: 1, logging.INFO: 2, logging.WARNING: 4, logging.ERROR: 8, logging.CRITICAL: 16}
_WORTH_SAYING = (
    "md5sum",
    "topic types do not match",
    "Inbound TCP/IP connection failed",
    "unable to create subscriber",
)


class RosoutHandler(logging.Handler):
    """Hands log records to a node's publishing queue as rosgraph_msgs/Log on /rosout."""

    def __init__(self, node: Ros1) -> None:
        super().__init__(logging.INFO)
        self._node = node

    def emit(self, record: logging.LogRecord) -> None:
        """Queue; a full queue drops the line, it is on standard error anyway."""
        self._node.publish(
            "/rosout",
            "rosgraph_msgs/Log",
            {
                "header": {"stamp": int(record.created * 1e9)},
                "level": _LEVELS.get(record.levelno, 2),
                "name": self._node.resolved_name,
                "msg": record.getMessage(),
                "file": record.filename,
                "function": record.funcName or "",
                "line": record.lineno,
            },
        )


class _Forward(logging.Handler):
    """Errors rospy keeps to its log file though the user must act on them, said once a minute each."""

    def __init__(self, to: logging.Logger) -> None:
        super().__init__(logging.WARNING)
        self._to = to
        self._said: dict[str, float] = {}

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage().strip().splitlines()
        line = next((t for t in reversed(text) if any(word in t for word in _WORTH_SAYING)), None)
        if line is None:
            return
        now_s = time.monotonic()
        if now_s - self._said.get(line, -60.0) >= 60.0:
            self._said[line] = now_s
            self._to.error("%s", line)


def forward_internal_errors(to: logging.Logger) -> None:
    """Let peers with another md5sum and the like be heard of."""
    handler = _Forward(to)
    for name in ("rospy.internal", "rosout"):
        logging.getLogger(name).addHandler(handler)
