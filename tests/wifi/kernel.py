"""The guest's kernel: Debian's own package, fetched once, unpacked (never installed), reduced to what Wi-Fi needs."""

from __future__ import annotations

import fcntl
import lzma
import os
import re
import shutil
import struct
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
CACHE = PROJECT / ".cache" / "guest"
META_PACKAGE = "linux-image-amd64"
MODULES = (
    "virtio_pci",
    "9pnet_virtio",
    "9p",
    "overlay",
    "ccm",
    "ctr",
    "cmac",
    "cfg80211",
    "mac80211",
    "mac80211_hwsim",
    "veth",
    "dummy",
    "inet_diag",
    "tcp_diag",
    "tcp_bbr",
    "sch_netem",
)
LATER = ("mac80211_hwsim",)  # loaded by the tests' init, with parameters


class GuestUnavailableError(Exception):
    """This machine cannot have the guest; the message is the reason a test is skipped with."""


@dataclass(frozen=True)
class GuestKernel:
    """An uncompressed kernel ELF (qemu boots it 4.5 s faster than a bzImage) and its initramfs."""

    version: str
    vmlinux: Path
    initramfs: Path


def prepare() -> GuestKernel:
    """The guest's kernel from the cache, made on first use.

    Raises:
        GuestUnavailableError: a program or the package cannot be had here.
    """
    for program, package in {
        "qemu-system-x86_64": "qemu-system-x86",
        "busybox": "busybox-static",
        "hostapd": "hostapd",
        "wpa_supplicant": "wpasupplicant",
        "iw": "iw",
        "modinfo": "kmod",
        "cpio": "cpio",
    }.items():
        if shutil.which(program, path="/usr/sbin:/usr/bin:/sbin:/bin") is None:
            raise GuestUnavailableError(f"{program} is not installed (Debian package {package})")
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # two test runs in one tree must not build the same cache twice
        package = _newest_package()
        home = CACHE / package
        recipe = Path(__file__).read_bytes() + (Path(__file__).parent / "init.sh").read_bytes()
        stamp = home / "made"
        if not stamp.exists() or stamp.read_bytes() != recipe:
            _make(package, home)
            stamp.write_bytes(recipe)
    return GuestKernel(package, home / "vmlinux", home / "initramfs.cpio")


def _newest_package() -> str:
    """The package the meta package points to now; without package lists, the newest one in the cache."""
    if shutil.which("apt-cache"):
        for refresh in (False, True):
            if refresh:
                subprocess.run(["apt-get", "update", "-qq"], check=False, capture_output=True, timeout=120)
            shown = subprocess.run(["apt-cache", "depends", META_PACKAGE], check=False, capture_output=True, text=True)
            found = re.search(r"Depends: (linux-image-\S+)", shown.stdout)
            if found:
                return found.group(1)
    cached = sorted(p.parent.name for p in CACHE.glob("linux-image-*/made"))
    if cached:
        return cached[-1]
    raise GuestUnavailableError(f"no package source offers {META_PACKAGE}, and none is cached in .cache/guest")


def _make(package: str, home: Path) -> None:
    with tempfile.TemporaryDirectory(dir=CACHE) as scratch_name:
        scratch = Path(scratch_name)
        got = subprocess.run(["apt-get", "download", package], check=False, cwd=scratch, capture_output=True, text=True)
        archives = list(scratch.glob("*.deb"))
        if not archives:
            raise GuestUnavailableError(f"apt-get download {package} failed: {got.stderr.strip()[-300:]}")
        tree = scratch / "tree"
        subprocess.run(["dpkg", "-x", archives[0], tree], check=True)
        for old in CACHE.glob("linux-image-*"):
            shutil.rmtree(old)  # an older kernel's, or what a changed recipe makes anew
        release = package.removeprefix("linux-image-")
        home.mkdir(exist_ok=True)
        (home / "vmlinux").write_bytes(_uncompressed((tree / "boot" / f"vmlinuz-{release}").read_bytes()))
        _make_initramfs(tree / "lib" / "modules" / release, scratch / "root", home / "initramfs.cpio")


def _uncompressed(image: bytes) -> bytes:
    """The ELF inside a bzImage (Documentation/x86/boot.rst: setup_sects, payload_offset, payload_length)."""
    sectors = image[0x1F1] or 4
    offset, length = struct.unpack_from("<II", image, 0x248)
    payload = image[(sectors + 1) * 512 + offset :][:length]
    if payload[:6] == b"\xfd7zXZ\x00":
        return lzma.LZMADecompressor().decompress(payload)
    if payload[:4] == b"(\xb5/\xfd":
        return subprocess.run(["zstd", "-dc"], input=payload, check=False, capture_output=True).stdout
    raise GuestUnavailableError(f"the kernel image is compressed in a way not known here: {payload[:6].hex()}")


def _make_initramfs(modules: Path, root: Path, out: Path) -> None:
    paths = {p.name.removesuffix(".ko").replace("-", "_"): p for p in modules.rglob("*.ko")}
    order: list[str] = []

    def add(name: str) -> None:
        name = name.replace("-", "_")
        if name in order or name not in paths:
            return  # built into the kernel
        shown = subprocess.run(["modinfo", "-F", "depends", paths[name]], check=True, capture_output=True, text=True)
        for dependency in filter(None, shown.stdout.strip().split(",")):
            add(dependency)
        order.append(name)

    for name in MODULES:
        add(name)
    for folder in ("bin", "lib/firmware", "modules", "proc", "sys", "dev", "lower", "upper", "root"):
        (root / folder).mkdir(parents=True)
    shutil.copy(shutil.which("busybox") or "/bin/busybox", root / "bin" / "busybox")
    for name in order:
        shutil.copy(paths[name], root / "modules" / f"{name}.ko")
    (root / "modules" / "order").write_text("".join(f"{n}\n" for n in order if n not in LATER))
    for name in ("regulatory.db", "regulatory.db.p7s"):
        source = Path("/lib/firmware") / name
        if not source.exists():
            raise GuestUnavailableError("no regulatory database (Debian package wireless-regdb)")
        shutil.copy(source.resolve(), root / "lib" / "firmware" / name)
    shutil.copy(Path(__file__).parent / "init.sh", root / "init")
    (root / "init").chmod(0o755)
    names = "\n".join(os.path.relpath(p, root) for p in sorted(root.rglob("*")))
    with out.open("wb") as file:
        subprocess.run(["cpio", "-o", "-H", "newc", "--quiet"], cwd=root, input=names.encode(), stdout=file, check=True)
