from __future__ import annotations

import signal
import tempfile
from pathlib import Path

import pytest

from linkrover.emulator import presets
from linkrover.emulator.robot import OUT_AND_BACK
from linkrover.emulator.world import EmulationError, World, WorldSettings
from linkrover.records import LinkTruth, Pose

from .needs import packets

pytestmark = pytest.mark.netns


@pytest.fixture(autouse=True)
def runtime(monkeypatch):
    with tempfile.TemporaryDirectory(prefix="lr-", dir="/tmp") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield Path(folder)


def settings(**more):
    return WorldSettings(case=presets.find("5"), seed=1, route=OUT_AND_BACK.fitted(20), **more)


def test_a_part_that_dies_is_named_with_its_last_words_and_all_the_rest_is_ended(runtime, tmp_path):
    packets()
    with World(settings(), tmp_path, lambda _record: None) as world:
        world.start_link()
        world.start_traffic()
        parts = list(world._parts)
        victim = next(part for part in parts if part.what == "robot's traffic")
        victim.process.send_signal(signal.SIGKILL)
        with pytest.raises(EmulationError, match=r"the robot's traffic ended by itself \(status -9\)"):
            world.run(10)
    assert all(part.process.poll() is not None for part in parts)
    assert list((runtime / "linkrover").iterdir()) == []


def test_the_robot_moves_by_what_crosses_the_link_and_the_truth_knows_where(tmp_path):
    packets()
    truth = []
    with World(settings(), tmp_path, truth.append) as world:
        world.start_link()
        world.start_traffic()
        world.run(20, lambda: any(isinstance(r, Pose) and abs(r.x_m) > 0.3 for r in truth))
        world.stop()
        summary = world.summary
    assert summary["traffic"]["robot"]["commands"]["messages"] > 5
    assert summary["traffic"]["station"]["camera"]["messages"] > 0
    assert summary["truth_lost"] == 0
    distances = [r.distance_m for r in truth if isinstance(r, LinkTruth)]
    assert distances[-1] != distances[0]
