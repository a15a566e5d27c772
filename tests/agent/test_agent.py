from __future__ import annotations

import logging
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from linkrover.agent import Agent, AgentConfig, Probe, Rates
from linkrover.agent.machine import collect_interfaces, local_addresses, route_interface
from linkrover.errors import ConfigError
from linkrover.loop import Loop
from linkrover.records import (
    LinkUtilization,
    Manifest,
    NetworkDelay,
    NetworkErrors,
    Pose,
    ProbeResult,
    SelfAccount,
    Unknown,
)


class Kept:
    def __init__(self):
        self.records = []
        self.closed = 0

    def take(self, record):
        self.records.append(record)

    def close(self):
        self.closed += 1

    def of(self, kind):
        return [record for record in self.records if isinstance(record, kind)]


FAST = Rates(wireless_hz=20, utilization_hz=20, errors_hz=20, account_hz=5, clock_hz=5, tcp_hz=5)


def pose(x_m=0.0):
    return Pose(wall_ns=1, mono_ns=1, x_m=x_m, y_m=0, heading_rad=0)


def test_every_kind_of_record_comes_at_its_rate():
    sink = Kept()
    Agent(AgentConfig(interfaces=("lo",), duration_s=1.0, rates=FAST), sinks=[sink]).run()
    assert sink.closed == 1
    accounts = sink.of(SelfAccount)
    missed = sum(account.missed_slots for account in accounts)
    for kind in (LinkUtilization, NetworkErrors):
        assert 20 - missed <= len(sink.of(kind)) <= 21
    assert accounts[0].cpu_ns > 0
    assert accounts[0].rss_bytes > 1_000_000
    assert accounts[-1].lateness_max_ns >= accounts[-1].lateness_median_ns >= 0


def test_a_rate_of_zero_is_off():
    sink = Kept()
    rates = Rates(wireless_hz=0, utilization_hz=0, errors_hz=50, account_hz=0, tcp_hz=0)
    Agent(AgentConfig(interfaces=("lo",), duration_s=0.2, rates=rates), sinks=[sink]).run()
    assert {type(record) for record in sink.records} == {NetworkErrors}


def test_an_agent_probes_its_own_reflector_and_derives_delay_and_offset():
    sink = Kept()
    config = AgentConfig(interfaces=("lo",), reflect=True, duration_s=1.0, probe=Probe(rate_hz=50), rates=FAST)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        trial.bind(("127.0.0.1", 0))
        port = trial.getsockname()[1]
    config = AgentConfig(
        interfaces=("lo",),
        reflect=True,
        reflector=type(config.reflector)(port=port),
        peers=(f"127.0.0.1:{port}",),
        duration_s=1.0,
        probe=Probe(rate_hz=50),
        rates=FAST,
    )
    Agent(config, sinks=[sink]).run()
    delays, results = sink.of(NetworkDelay), sink.of(ProbeResult)
    answered = [delay for delay in delays if delay.alive]
    assert len(delays) >= 10
    assert len(answered) >= len(delays) - 2
    assert {delay.iface for delay in delays} == {"lo"}
    assert {(d.sequence, d.delay_ns) for d in answered} <= {(r.sequence, r.rtt_ns) for r in results}
    assert all(delay.method == "stamp" for delay in delays)


def test_a_peer_given_by_name_is_routed_through_its_interface():
    sink = Kept()
    probe = Probe(rate_hz=20, deadline_s=0.2)
    config = AgentConfig(interfaces=("nosuch0", "lo"), wait=True, peers=("localhost:9",), duration_s=1.0, probe=probe)
    Agent(config, sinks=[sink]).run()
    assert sink.of(NetworkDelay)[-1].iface == "lo"


def test_a_probe_without_an_answer_is_a_delay_of_none_with_its_reason():
    sink = Kept()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        peer = f"127.0.0.1:{silent.getsockname()[1]}"
        config = AgentConfig(peers=(peer,), duration_s=0.3, probe=Probe(rate_hz=20, deadline_s=0.2))
        Agent(config, sinks=[sink]).run()
    delays = sink.of(NetworkDelay)
    # all that were sent are settled: the agent waits for those in flight
    assert 1 <= len(delays) <= 7
    assert {(d.delay_ns, d.alive, d.unknown["delay_ns"], d.deadline_ns) for d in delays} == {
        (None, False, Unknown.TIMED_OUT, 200_000_000)
    }


class FailingSink(Kept):
    def take(self, record):
        raise RuntimeError("full")


def test_a_sink_that_fails_is_taken_out_and_the_others_go_on(caplog):
    good, bad = Kept(), FailingSink()
    agent = Agent(AgentConfig(interfaces=("lo",), duration_s=0.2, rates=FAST), sinks=[bad, good])
    with caplog.at_level(logging.ERROR, "linkrover.agent"):
        agent.run()
    assert len(good.of(LinkUtilization)) >= 2
    assert bad.closed == 1
    assert "FailingSink failed" in caplog.text


class CountingPart:
    def __init__(self):
        self.stopped = 0

    def start(self, agent):
        agent.every(50, self.sample, name="counting")
        agent.every(50, self.fail, name="failing")

    def sample(self):
        return [pose(3.0)]

    def fail(self):
        raise RuntimeError("broken sensor")

    def stop(self):
        self.stopped += 1


def test_a_part_measures_further_things_and_one_that_fails_stops_nothing(caplog):
    sink, part = Kept(), CountingPart()
    with caplog.at_level(logging.WARNING, "linkrover.agent"):
        Agent(AgentConfig(duration_s=0.3), sinks=[sink], parts=[part]).run()
    assert len(sink.of(Pose)) >= 2
    assert part.stopped == 1
    assert caplog.text.count("failing: failed") == 1
    assert "broken sensor" in caplog.text


def test_an_agent_in_a_loop_of_somebody_else_leaves_it_usable():
    loop, sink = Loop(), Kept()
    Agent(AgentConfig(interfaces=("lo",), duration_s=0.1, rates=FAST), loop, sinks=[sink]).run()
    assert sink.records
    loop.close()


def test_request_stop_from_another_thread_ends_the_run():
    agent = Agent(AgentConfig(interfaces=("lo",)))
    threading.Timer(0.1, agent.request_stop).start()
    agent.run()


def test_a_port_that_is_taken_closes_what_was_opened():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 0))
        config = AgentConfig(reflect=True)
        config = AgentConfig(reflect=True, reflector=type(config.reflector)(port=taken.getsockname()[1]))
        sink = Kept()
        with pytest.raises(ConfigError, match="is taken"):
            Agent(config, sinks=[sink]).run()
        assert sink.closed == 1


@pytest.mark.parametrize(
    ("config", "words"),
    [
        (AgentConfig(interfaces=("nosuch0",)), "there are: .*lo"),
        (AgentConfig(), "nothing to measure"),
        (AgentConfig(interfaces=("a/b",)), "cannot be an interface name"),
        (AgentConfig(peers=("host:99999",)), "65535"),
    ],
)
def test_what_cannot_be_measured_is_said_before_anything_starts(config, words):
    with pytest.raises(ConfigError, match=words):
        Agent(config).start()


def test_the_manifest_says_what_machine_this_is():
    config = AgentConfig(interfaces=("lo",), case="5", trial=2, run="r", notes={"adapter": "x"})
    agent = Agent(config)
    manifest = agent.manifest
    assert isinstance(manifest, Manifest)
    assert manifest.kernel
    assert (manifest.host, manifest.case, manifest.trial) == (socket.gethostname(), "5", 2)
    assert "net.ipv4.tcp_congestion_control" in manifest.sysctls
    assert manifest.interfaces[0].addresses[0] == "127.0.0.1"
    assert 'interfaces = ["lo"]' in manifest.config
    assert manifest.boot_id is not None
    assert manifest.notes["adapter"] == "x"
    assert manifest.notes["network_namespace"] == str(Path("/proc/self/ns/net").readlink())
    assert "synchronised" in manifest.notes["wall_clock"]
    agent.start()
    agent.close()


def test_addresses_and_routes_are_the_kernels():
    assert ("lo", "127.0.0.1") in local_addresses()
    here = (socket.AF_INET, ("127.0.0.1", 9))
    assert route_interface(*here, ["eth7", "lo"]) == "lo"
    assert route_interface(*here, ["eth7"]) is None
    assert route_interface(socket.AF_INET, ("255.255.255.255", 9), ["lo"]) is None
    assert collect_interfaces(["nosuch0"])[0].mac is None


def test_late_slots_are_accounted_for():
    sink = Kept()

    class Slow:
        def start(self, agent):
            agent.every(100, lambda: time.sleep(0.05) or (), name="slow")

        def stop(self):
            pass

    Agent(AgentConfig(duration_s=0.5, rates=Rates(account_hz=0.5)), sinks=[sink], parts=[Slow()]).run()
    assert sum(account.missed_slots for account in sink.of(SelfAccount)) > 5


def test_a_started_agent_carries_no_heavy_packages():
    """A robot's install has none of them, and its start must not wait for them."""
    code = (
        "import sys, tempfile, pathlib\n"
        "from linkrover.agent import Agent, AgentConfig\n"
        "from linkrover.bag.recorder import Recorder\n"
        "agent = Agent(AgentConfig(interfaces=('lo',), duration_s=0.1))\n"
        "agent.add_sink(Recorder(pathlib.Path(tempfile.mkdtemp()) / 'robot', agent.manifest))\n"
        "agent.run()\n"
        "print(*sorted({name.split('.')[0] for name in sys.modules}))\n"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "polars", "scipy", "matplotlib", "rich", "cyclopts", "pyroute2", "rosbags", "asyncio"} & {
        *loaded
    }
