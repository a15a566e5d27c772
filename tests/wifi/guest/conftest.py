"""The air of the guest tests: five radios, a namespace each."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from .air import Air, Eye, Radio, radios

NAMESPACES = ["robot", "station", "robot2", "station2", "spare"]
ADDRESSES = {"robot": "10.1.0.1", "station": "10.1.0.2", "robot2": "10.1.0.3", "station2": "10.1.0.4"}


@pytest.fixture(scope="session")
def all_radios() -> list[Radio]:
    made = radios(len(NAMESPACES), NAMESPACES)
    for radio in made[:4]:
        radio.address(f"{ADDRESSES[radio.ns]}/24")
    return made


@pytest.fixture(scope="session")
def robot(all_radios: list[Radio]) -> Radio:
    return all_radios[0]


@pytest.fixture(scope="session")
def station(all_radios: list[Radio]) -> Radio:
    return all_radios[1]


@pytest.fixture(scope="session")
def robot2(all_radios: list[Radio]) -> Radio:
    return all_radios[2]


@pytest.fixture(scope="session")
def station2(all_radios: list[Radio]) -> Radio:
    return all_radios[3]


@pytest.fixture(scope="session")
def spare(all_radios: list[Radio]) -> Radio:
    return all_radios[4]


@pytest.fixture(scope="module")
def air(request: pytest.FixtureRequest, all_radios: list[Radio]) -> Iterator[Air]:
    folder = Path("/result/logs") / request.module.__name__.rpartition(".")[2]  # a reader of a failure wants them
    folder.mkdir(parents=True)
    made = Air(folder)
    yield made
    made.close()
    for radio in all_radios[:4]:
        radio.level(-30)


@pytest.fixture(scope="module")
def eyes(all_radios: list[Radio]) -> Iterator[dict[str, Eye]]:
    made = {radio.ns: Eye(radio) for radio in all_radios}
    yield made
    for eye in made.values():
        eye.close()
