"""Boots the guest once, lets it run one job, and brings back what it left in the shared folder."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

from .kernel import GuestUnavailableError, prepare

MEMORY_MB = 1024


@dataclass(frozen=True)
class GuestRun:
    """What one boot left behind. exit_code None: the guest never came to the end of its job."""

    exit_code: int | None
    console: str
    share: Path


def run_job(job: str, share: Path, timeout_s: float) -> GuestRun:
    """Boot, run the shell text `job` as root in the guest, power off.

    The guest sees this machine's / read-only under a tmpfs, and `share` read-write as /result.

    Raises:
        GuestUnavailableError: qemu or the kernel package cannot be had here.
    """
    kernel = prepare()
    if platform.system() != "Linux":
        raise GuestUnavailableError("the guest needs a Linux host")
    share.mkdir(parents=True, exist_ok=True)
    for leftover in ("exit", "console.log"):
        (share / leftover).unlink(missing_ok=True)
    (share / "job").write_text(job)
    console = share / "console.log"
    command = [
        "qemu-system-x86_64",
        *("-machine", "q35", "-accel", "kvm" if _kvm() else "tcg,thread=multi,tb-size=512"),
        *("-cpu", "max", "-smp", "1", "-m", str(MEMORY_MB), "-nodefaults", "-no-user-config", "-no-reboot"),
        *("-display", "none", "-serial", f"file:{console}"),
        *("-kernel", str(kernel.vmlinux), "-initrd", str(kernel.initramfs)),
        *("-append", "console=ttyS0 quiet panic=-1 mitigations=off tsc=unstable clocksource=hpet random.trust_cpu=on"),
        *("-fsdev", "local,id=root,path=/,security_model=none,readonly=on,multidevs=remap"),
        *("-device", "virtio-9p-pci,fsdev=root,mount_tag=hostroot"),
        *("-fsdev", f"local,id=result,path={share},security_model=none"),
        *("-device", "virtio-9p-pci,fsdev=result,mount_tag=result"),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as qemu:
        try:
            said, _ = qemu.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            qemu.kill()
            said = f"{qemu.communicate()[0]}\nguest stopped: not done after {timeout_s:.0f} s"
        except BaseException:
            qemu.kill()
            raise
    text = console.read_text(errors="replace") if console.exists() else ""
    exit_file = share / "exit"
    code = int(exit_file.read_text()) if exit_file.exists() else None
    return GuestRun(code, f"{text}\n{said}\nhost command: {shlex.join(command)}", share)


def _kvm() -> bool:
    return bool({"vmx", "svm"} & _cpu_flags()) and os.access("/dev/kvm", os.R_OK | os.W_OK)


def _cpu_flags() -> set[str]:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("flags"):
            return set(line.split())
    return set()
