"""One run of an experiment as a process of its own: `run_one JOB.json`; says how far it is as JSON lines."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import msgspec

from linkrover.emulator.netns import become_namespace_root
from linkrover.emulator.world import WorldSettings
from linkrover.errors import LinkRoverError
from linkrover.experiment.trial import View, run_trial, run_virtual_trial

SAY_PERIOD_S = 0.2


class Job(msgspec.Struct, frozen=True, kw_only=True):
    """What to run. duration_s None: until the drive is over."""

    settings: WorldSettings
    out: str
    virtual: bool
    duration_s: float | None


def main() -> int:
    """Entry point; exit status 0 done, 1 failed, 130 interrupted."""
    job = msgspec.json.decode(Path(sys.argv[1]).read_bytes(), type=Job)
    said_s, stage = 0.0, ""

    def show(view: View) -> None:
        nonlocal said_s, stage
        if time.monotonic() - said_s >= SAY_PERIOD_S or view.stage != stage:
            said_s, stage = time.monotonic(), view.stage
            print(msgspec.json.encode(view).decode(), flush=True)

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    try:
        if job.virtual:
            outcome = run_virtual_trial(job.settings, Path(job.out), duration_s=job.duration_s, show=show)
        else:
            become_namespace_root()
            outcome = run_trial(job.settings, Path(job.out), duration_s=job.duration_s, show=show)
    except LinkRoverError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 130 if outcome.interrupted else 0


if __name__ == "__main__":
    sys.exit(main())
