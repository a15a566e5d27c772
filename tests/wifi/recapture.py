"""python -m tests.wifi.recapture: takes the fixtures of tests/sources from a real kernel anew."""

from __future__ import annotations

import shlex
import shutil
import sys

from .boot import run_job
from .kernel import CACHE, PROJECT


def main() -> None:
    """Boot, capture, and put the result into the tree."""
    share = CACHE / "capture"
    job = (
        f"cd {shlex.quote(str(PROJECT))}\nexport PYTHONPATH=src:.\n"
        f"exec {shlex.quote(sys.executable)} -m tests.wifi.guest.capture\n"
    )
    run = run_job(job, share, 300)
    if run.exit_code != 0:
        raise SystemExit(run.console[-4000:])
    target = PROJECT / "tests" / "sources" / "captured" / "nl80211.json"
    target.parent.mkdir(exist_ok=True)
    shutil.copy(share / "captured.json", target)
    print(f"captured {target.stat().st_size} bytes: {target.relative_to(PROJECT)}")


if __name__ == "__main__":
    main()
