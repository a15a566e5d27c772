"""Runs a plan over the emulated link: every run a process and a folder of its own, resumable after a kill."""

from __future__ import annotations

import contextlib
import os
import selectors
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

import msgspec

from linkrover.emulator import enter
from linkrover.errors import LinkRoverError
from linkrover.experiment.plan import Plan, TrialPlan, world_settings
from linkrover.experiment.run_one import Job
from linkrover.experiment.trial import View, load_outcome

PLAN_FILE = "experiment.json"
END_LIMIT_S = 40.0


class Made(msgspec.Struct, frozen=True):
    """What a folder of runs was made with; a resumed experiment must be the same."""

    plan: Plan
    virtual: bool
    duration_s: float | None


class Run(msgspec.Struct):
    """A run of the experiment and where it stands: waiting, running, done, failed or skipped (done before)."""

    plan: TrialPlan
    out: Path
    state: str = "waiting"
    view: View | None = None
    problem: str = ""
    seconds: float = 0.0


def prepare(runs: list[TrialPlan], out: Path, made: Made, *, resume: bool) -> list[Run]:
    """The runs with their folders, those that are whole already marked as skipped.

    A run that a kill broke off is removed, for it is made again exactly so; nothing else is ever overwritten.

    Raises:
        LinkRoverError: `out` holds runs and resume is False, or they were made otherwise.
    """
    note = out / PLAN_FILE
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        if not resume:
            raise LinkRoverError(f"{out} is there already: --resume goes on with it, --out names another folder")
        try:
            before = msgspec.json.decode(note.read_bytes(), type=Made)
        except (OSError, msgspec.DecodeError) as error:
            raise LinkRoverError(f"{out} holds no experiment of this kind ({PLAN_FILE}): give another --out") from error
        if before != made:
            raise LinkRoverError(
                f"{out} was made with another plan, --duration or --virtual: give another --out, or the same again"
            )
    out.mkdir(parents=True, exist_ok=True)
    note.write_bytes(msgspec.json.format(msgspec.json.encode(made)))
    found = []
    for each in runs:
        run = Run(each, out / each.folder)
        outcome = load_outcome(run.out)
        if outcome is not None and not outcome.interrupted:
            run.state, run.seconds = "skipped", outcome.seconds
        elif run.out.exists():
            shutil.rmtree(run.out)
        found.append(run)
    return found


class _Process:
    """A run's process and what it says."""

    def __init__(self, run: Run, job: Job, selector: selectors.BaseSelector) -> None:
        run.out.mkdir(parents=True)
        self.run = run
        self._file = run.out / "job.json"
        self._file.write_bytes(msgspec.json.encode(job))
        self._log: IO[bytes] = (run.out / "log.txt").open("wb")
        # enter.py only ties its life to ours here: a killed experiment leaves no run behind
        command = [sys.executable, "-I", "-S", enter.__file__, "-1", "--", sys.executable]
        self.process = subprocess.Popen(
            [*command, "-m", "linkrover.experiment.run_one", str(self._file)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._log,
            start_new_session=True,
        )
        assert self.process.stdout is not None
        self._pipe = self.process.stdout
        os.set_blocking(self._pipe.fileno(), False)
        self._rest = b""
        self._selector = selector
        selector.register(self._pipe, selectors.EVENT_READ, self)
        self.began = time.monotonic()

    def read(self) -> None:
        """Take in what it said."""
        data = self._pipe.read()
        if data == b"":
            self._selector.unregister(self._pipe)
            return
        *lines, self._rest = (self._rest + (data or b"")).split(b"\n")
        with contextlib.suppress(msgspec.DecodeError, IndexError):
            self.run.view = msgspec.json.decode(lines[-1], type=View)

    def finish(self) -> None:
        """It has ended: note how."""
        with contextlib.suppress(KeyError):
            self._selector.unregister(self._pipe)
        self._pipe.close()
        self._log.close()
        run, log = self.run, self.run.out / "log.txt"
        run.seconds = time.monotonic() - self.began
        outcome = load_outcome(run.out)
        if self.process.returncode == 0 and outcome is not None and not outcome.interrupted:
            run.state = "done"
            if log.stat().st_size == 0:
                log.unlink()
            self._file.unlink()
        else:
            run.state = "failed"
            run.problem = log.read_text(errors="replace").strip()[-500:] or f"status {self.process.returncode}"


def run_all(
    plan: Plan,
    runs: list[Run],
    made: Made,
    *,
    jobs: int,
    file: str,
    show: Callable[[list[Run]], None] = lambda _runs: None,
) -> None:
    """Make every run that waits, `jobs` at a time. A failed one is noted in its Run and the others go on.

    On KeyboardInterrupt the runs in progress are ended in order, and the interrupt goes on.

    Raises:
        ConfigError: the plan names a case the emulator cannot make.
    """
    settings = {id(run): world_settings(plan, run.plan, made.duration_s, file) for run in runs}
    waiting = [run for run in runs if run.state == "waiting"]
    active: list[_Process] = []
    seconds = made.duration_s if made.duration_s is not None else plan.duration_s
    with selectors.DefaultSelector() as selector:
        try:
            while waiting or active:
                while waiting and len(active) < jobs:
                    run = waiting.pop(0)
                    run.state = "running"
                    job = Job(settings=settings[id(run)], out=str(run.out), virtual=made.virtual, duration_s=seconds)
                    active.append(_Process(run, job, selector))
                for key, _ in selector.select(0.1):
                    key.data.read()
                for each in [one for one in active if one.process.poll() is not None]:
                    each.finish()
                    active.remove(each)
                show(runs)
        finally:
            for each in active:
                each.process.terminate()
            for each in active:
                _await(each.process)
                each.finish()


def _await(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(END_LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
