"""What the tests with real packets need, and why they are skipped where it is not there."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from linkrover.emulator.netns import why_not

NOBODY = 65534


def packets() -> None:
    """Skip the test unless namespaces and TUN devices can be had directly."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces within this process need root")
    reason = why_not()
    if reason is not None:
        pytest.skip(f"no namespaces or TUN devices here: {reason}")


def as_nobody(tun_mode: int, command: list[str], folder: str) -> list[str]:
    """The command as an ordinary user who sees a /dev/net/tun of that mode, in a mount namespace of its own."""
    if os.geteuid() != 0:
        pytest.skip("to become an ordinary user the test needs root")
    for tool in ("unshare", "setpriv"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} (util-linux) is not installed")
    tun = f"{folder}/tun"
    os.mknod(tun, 0o600 | stat.S_IFCHR, os.makedev(10, 200))
    Path(tun).chmod(tun_mode)
    Path(folder).chmod(0o777)
    drop = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    trial = subprocess.run([*drop, sys.executable, "-c", "import linkrover.emulator"], capture_output=True, text=True)
    if trial.returncode != 0:
        pytest.skip("the checkout or its Python cannot be read by an ordinary user")
    return ["unshare", "-m", "sh", "-c", 'mount --bind "$0" /dev/net/tun && exec "$@"', tun, *drop, *command]
