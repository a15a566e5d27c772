from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.middleware.contract import Driver, MiddlewareContract, Start

if TYPE_CHECKING:
    from linkrover.ros1.node import Ros1

from .conftest import Master, free_port


def started(name: str) -> Ros1:
    """The factory that tests.middleware.driver calls in a process of its own."""
    from linkrover.ros1.node import Ros1

    node = Ros1(name)
    node.start()
    return node


class TestRos1(MiddlewareContract):
    @pytest.fixture
    def start(self, master: Master, drivers: list[Driver]) -> Start:
        def begin(verb: str, *arguments: object, joined: bool = True) -> Driver:
            environment = master.environment()
            if not joined:
                environment["ROS_MASTER_URI"] = f"http://127.0.0.1:{free_port()}"
            driver = Driver(environment, "tests.ros1.test_contract:started", verb, *arguments)
            drivers.append(driver)
            return driver

        return begin
