"""What the tests with real packets need, and why they are skipped where it is not there."""

from __future__ import annotations

import functools
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

NOBODY = 65534


@functools.cache
def why_no_packets() -> str | None:
    """Tried in a process of its own: entering a user namespace cannot be undone."""
    code = (
        "from linkrover.emulator.netns import become_namespace_root, make_host\n"
        "become_namespace_root(); make_host('x', '10.77.0.9').close()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    return None if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


def packets() -> None:
    """Skip the test unless namespaces and TUN devices can be had directly."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces within this process need root")
    reason = why_no_packets()
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
