"""Checks of what this user may do. Pure: facts in, findings out."""

from __future__ import annotations

from .finding import Finding, Status, judged, ok

CAP_NET_ADMIN = 12


def kernel_stamps(given: bool) -> Finding:
    """Kernel timestamps of packets."""
    why = "without them round trips hold the time to wake a process, 50 to 200 us"
    mend = "use a kernel with network timestamping (any of the last ten years); in a sandbox, allow SO_TIMESTAMPING"
    return judged("kernel time stamps", Status.OK if given else Status.WARN, "given" if given else "refused", why, mend)


def scanning(capabilities: int) -> Finding:
    """Whether this user may scan."""
    why = "reading the radio needs no privilege; a scan for neighbours does (it is off unless asked for)"
    if capabilities >> CAP_NET_ADMIN & 1:
        return ok("permission to scan", "yes (CAP_NET_ADMIN)", why)
    return ok("permission to scan", "no; for scans run the agent with sudo", why)


def tunnel(exists: bool, usable: bool) -> Finding:
    """/dev/net/tun, which the demo and the emulator need."""
    why = "linkrover demo and emulate pass packets through it; measuring a real link does not need it"
    if not exists:
        return judged("/dev/net/tun", Status.WARN, "not there", why, "sudo modprobe tun")
    mend = "sudo chmod 0666 /dev/net/tun"
    return judged(
        "/dev/net/tun", Status.OK if usable else Status.WARN, "usable" if usable else "not permitted", why, mend
    )


def namespaces(root: bool, most: str | None, clone: str | None, apparmor: str | None) -> Finding:
    """Whether network namespaces may be made. The arguments are the sysctls, None = not in this kernel."""
    name, why = "network namespaces", "linkrover demo puts robot and station into two of them; measuring needs none"
    if root:
        return ok(name, "yes, as root", why)
    if most == "0":
        return judged(
            name, Status.WARN, "user namespaces are off", why, "sudo sysctl -w user.max_user_namespaces=10000"
        )
    if clone == "0":
        mend = "sudo sysctl -w kernel.unprivileged_userns_clone=1"
        return judged(name, Status.WARN, "not for ordinary users", why, mend)
    if apparmor == "1":
        mend = "sudo sysctl -w kernel.apparmor_restrict_unprivileged_userns=0, or run the demo with sudo"
        return judged(name, Status.WARN, "restricted by AppArmor", why, mend)
    return ok(name, "yes, in a user namespace", why)


def radio_access(problem: str | None) -> Finding:
    """Whether the radio can be read. problem: why not."""
    why = "signal, rates and retries come from nl80211"
    if problem is None:
        return ok("reading the radio", "nl80211 answers", why)
    mend = "load the Wi-Fi driver; in a container, share the host's network (docker run --network host)"
    return Finding(check="reading the radio", status=Status.UNKNOWN, value=problem, why=why, mend=mend)
