"""How the tests share the cores: a file's tests stay together, what boots or builds something once stays together."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent
# One boot of a guest kernel, one build of the C++ peers: each room goes to one worker, and first, being the longest.
WHOLE_ROOMS = ("wifi", "ros1")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.pluginmanager.hasplugin("xdist"):
        return
    for item in items:
        inside = item.path.relative_to(HERE)
        room = inside.parts[0]
        item.add_marker(pytest.mark.xdist_group(room if room in WHOLE_ROOMS else str(inside)))
    items.sort(key=lambda item: _place(item.path.relative_to(HERE).parts[0]))


def _place(room: str) -> int:
    return WHOLE_ROOMS.index(room) if room in WHOLE_ROOMS else len(WHOLE_ROOMS)
