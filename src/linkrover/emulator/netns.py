"""Network namespaces with one TUN device each, made by system calls: no names, no `ip`, nothing left behind.

A namespace lives as long as a file descriptor or a process in it; when the run ends or is killed, the kernel removes
namespace, device and addresses. Root makes them directly; an ordinary user inside a user namespace of its own.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import os
import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from linkrover.emulator.tap import open_tap
from linkrover.errors import LinkRoverError

CLONE_NEWUSER = 0x10000000  # include/uapi/linux/sched.h
CLONE_NEWNET = 0x40000000
CAPABILITIES = {"CAP_SYS_ADMIN": 21, "CAP_NET_ADMIN": 12}  # include/uapi/linux/capability.h

TUNSETIFF = 0x400454CA  # include/uapi/linux/if_tun.h
IFF_TUN, IFF_NO_PI = 0x0001, 0x1000

SIOCGIFFLAGS, SIOCSIFFLAGS = 0x8913, 0x8914  # include/uapi/linux/sockios.h
SIOCSIFADDR, SIOCSIFNETMASK = 0x8916, 0x891C
SIOCSIFMTU = 0x8922
RTM_NEWLINK, IFLA_TXQLEN = 16, 13  # include/uapi/linux/rtnetlink.h, if_link.h
RTM_NEWROUTE, RTA_DST, RTA_OIF = 24, 1, 4
RT_TABLE_MAIN, RTPROT_BOOT, RT_SCOPE_LINK, RTN_UNICAST = 254, 3, 253, 1
NLM_F_REQUEST, NLM_F_ACK, NLM_F_CREATE = 1, 4, 0x400
IFF_UP, IFF_RUNNING = 0x1, 0x40

TUN_PATH = "/dev/net/tun"
MTU = 1500
TX_QUEUE_PACKETS = 4000  # the relay may be held up for 0.2 s at 20,000 packets/s before the kernel drops silently

T = TypeVar("T")
_libc = ctypes.CDLL(None, use_errno=True)


class NotPermittedError(LinkRoverError):
    """This user or machine may not make namespaces or TUN devices; says what is missing and what grants it."""

    def __init__(self, missing: str, grant: str) -> None:
        self.missing = missing
        self.grant = grant
        super().__init__(f"emulating a link with real packets needs {missing}; this grants it: {grant}")


class Host(msgspec.Struct, frozen=True):
    """One emulated host: its namespace, its TUN device and the tap on it, as file descriptors; its IPv4 address."""

    name: str
    address: str
    iface: str
    netns_fd: int
    tun_fd: int
    tap_fd: int

    def close(self) -> None:
        """Give the descriptors back; with its last process the namespace goes too."""
        os.close(self.tap_fd)
        os.close(self.tun_fd)
        os.close(self.netns_fd)


def _unshare(flags: int) -> None:
    if _libc.unshare(flags) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _setns(fd: int) -> None:
    if _libc.setns(fd, CLONE_NEWNET) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _in_thread(work: Callable[[], T]) -> T:
    """Run in a thread of its own, which may change its namespace without moving the rest of the process."""
    result: list[T] = []
    failure: list[BaseException] = []

    def body() -> None:
        try:
            result.append(work())
        except BaseException as error:  # noqa: BLE001 - handed on to the caller below
            failure.append(error)

    thread = threading.Thread(target=body, name="netns")
    thread.start()
    thread.join()
    if failure:
        raise failure[0]
    return result[0]


def in_namespace(netns_fd: int, work: Callable[[], T]) -> T:
    """Do `work` inside a network namespace; sockets it opens stay in there.

    Raises:
        OSError: the namespace cannot be entered; and whatever `work` raises.
    """

    def body() -> T:
        _setns(netns_fd)
        return work()

    return _in_thread(body)


def become_namespace_root() -> bool:
    """Unless this process may make network namespaces already, enter a user namespace that may. Irreversible.

    Returns whether a user namespace was entered. Must run before the process starts a thread.

    Raises:
        NotPermittedError: neither is allowed here.
    """
    check_tun()
    lacking = [name for name, number in CAPABILITIES.items() if not _has_capability(number)]
    if not lacking:
        _try_netns()
        return False
    uid, gid = os.geteuid(), os.getegid()
    if uid == 0:
        raise NotPermittedError(
            f"{' and '.join(lacking)}, which this container's root lacks",
            "docker run --cap-add=SYS_ADMIN --cap-add=NET_ADMIN --device=/dev/net/tun",
        )
    try:
        _unshare(CLONE_NEWUSER)
    except OSError as error:
        raise _no_userns(error) from error
    try:
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"0 {uid} 1")
        Path("/proc/self/gid_map").write_text(f"0 {gid} 1")
        _in_thread(lambda: _unshare(CLONE_NEWNET))
    except OSError as error:
        # Ubuntu from 24.04 lets an unprivileged process make a user namespace, then denies it all capabilities
        raise _no_userns(error) from error
    return True


def why_not() -> str | None:
    """Whether become_namespace_root() and make_host() would work here: None, or what is missing and what grants it.

    Tried in a child process, because entering a user namespace cannot be undone.
    """
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            become_namespace_root()
            make_host("trial", "10.77.0.9").close()
        except BaseException as error:  # noqa: BLE001 - the parent gets it as text
            os.write(writer, str(error).encode()[:4000] or b"not permitted")
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        text = pipe.read().decode(errors="replace")
    os.waitpid(child, 0)
    return text or None


def _has_capability(number: int) -> bool:
    status = Path("/proc/self/status").read_text()
    return bool(int(status.partition("CapEff:")[2].split()[0], 16) >> number & 1)


def _try_netns() -> None:
    try:
        _in_thread(lambda: _unshare(CLONE_NEWNET))
    except OSError as error:
        raise _no_netns(error) from error


def check_tun(path: str = TUN_PATH) -> None:
    """Raise NotPermittedError unless the TUN device can be opened."""
    try:
        os.close(os.open(path, os.O_RDWR | os.O_CLOEXEC))
    except FileNotFoundError as error:
        raise NotPermittedError(
            f"the device {path}, which does not exist",
            "sudo modprobe tun (in a container: start it with --device=/dev/net/tun)",
        ) from error
    except PermissionError as error:
        raise NotPermittedError(
            f"permission to open {path} for reading and writing", f"sudo chmod 0666 {path} (or run this as root)"
        ) from error
    except OSError as error:
        raise NotPermittedError(
            f"a working {path} ({error.strerror})", "sudo modprobe tun (the kernel needs CONFIG_TUN)"
        ) from error


def _no_userns(error: OSError) -> NotPermittedError:
    def sysctl(name: str) -> str | None:
        try:
            return (Path("/proc/sys") / name.replace(".", "/")).read_text().strip()
        except OSError:
            return None

    for name, denies, allows in (
        ("kernel.apparmor_restrict_unprivileged_userns", "1", "0"),
        ("kernel.unprivileged_userns_clone", "0", "1"),
        ("user.max_user_namespaces", "0", "10000"),
        ("user.max_net_namespaces", "0", "10000"),
    ):
        if sysctl(name) == denies:
            return NotPermittedError(
                f"user namespaces for ordinary users, which {name}={denies} forbids",
                f"sudo sysctl -w {name}={allows} (or run this as root)",
            )
    if error.errno in (errno.EPERM, errno.EACCES):
        return NotPermittedError(
            "user namespaces for ordinary users, which this system or container forbids",
            "sudo linkrover demo (in a container: docker run --privileged ...)",
        )
    return NotPermittedError(
        f"user namespaces ({error.strerror})", "sudo linkrover demo (a kernel with CONFIG_USER_NS)"
    )


def _no_netns(error: OSError) -> NotPermittedError:
    if error.errno == errno.ENOSPC:
        return NotPermittedError(
            "one more network namespace than user.max_net_namespaces allows",
            "sudo sysctl -w user.max_net_namespaces=10000",
        )
    return NotPermittedError(f"network namespaces ({error.strerror})", "a kernel with CONFIG_NET_NS")


def make_host(name: str, address: str, iface: str = "wlan0", prefix: int = 24) -> Host:
    """A new namespace with loopback and one TUN device `iface` that has `address`/`prefix`, all of it up.

    Raises:
        NotPermittedError: the kernel refused the namespace or the device.
    """

    def body() -> Host:
        try:
            _unshare(CLONE_NEWNET)
        except OSError as error:
            raise _no_netns(error) from error
        netns_fd = os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)
        tun_fd = -1
        try:
            tun_fd = os.open(TUN_PATH, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            fcntl.ioctl(tun_fd, TUNSETIFF, struct.pack("16sH22x", iface.encode(), IFF_TUN | IFF_NO_PI))
            _quiet_ipv6()
            _configure(iface, address, prefix)
            tap_fd = open_tap(iface)
        except OSError as error:
            if tun_fd >= 0:
                os.close(tun_fd)
            os.close(netns_fd)
            raise NotPermittedError(
                f"a TUN device in a network namespace ({error.strerror})",
                "sudo linkrover demo (in a container: --cap-add=NET_ADMIN --device=/dev/net/tun)",
            ) from error
        return Host(name, address, iface, netns_fd, tun_fd, tap_fd)

    return _in_thread(body)


def _quiet_ipv6() -> None:
    # router solicitations of the kernel's own would share the air; without IPv6 or a writable sysctl they are counted
    with contextlib.suppress(OSError):
        for scope in ("all", "default"):
            Path(f"/proc/sys/net/ipv6/conf/{scope}/disable_ipv6").write_text("1")


def _set_queue(iface: str, packets: int) -> None:
    """The device's transmit queue; the ioctl for it would ask for a capability outside the namespace."""
    link = struct.pack("=BxHiII", socket.AF_UNSPEC, 0, socket.if_nametoindex(iface), 0, 0)
    _netlink(RTM_NEWLINK, NLM_F_REQUEST | NLM_F_ACK, link + struct.pack("=HHI", 8, IFLA_TXQLEN, packets))


def _route_multicast(iface: str) -> None:
    """224.0.0.0/4 leads over the device too, as discovery of ROS 2 wants it."""
    route = struct.pack(
        "=BBBBBBBBI", socket.AF_INET, 4, 0, 0, RT_TABLE_MAIN, RTPROT_BOOT, RT_SCOPE_LINK, RTN_UNICAST, 0
    )
    destination = struct.pack("=HH4s", 8, RTA_DST, socket.inet_aton("224.0.0.0"))
    device = struct.pack("=HHi", 8, RTA_OIF, socket.if_nametoindex(iface))
    _netlink(RTM_NEWROUTE, NLM_F_REQUEST | NLM_F_ACK | NLM_F_CREATE, route + destination + device)


def _netlink(kind: int, flags: int, body: bytes) -> None:
    """One route netlink request; raises OSError with the kernel's answer."""
    header = struct.pack("=IHHII", 16 + len(body), kind, flags, 1, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as handle:
        handle.send(header + body)
        (code,) = struct.unpack_from("=i", handle.recv(4096), 16)
    if code != 0:
        raise OSError(-code, os.strerror(-code))


def _configure(iface: str, address: str, prefix: int) -> None:
    def request(name: str, payload: bytes) -> bytes:
        return struct.pack("16s24s", name.encode(), payload)

    def inet(text: str) -> bytes:
        return struct.pack("=HH4s8x", socket.AF_INET, 0, socket.inet_aton(text))

    mask = socket.inet_ntoa(struct.pack("!I", (0xFFFFFFFF << (32 - prefix)) & 0xFFFFFFFF))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as handle:

        def up(name: str) -> None:
            answer: Any = fcntl.ioctl(handle, SIOCGIFFLAGS, request(name, b""))
            (flags,) = struct.unpack_from("=H", answer, 16)
            fcntl.ioctl(handle, SIOCSIFFLAGS, request(name, struct.pack("=H", flags | IFF_UP | IFF_RUNNING)))

        _set_queue(iface, TX_QUEUE_PACKETS)
        up("lo")
        fcntl.ioctl(handle, SIOCSIFMTU, request(iface, struct.pack("=i", MTU)))
        fcntl.ioctl(handle, SIOCSIFADDR, request(iface, inet(address)))
        fcntl.ioctl(handle, SIOCSIFNETMASK, request(iface, inet(mask)))
        up(iface)
        _route_multicast(iface)
