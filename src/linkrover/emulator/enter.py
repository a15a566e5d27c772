"""Start a program in a namespace: `python enter.py NETNS_FD -- COMMAND`. Run as a file, standard library only.

Its /sys shows the namespace's devices, and it gets SIGTERM when the emulator dies, so that a killed run leaves no
process behind.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

CLONE_NEWNS, CLONE_NEWNET = 0x00020000, 0x40000000
MS_REC, MS_PRIVATE = 0x4000, 0x40000
MS_BIND = 0x1000
PR_SET_PDEATHSIG = 1
HOSTS_VARIABLE = "LINKROVER_HOSTS_FILE"


def main() -> None:
    """Enter, then become COMMAND; exit status 127 where it does not exist, 126 where it cannot be run."""
    netns_fd, separator, *command = sys.argv[1:]
    if separator != "--" or not command:
        sys.exit("usage: enter.py NETNS_FD -- COMMAND")
    libc = ctypes.CDLL(None, use_errno=True)
    parent = os.getppid()
    libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        sys.exit(1)  # the emulator died before the signal was armed
    if int(netns_fd) >= 0:
        if libc.setns(int(netns_fd), CLONE_NEWNET) != 0:
            sys.exit(f"cannot enter the namespace: {os.strerror(ctypes.get_errno())}")
        os.close(int(netns_fd))
        if libc.unshare(CLONE_NEWNS) == 0:
            libc.mount(b"none", b"/", None, MS_REC | MS_PRIVATE, None)
            # without this (some containers forbid it) /sys keeps showing the outer devices; /proc/net is right anyway
            libc.mount(b"sysfs", b"/sys", b"sysfs", 0, None)
            hosts = os.environ.get(HOSTS_VARIABLE)
            if hosts:
                libc.mount(os.fsencode(hosts), b"/etc/hosts", None, MS_BIND, None)
    # a shell's background job ignores SIGINT; the program must be stoppable all the same
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        os.execvp(command[0], command)  # noqa: S606 - to become the program is the purpose
    except FileNotFoundError:
        print(f"{command[0]}: no such program", file=sys.stderr)
        sys.exit(127)
    except OSError as error:
        print(f"{command[0]}: {error.strerror}", file=sys.stderr)
        sys.exit(126)


if __name__ == "__main__":
    main()
