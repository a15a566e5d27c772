"""The harness itself: what it says where the guest cannot be had, and how a guest test's outcome is shown here."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from . import kernel
from .boot import GuestRun
from .conftest import INSIDE, GuestFailureError, GuestItem, GuestSession

pytestmark = pytest.mark.skipif(INSIDE, reason="is about the outside")
NODE = "tests/wifi/guest/test_x.py::test_y"


def outcome(when: str, what: str, text: str = "") -> dict[str, Any]:
    return {"nodeid": NODE, "when": when, "outcome": what, "duration": 0.5, "text": text}


class Shown:
    """The parts of a GuestItem that show an outcome, without a collection around them."""

    nodeid = NODE
    setup = GuestItem.setup
    runtest = GuestItem.runtest

    def __init__(self, *reports: dict[str, Any], exit_code: int | None = 0, unavailable: str | None = None) -> None:
        self.guest = GuestSession([NODE])
        self.guest.unavailable = unavailable
        if unavailable is None:
            self.guest.run = GuestRun(exit_code, "the console's last words", Path())
        self.guest.reports = {NODE: list(reports)}
        self.sections: list[str] = []

    def add_report_section(self, _when: str, _name: str, text: str) -> None:
        self.sections.append(text)


def test_a_passed_test_passes_and_tells_its_time():
    shown = Shown(outcome("setup", "passed"), outcome("call", "passed"), outcome("teardown", "passed"))
    shown.setup()
    shown.runtest()
    assert shown.sections == ["took 1.5 s in the guest"]


@pytest.mark.parametrize("when", ["setup", "call", "teardown"])
def test_a_failure_in_any_phase_fails_here_with_the_guests_words(when: str):
    phases = [
        outcome(one, "failed" if one == when else "passed", "E assert 1 == 2") for one in ("setup", "call", "teardown")
    ]
    with pytest.raises(GuestFailureError, match=f"{when} of this test:\nE assert 1 == 2"):
        Shown(*phases, exit_code=1).runtest()


def test_a_skip_in_the_guest_is_a_skip_here_with_its_reason():
    with pytest.raises(pytest.skip.Exception, match="in the guest: no such radio"):
        Shown(outcome("setup", "skipped", "no such radio"), outcome("teardown", "passed")).runtest()


@pytest.mark.parametrize("reports", [(), (outcome("setup", "passed"),)])
def test_a_test_that_was_cut_short_fails_with_the_console(reports: tuple[dict[str, Any], ...]):
    with pytest.raises(GuestFailureError, match="the console's last words"):
        Shown(*reports, exit_code=None).runtest()


def test_a_broken_exit_of_the_guests_pytest_is_not_hidden_behind_passed_tests():
    passed = [outcome(one, "passed") for one in ("setup", "call", "teardown")]
    with pytest.raises(GuestFailureError, match="exit code 3"):
        Shown(*passed, exit_code=3).runtest()


def test_without_a_guest_every_test_is_skipped_with_the_reason():
    with pytest.raises(pytest.skip.Exception, match="no guest kernel: qemu is not there"):
        Shown(unavailable="qemu is not there").setup()


def test_a_missing_program_is_named_with_its_package(monkeypatch: pytest.MonkeyPatch):
    real = shutil.which
    monkeypatch.setattr(kernel.shutil, "which", lambda name, **more: None if "qemu" in name else real(name, **more))
    with pytest.raises(kernel.GuestUnavailableError, match="Debian package qemu-system-x86"):
        kernel.prepare()


def test_a_kernel_compressed_in_an_unknown_way_says_so():
    image = bytearray(4096)
    image[0x1F1] = 1
    image[0x24C] = 6
    with pytest.raises(kernel.GuestUnavailableError, match="compressed in a way not known here"):
        kernel._uncompressed(bytes(image))
