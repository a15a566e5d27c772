from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time

import pytest

from linkrover.bag.reading import read_recording
from linkrover.emulator import presets
from linkrover.emulator.robot import OUT_AND_BACK
from linkrover.emulator.world import WorldSettings
from linkrover.experiment.trial import load_outcome, run_trial, run_virtual_trial
from linkrover.records import LinkTruth, Manifest
from tests.emulator.needs import packets

LINKROVER = [sys.executable, "-m", "linkrover"]
PLAN = """
name = "small"
trials = 2
[trajectory]
route = "out-and-back"
[[cases]]
name = "router-2.4"
[[cases]]
name = "station-ap-internal-5"
"""


@pytest.fixture(autouse=True)
def runtime(monkeypatch):
    with tempfile.TemporaryDirectory(prefix="lr-", dir="/tmp") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield folder


@pytest.fixture
def plan(tmp_path):
    file = tmp_path / "plan.toml"
    file.write_text(PLAN)
    return file


def experiment(plan, *more):
    command = [*LINKROVER, "experiment", "emulate", str(plan), "--out", str(plan.parent / "runs"), *more]
    return subprocess.run(command, capture_output=True, text=True)


def test_an_experiment_in_virtual_time_is_whole_compared_and_not_made_twice(plan):
    done = experiment(plan, "--virtual", "--duration", "8", "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert (found["whole"], found["failed"], found["disagree"]) == (4, {}, [])
    rows = {row["case"]: row for row in found["cases"]}
    assert rows["router-2.4"]["trials"] == 2
    assert rows["router-2.4"]["throughput_2021_mbps"] == 12.0
    assert rows["station-ap-internal-5"]["throughput_mbps"] > 1
    runs = plan.parent / "runs"
    assert (runs / "report.html").stat().st_size > 10_000
    manifests = list(read_recording(runs / "router-2.4" / "trial-2" / "robot").records(Manifest))
    assert (manifests[0].case, manifests[0].trial, manifests[0].simulated) == ("router-2.4", 2, True)
    files = {path: path.stat().st_mtime_ns for path in runs.rglob("*.mcap")}
    assert len(files) == 12

    again = experiment(plan, "--virtual", "--duration", "8")
    assert again.returncode != 0
    assert "--resume goes on with it" in again.stderr
    other = experiment(plan, "--virtual", "--duration", "9", "--resume")
    assert other.returncode != 0
    assert "another plan, --duration or --virtual" in other.stderr
    resumed = experiment(plan, "--virtual", "--duration", "8", "--resume")
    assert resumed.returncode == 0
    assert "4 of them already whole" in resumed.stdout
    assert {path: path.stat().st_mtime_ns for path in runs.rglob("*.mcap")} == files


def test_the_same_seed_makes_the_same_run_and_another_seed_another(tmp_path):
    def figures(name, seed):
        settings = WorldSettings(case=presets.find("router-2.4"), seed=seed, route=OUT_AND_BACK.fitted(5))
        return run_virtual_trial(settings, tmp_path / name, duration_s=5).agreement.figures

    assert figures("first", 7) == figures("again", 7)
    assert figures("other", 8) != figures("third", 7)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_experiment_leaves_no_process_and_goes_on_where_it_was(plan, number):
    runs = plan.parent / "runs"
    options = ["--virtual", "--jobs", "1", "--duration", "30"]
    command = [*LINKROVER, "experiment", "emulate", str(plan), *options, "--out", str(runs)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    for line in process.stdout:
        if "1 of 4" in line:
            break
    process.send_signal(number)
    process.stdout.close()
    status = process.wait(60)
    assert status == (-9 if number == signal.SIGKILL else 130)
    until = time.monotonic() + 20
    while os.system(f"grep -lqsa {runs}/ /proc/[0-9]*/cmdline 2>/dev/null | grep -q .") == 0:
        assert time.monotonic() < until
    whole = [path for path in runs.rglob("outcome.json") if not load_outcome(path.parent).interrupted]
    assert 1 <= len(whole) < 4
    if number == signal.SIGINT:
        return  # going on is the same after either
    before = {path: path.stat().st_mtime_ns for path in whole}
    done = experiment(plan, *options, "--resume")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 of 4 runs whole" in done.stdout
    assert {path: path.stat().st_mtime_ns for path in whole} == before


@pytest.mark.parametrize(
    ("line", "words"), [("robots = 2", "virtual time knows one robot"), ("[probe]\ndeadline_s = 1.0", "it is 2 s")]
)
def test_what_virtual_time_cannot_do_is_refused_before_anything_is_made(plan, line, words):
    plan.write_text(PLAN.replace('name = "small"', 'name = "small"\n' + line) if "=" in line[:9] else PLAN + line)
    done = experiment(plan, "--virtual")
    assert done.returncode in (1, 2)
    assert words in done.stderr.replace("\n", " ")
    assert not (plan.parent / "runs").exists()


def test_a_run_that_fails_is_named_and_the_others_are_made(plan):
    runs = plan.parent / "runs"
    (runs / "router-2.4").mkdir(parents=True)
    # not a folder: the runs of this case cannot be made
    (runs / "experiment.json").write_text("{}")
    done = experiment(plan, "--virtual", "--duration", "5", "--resume")
    assert done.returncode != 0
    assert "holds no experiment of this kind" in done.stderr


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--jobs", "0"], "--jobs 0: must be 1 or more"),
        (["--duration", "1"], "must be at least 3 s"),
        (["--case", "nothing"], "no such case in the plan"),
    ],
)
def test_bad_options_are_refused_before_anything_is_made(plan, more, words):
    done = experiment(plan, "--virtual", *more)
    assert done.returncode in (1, 2)
    assert words in done.stderr.replace("\n", " ")
    assert not (plan.parent / "runs").exists()


@pytest.mark.netns
def test_a_real_time_trial_through_the_router_agrees_and_knows_all_four_hops(tmp_path):
    packets()
    settings = WorldSettings(case=presets.find("router-2.4"), seed=4, route=OUT_AND_BACK.fitted(7))
    outcome = run_trial(settings, tmp_path / "run", duration_s=7)
    hops = {r.hop for r in read_recording(tmp_path / "run" / "truth").records(LinkTruth)}
    assert hops == {"robot>router", "router>robot", "station>router", "router>station"}
    figures = {figure.what: figure for figure in outcome.agreement.figures}
    assert figures["robot sends"].true > 5
    assert outcome.agreement.agrees, [f for f in outcome.agreement.figures if f.agrees is False]
    assert outcome.summary["truth_lost"] == 0
    assert outcome.notes == ()
    # the same in virtual time: same channel, modelled programs. Over 25 s on an idle machine they agree within 10 %;
    # a few seconds on a busy one hold TCP's start and late senders, hence this tolerance
    simulated = run_virtual_trial(settings, tmp_path / "virtual", duration_s=7)
    other = {figure.what: figure for figure in simulated.agreement.figures}
    for what in ("robot sends", "station receives"):
        assert other[what].true == pytest.approx(figures[what].true, rel=0.45)
    for what in ("RSSI at robot", "RSSI at station"):
        assert other[what].true == pytest.approx(figures[what].true, abs=2)


@pytest.mark.netns
def test_an_experiment_with_real_packets_runs_from_the_plan(plan):
    packets()
    plan.write_text(PLAN.replace("trials = 2", "trials = 1"))
    done = experiment(plan, "--duration", "3", "--case", "station-ap-internal-5", "--json")
    found = json.loads(done.stdout)
    assert (found["whole"], found["failed"]) == (1, {}), done.stderr
    run = plan.parent / "runs" / "station-ap-internal-5" / "trial-1"
    assert all(m.emulated and not m.simulated for m in read_recording(run / "robot").records(Manifest))
