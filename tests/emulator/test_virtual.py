"""Virtual time end to end, in short runs; the ten cases at full length are `benchmarks virtual_cases`."""

import pytest

from linkrover.emulator.agreement import compare
from linkrover.emulator.presets import find
from linkrover.emulator.virtual import Simulation, VirtualSettings, run
from linkrover.errors import ConfigError, LinkRoverError
from linkrover.records import LinkTruth, LinkUtilization, NetworkDelay, Pose, ProbeResult, ProbeState, VelocityCommand


class Memory:
    def __init__(self):
        self.records = []

    def take(self, record):
        self.records.append(record)

    def of(self, kind):
        return [record for record in self.records if isinstance(record, kind)]


def simulate(case, seconds, seed=1, **settings):
    sinks = {end: Memory() for end in ("robot", "station", "truth")}
    simulation = Simulation(find(case), seed, sinks, VirtualSettings(**settings))
    for _ in simulation.run(seconds):
        pass
    return simulation, sinks


@pytest.fixture(scope="module")
def internal():
    return simulate("3", 60.0)


def test_what_the_ends_record_agrees_with_the_truth(internal):
    _, sinks = internal
    ends = {end: sinks[end].records for end in ("robot", "station")}
    result = compare(ends, sinks["truth"].records)
    assert result.agrees, [figure for figure in result.figures if figure.agrees is False]
    assert len([figure for figure in result.figures if figure.agrees]) >= 7


def test_the_streams_are_recorded_at_their_rates(internal):
    _, sinks = internal
    assert len(sinks["robot"].of(Pose)) == pytest.approx(60 * 50, abs=2)
    assert len(sinks["robot"].of(ProbeResult)) == pytest.approx(60 * 10, abs=25)
    assert len(sinks["robot"].of(NetworkDelay)) == pytest.approx(60, abs=3)
    assert len(sinks["robot"].of(VelocityCommand)) == pytest.approx(600, abs=60)
    assert len(sinks["station"].of(LinkUtilization)) == pytest.approx(60, abs=2)
    assert len(sinks["truth"].of(LinkTruth)) == pytest.approx(2 * 60 * 20, abs=4)


def test_the_robot_moves_by_commands_that_crossed_the_link(internal):
    simulation, _ = internal
    assert simulation.robot.travelled_m > 10
    assert simulation.commands.received > 500


def test_application_delay_is_above_the_probes(internal):
    _, sinks = internal
    delays = sorted(r.delay_ns for r in sinks["robot"].of(NetworkDelay) if r.delay_ns is not None)
    probes = sorted(r.rtt_ns for r in sinks["robot"].of(ProbeResult) if r.rtt_ns is not None)
    assert delays[len(delays) // 2] > probes[len(probes) // 2]


def test_a_run_is_the_same_again_with_its_seed_and_another_with_another():
    one, two, other = (simulate("5", 8.0, seed)[1]["truth"].records for seed in (3, 3, 4))
    assert one == two
    assert one != other


def test_a_drop_out_shows_as_probes_lost_and_association_events():
    _, sinks = simulate("7", 45.0, seed=2)
    states = [record.state for record in sinks["robot"].of(ProbeResult)]
    assert states.count(ProbeState.LOST_FORWARD) > 30
    truth = sinks["truth"].of(LinkTruth)
    assert any(not record.associated for record in truth)
    kinds = {record.kind.value for record in sinks["station"].records if type(record).__name__ == "LinkEvent"}
    assert "disconnected" in kinds


def test_without_signal_at_the_access_point_it_records_none():
    _, sinks = simulate("3", 3.0, access_point_shows_signal=False)
    names = [type(record).__name__ for record in sinks["robot"].records]
    assert "WirelessLink" not in names
    assert "WirelessLink" in [type(record).__name__ for record in sinks["station"].records]


@pytest.mark.parametrize(("case", "lowest", "highest"), [("1", 12.0, 12.0), ("2", 69.5, 69.5), ("8", 67.6, 80.0)])
def test_near_the_start_throughput_is_within_1_5_of_the_2021_recordings(case, lowest, highest):
    simulation, _ = simulate(case, 12.0)
    out = sum(hop.offered_octets for hop in simulation.medium.hops() if hop.sender == "robot")
    assert lowest / 1.5 < out * 8 / 12.0 / 1e6 < highest * 1.5


def test_run_writes_three_recordings_marked_as_simulated_and_never_overwrites(tmp_path):
    from linkrover.analysis.load import load_run

    seen = []
    run(find("6"), 2, 5, 10.0, tmp_path / "out", progress=seen.append)
    assert len(seen) >= 9
    loaded = load_run(tmp_path / "out")
    assert loaded.robot is not None
    assert loaded.robot.manifest.simulated
    assert (loaded.case, loaded.trial) == ("station-ap-internal-5", 2)
    assert (tmp_path / "out" / "truth").is_dir()
    with pytest.raises(LinkRoverError, match="recording"):
        run(find("6"), 2, 5, 10.0, tmp_path / "out")
    with pytest.raises(ConfigError, match="duration_s"):
        run(find("6"), 2, 5, 0.0, tmp_path / "other")
