"""XML-RPC calls to master and nodes that end in time: rospy's own wait for minutes when the link is down."""

from __future__ import annotations

import http.client
import os
import xml.parsers.expat
import xmlrpc.client
from typing import Any

from linkrover.errors import LinkRoverError


class RpcError(LinkRoverError):
    """A master or node that does not answer, or answers with an error."""


class _Transport(xmlrpc.client.Transport):
    def __init__(self, timeout_s: float) -> None:
        super().__init__()
        self._timeout_s = timeout_s

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        if self._connection and host == self._connection[0] and self._connection[1]:
            return self._connection[1]
        connection = http.client.HTTPConnection(host if isinstance(host, str) else host[0], timeout=self._timeout_s)
        self._connection = host, connection
        return connection


class Rpc:
    """One peer's XML-RPC API. Not for use by two threads at once."""

    def __init__(self, uri: str, caller: str, timeout_s: float = 2.0) -> None:
        self.uri = uri
        self.caller = caller
        try:
            self._proxy = xmlrpc.client.ServerProxy(uri, transport=_Transport(timeout_s), allow_none=True)
        except OSError as error:
            raise RpcError(f"'{uri}' is not an address of a ROS master or node (http://host:port): {error}") from error

    def raw(self, method: str, *arguments: Any) -> Any:
        """The answer as it came.

        Raises:
            RpcError: no answer in time, or an error as the answer.
        """
        try:
            return getattr(self._proxy, method)(self.caller, *arguments)
        except xmlrpc.client.Fault as error:
            raise RpcError(f"{self.uri} {method}: {error.faultString}") from error
        except (OSError, http.client.HTTPException, xmlrpc.client.Error, xml.parsers.expat.ExpatError) as error:
            raise RpcError(f"{self.uri} {method}: {error or type(error).__name__}") from error

    def call(self, method: str, *arguments: Any) -> Any:
        """The value of a (code, message, value) answer.

        Raises:
            RpcError: as raw(), or a code other than 1.
        """
        answer = self.raw(method, *arguments)
        if not isinstance(answer, list) or len(answer) != 3:
            raise RpcError(f"{self.uri} {method}: not an answer of the ROS slave API")
        code, message, value = answer
        if code != 1:
            raise RpcError(f"{self.uri} {method}: {message}")
        return value


def master_uri() -> str:
    """Where the master is said to be."""
    return os.environ.get("ROS_MASTER_URI") or "http://localhost:11311"
