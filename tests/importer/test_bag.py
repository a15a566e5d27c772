from __future__ import annotations

from pathlib import Path

import pytest

from linkrover.analysis import load_run, summarise
from linkrover.cli.import_ import import_
from linkrover.errors import LinkRoverError
from linkrover.importer.bag import import_bag
from tests.bag.ros1_bags import bag_of_2021


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("rosbags", reason="rosbags, which writes the bag to be read, is not installed")
    return bag_of_2021(tmp_path_factory.mktemp("bags") / "external_robot_5G.bag", seconds=30)


def test_a_bag_of_2021_gives_the_same_figures_straight_and_imported(bag: Path, tmp_path: Path) -> None:
    done = import_bag(bag, tmp_path)
    straight, imported = load_run(bag), load_run(done.folder)
    assert (straight.case, straight.trial) == (imported.case, imported.trial) == ("8", 1)
    assert straight.published_2021
    assert imported.published_2021
    for method in ("linkrover", "pandey2022"):
        first, second = summarise(straight, method), summarise(imported, method)
        assert set(first.ends) == {"robot", "station"}
        for role in first.ends:
            for name, figures in first.ends[role].interfaces.items():
                other = second.ends[role].interfaces[name]
                assert figures.throughput_mbps.mean == pytest.approx(other.throughput_mbps.mean)
                assert figures.rssi_dbm.mean == pytest.approx(other.rssi_dbm.mean)
                assert figures.retransmits == other.retransmits
        assert first.delay_ms.mean == pytest.approx(second.delay_ms.mean)


def test_topics_of_other_names_are_told_by_a_table(bag: Path, tmp_path: Path) -> None:
    table = tmp_path / "topics.toml"
    table.write_text('[[topic]]\ntopic = "/robot/iface1/network_analysis/.*"\nend = "station"\nalso = true\n')
    moved = load_run(bag, topics=table)
    assert moved.station is not None
    usual = load_run(bag)
    assert usual.station is not None
    assert sum(len(t["t_s"]) for t in moved.station.wireless.values()) > sum(
        len(t["t_s"]) for t in usual.station.wireless.values()
    )


def test_a_bag_of_something_else_is_a_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.bag"
    other.write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(LinkRoverError, match=r"other\.bag"):
        import_bag(other, tmp_path / "runs")
    assert import_(other, out=tmp_path / "runs") == 1
    assert "other.bag" in capsys.readouterr().err
    assert not (tmp_path / "runs" / "other").exists()


def test_a_lost_ping_of_a_bag_is_out_from_its_deadline_to_the_next_answer(bag: Path) -> None:
    summary = summarise(load_run(bag))
    assert summary.delay_ms.lost == 1
    # it was known at 5.25 s; the next answer came 1.05 s later, in a run of 30.5 s
    assert summary.delay_ms.time_out_percent == pytest.approx(100 * 1.05 / summary.duration_s, rel=0.02)
