from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.middleware.contract import Driver, MiddlewareContract, Start

if TYPE_CHECKING:
    from linkrover.ros2.node import Ros2


def started(name: str) -> Ros2:
    """The factory that tests.middleware.driver calls in a process of its own."""
    from linkrover.ros2.node import Ros2

    node = Ros2(name)
    node.start()
    return node


ABSENT = '<General><Interfaces><NetworkInterface name="absent0"/></Interfaces></General>'


class TestRos2(MiddlewareContract):
    @pytest.fixture
    def start(self, environment: dict[str, str], drivers: list[Driver]) -> Start:
        def begin(verb: str, *arguments: object, joined: bool = True) -> Driver:
            # without a master there is no graph that is away: what is away is the network
            told = environment if joined else {**environment, "CYCLONEDDS_URI": ABSENT}
            driver = Driver(told, "tests.ros2.test_contract:started", verb, *arguments)
            drivers.append(driver)
            return driver

        return begin
