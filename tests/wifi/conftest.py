"""Tests in `guest/` run inside the guest kernel: one boot for all that were selected, each reported under its name.

On this machine every collected guest test is replaced by a `GuestItem` that shows what the guest said of it. Inside
the guest (LINKROVER_GUEST is set) they are ordinary tests, and their outcomes go to the shared folder line by line,
so that a run that was cut short still shows how far it came.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from .boot import GuestRun, run_job
from .kernel import CACHE, PROJECT, GuestUnavailableError

GUEST_TESTS = Path(__file__).parent / "guest"
REPORT_TESTS = Path(__file__).parent / "test_report.py"
AGENT_TESTS = "tests/wifi/guest/test_agents.py"
INSIDE = "LINKROVER_GUEST" in os.environ
BOOT_TIMEOUT_S = 400.0  # a guest on a busy machine; the run itself takes about a quarter of this
TEST_TIMEOUT_S = 90


class GuestFailureError(Exception):
    """A test failed in the guest; the text is what pytest said there."""


class GuestSession:
    """The one boot of this test run."""

    def __init__(self, nodeids: list[str]) -> None:
        self.nodeids = nodeids
        self.run: GuestRun | None = None
        self.unavailable: str | None = None
        self.reports: dict[str, list[dict[str, Any]]] = {}

    def boot(self) -> None:
        """Run all selected guest tests, once."""
        if self.run is not None or self.unavailable is not None:
            return
        share = CACHE / f"run-{os.getpid()}"
        share.mkdir(parents=True, exist_ok=True)
        (share / "nodeids").write_text("\n".join(self.nodeids) + "\n")
        try:
            self.run = run_job(_pytest_job(), share, BOOT_TIMEOUT_S)
        except GuestUnavailableError as reason:
            self.unavailable = str(reason)
            return
        outcomes = share / "outcomes.jsonl"
        for line in outcomes.read_text().splitlines() if outcomes.exists() else ():
            report = json.loads(line)
            self.reports.setdefault(report["nodeid"], []).append(report)
        last = CACHE / "last"  # the newest run's console and JUnit, for a reader and for CI to keep
        if last.is_symlink() or last.exists():
            last.unlink()
        last.symlink_to(share.name)
        for old in sorted(CACHE.glob("run-*"), key=lambda p: p.stat().st_mtime)[:-5]:
            shutil.rmtree(old)


GUEST = pytest.StashKey[GuestSession]()


@pytest.fixture(scope="session")
def guest_session(request: pytest.FixtureRequest) -> GuestSession:
    """The boot of this test run, for tests that read what it left behind."""
    return request.config.stash[GUEST]


class GuestItem(pytest.Item):
    """A guest test as this machine shows it."""

    guest: GuestSession

    def setup(self) -> None:
        """Boot, if no earlier guest test has."""
        self.guest.boot()
        if self.guest.unavailable:
            pytest.skip(f"no guest kernel: {self.guest.unavailable}")

    def runtest(self) -> None:
        """Say what the guest said."""
        run = self.guest.run
        assert run is not None
        reports = self.guest.reports.get(self.nodeid, [])
        for report in reports:
            if report["outcome"] == "skipped":
                pytest.skip(f"in the guest: {report['text']}")
            if report["outcome"] == "failed":
                raise GuestFailureError(f"in the guest, {report['when']} of this test:\n{report['text']}")
        if not any(r["when"] == "teardown" for r in reports):
            raise GuestFailureError(
                f"the guest (exit code {run.exit_code}) never finished this test:\n{run.console[-4000:]}"
            )
        self.add_report_section("call", "guest", f"took {sum(r['duration'] for r in reports):.1f} s in the guest")
        if self.nodeid == self.guest.nodeids[-1] and run.exit_code not in (0, 1):
            raise GuestFailureError(f"the guest's pytest ended with exit code {run.exit_code}:\n{run.console[-4000:]}")

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:  # type: ignore[override]
        """The guest's own words, without this machine's stack."""
        return (
            str(excinfo.value) if isinstance(excinfo.value, GuestFailureError) else super().repr_failure(excinfo, style)
        )

    def reportinfo(self) -> tuple[Path, int, str]:
        """Where the test is written."""
        return self.path, 0, self.nodeid


def _pytest_job() -> str:
    command = [
        sys.executable,
        *("-m", "pytest", "-c", "/dev/null", "--rootdir", str(PROJECT), "-p", "no:cacheprovider"),
        *("-p", "pytest_timeout", "-o", f"timeout={TEST_TIMEOUT_S}"),
        *("-ra", "-v", "--durations=12", "--junitxml=/result/junit.xml", "--tb=short"),
        "@/result/nodeids",
    ]
    return (
        f"cd {shlex.quote(str(PROJECT))}\n"
        "export LINKROVER_GUEST=1 PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 PYTHONPATH=src\n"
        f"exec {shlex.join(command)}\n"
    )


if INSIDE:

    def pytest_runtest_logreport(report: pytest.TestReport) -> None:
        """Every outcome at once to the shared folder."""
        text = report.longreprtext
        if report.outcome == "skipped" and isinstance(report.longrepr, tuple):
            text = report.longrepr[2]
        for title, content in report.sections if report.outcome == "failed" else ():
            text += f"\n--- {title}\n{content[-4000:]}"
        line = {
            "nodeid": report.nodeid,
            "when": report.when,
            "outcome": report.outcome,
            "duration": report.duration,
            "text": text,
        }
        with Path("/result/outcomes.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")

else:

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
        """Put a GuestItem in the place of every guest test."""
        nodeids = [item.nodeid for item in items if GUEST_TESTS in item.path.parents]
        if any(item.path == REPORT_TESTS for item in items) and not any(AGENT_TESTS in one for one in nodeids):
            nodeids.append(AGENT_TESTS)  # they make what the report tests read
        if not nodeids:
            return
        guest = config.stash[GUEST] = GuestSession(nodeids)
        for index, item in enumerate(items):
            if GUEST_TESTS in item.path.parents:
                items[index] = _stand_in(item, guest)


def _stand_in(item: pytest.Item, guest: GuestSession) -> GuestItem:
    assert item.parent is not None
    new: GuestItem = GuestItem.from_parent(item.parent, name=item.name)
    new.guest = guest
    marks: Iterable[pytest.Mark] = item.own_markers
    new.own_markers.extend(marks)
    new.keywords.update({mark.name: mark for mark in marks})
    new.add_marker(pytest.mark.wifi)
    new.add_marker(pytest.mark.timeout(int(BOOT_TIMEOUT_S) + 60))
    return new
