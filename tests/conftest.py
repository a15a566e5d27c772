"""How the tests share the cores: a file's tests stay together, what boots or builds something once stays together."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from xdist.scheduler import LoadScopeScheduling

HERE = Path(__file__).parent
# One boot of a guest kernel, one build of the C++ peers: each room goes to one worker, and first, being the longest.
WHOLE_ROOMS = ("wifi", "ros1")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: _place(item.path.relative_to(HERE).parts[0]))


@pytest.hookimpl(optionalhook=True)  # only where the tests run side by side
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    from xdist.scheduler import LoadScopeScheduling

    class ByFileOrRoom(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            _, room, *rest = nodeid.partition("::")[0].split("/")
            return room if room in WHOLE_ROOMS else "/".join([room, *rest])

    return ByFileOrRoom(config, log)


def _place(room: str) -> int:
    return WHOLE_ROOMS.index(room) if room in WHOLE_ROOMS else len(WHOLE_ROOMS)
