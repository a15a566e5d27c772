"""Checks of interfaces, kernel settings and routes. Pure: facts in, findings out."""

from __future__ import annotations

from .finding import Finding, Status, judged, ok, unknown

RMEM_LEAST, WMEM_LEAST = 2_097_152, 1_048_576
FRAGMENT_SECONDS_MOST = 5
FRAGMENT_BYTES_LEAST = 67_108_864
_FAIR = {"fq_codel", "cake", "fq", "fq_pie", "codel", "pie", "sfq"}
_ORDERED = {"pfifo_fast", "pfifo", "bfifo", "pfifo_head_drop"}


def mtu(value: int | None, iface: str) -> Finding:
    """Largest packet of the interface."""
    why = "below 1500 every large message is cut into more pieces; above it an access point may drop silently"
    if value is None:
        return unknown("MTU", f"{iface}: not there", why)
    status = Status.OK if value == 1_500 else Status.WARN if value >= 1_280 else Status.FAIL
    return judged("MTU", status, f"{iface}: {value} octets", why, f"sudo ip link set {iface} mtu 1500")


def _sysctl(check: str, name: str, value: str | None, good: bool, wanted: str, why: str) -> Finding:
    if value is None:
        return unknown(check, f"{name}: this kernel does not have it", why)
    mend = f"sudo sysctl -w {name}={wanted} (for good: in /etc/sysctl.d/60-robot.conf)"
    return judged(check, Status.OK if good else Status.WARN, f"{name} = {value}", why, mend)


def fragmentation(seconds: str | None, threshold: str | None) -> list[Finding]:
    """How long and how much the kernel keeps of half-received large UDP messages."""
    why = (
        "ROS 2 sends images as UDP in pieces; pieces whose others were lost fill the kernel's memory for 30 s and "
        "every large message after a drop is lost with them"
    )
    return [
        _sysctl(
            "fragmentation", "net.ipv4.ipfrag_time", seconds,
            _number(seconds) is not None and (_number(seconds) or 0) <= FRAGMENT_SECONDS_MOST, "3", why,
        ),
        _sysctl(
            "fragmentation", "net.ipv4.ipfrag_high_thresh", threshold,
            (_number(threshold) or 0) >= FRAGMENT_BYTES_LEAST, "134217728", why,
        ),
    ]  # fmt: skip


def buffers(receive: str | None, send: str | None) -> list[Finding]:
    """Largest socket buffers a program may ask for."""
    why = "an image must fit into a socket's buffer while the receiver is busy; what does not is lost on this machine"
    return [
        _sysctl("buffers", "net.core.rmem_max", receive, (_number(receive) or 0) >= RMEM_LEAST, "8388608", why),
        _sysctl("buffers", "net.core.wmem_max", send, (_number(send) or 0) >= WMEM_LEAST, "8388608", why),
    ]


def qdisc(kinds: list[str], iface: str, *, wireless: bool) -> Finding:
    """Queueing discipline of the interface. kinds: the root one first, then those of its queues."""
    why = (
        "in one long queue a velocity command waits behind a whole camera image (bufferbloat); fair queueing lets it by"
    )
    if not kinds:
        return unknown("queue", f"{iface}: the kernel names no queueing discipline", why)
    inner = kinds[1:] if kinds[0] in ("mq", "mqprio") and len(kinds) > 1 else kinds[:1]
    value = f"{iface}: {kinds[0]}" + (f" of {', '.join(sorted(set(inner)))}" if inner != kinds[:1] else "")
    if all(kind in _FAIR for kind in inner):
        return ok("queue", value, why)
    if kinds == ["noqueue"]:
        note = "mac80211 queues fairly itself" if wireless else "a virtual device: the queue is elsewhere"
        return ok("queue", f"{value} ({note})", why)
    mend = f"sudo tc qdisc replace dev {iface} root fq_codel"
    status = Status.WARN if any(kind in _ORDERED for kind in inner) else Status.UNKNOWN
    return judged("queue", status, value, why, mend)


def subnets(shared: list[tuple[str, str, str]]) -> list[Finding]:
    """Interfaces with addresses in one subnet."""
    why = (
        "with two interfaces in one subnet the kernel answers for either address on both and sends by one: a link that \
looks up may carry nothing, and measuring one measures the other"
    )
    if not shared:
        return [ok("subnets", "no two interfaces share one", why)]
    return [
        judged(
            "subnets", Status.FAIL, f"{first} and {second} are both in {network}", why,
            f"sudo ip link set {second} down, or give them different subnets",
        )
        for network, first, second in shared
    ]  # fmt: skip


def way_to_peer(peer: str, out: str | None, wanted: str | None) -> Finding:
    """Whether packets to the peer leave by the interface under test."""
    why = "packets to the peer that leave by another interface do not test this link"
    if out is None:
        return judged("route to the peer", Status.FAIL, f"no route to {peer}", why, f"ip route get {peer}")
    if wanted is not None and out not in (wanted, "lo"):
        mend = f"sudo ip route replace {peer} dev {wanted} (with `via GATEWAY` where there is one)"
        return judged("route to the peer", Status.FAIL, f"{peer} is reached by {out}, not by {wanted}", why, mend)
    return ok("route to the peer", f"{peer} is reached by {out}", why)


def asymmetry(peer: str, cases: list[tuple[str, str, str]], strict: list[str]) -> Finding:
    """Answers to the peer that leave by another interface than they were asked on.

    cases: (local address, its interface, interface its packets to the peer leave by). strict: interfaces with
    rp_filter=1, which drop what comes in by them then.
    """
    why = (
        "asked on one interface and answering by another, TCP stalls, firewalls drop, and one-way figures mix two links"
    )
    if not cases:
        return ok("asymmetric routes", f"answers to {peer} leave where they were asked", why)
    address, owner, _ = cases[0]
    dropped = sorted({o for _, o, _ in cases} & set(strict))
    value = "; ".join(f"from {a} ({o}) by {x}" for a, o, x in cases)
    if dropped:
        value += f"; {', '.join(dropped)} drops such packets (rp_filter=1)"
    mend = f"sudo ip rule add from {address} lookup 101; sudo ip route add {peer} dev {owner} table 101"
    return judged("asymmetric routes", Status.FAIL if dropped else Status.WARN, value, why, mend)


def multicast(enabled: bool | None, out: str | None, iface: str, *, wireless: bool) -> Finding:
    """Whether multicast discovery uses this interface."""
    why = "ROS 2 finds its peers by multicast" + (
        "; on Wi-Fi that goes unacknowledged at the lowest rate, so that a large graph fills the air: prefer a "
        "discovery server or unicast peers" if wireless else ""
    )  # fmt: skip
    if enabled is None:
        return unknown("multicast", f"{iface}: not there", why)
    if not enabled:
        return judged("multicast", Status.WARN, f"{iface}: switched off", why, f"sudo ip link set {iface} multicast on")
    if out is None:
        return judged(
            "multicast", Status.WARN, "no route for 239.255.0.1", why,
            f"sudo ip route add 239.0.0.0/8 dev {iface}",
        )  # fmt: skip
    if out != iface:
        return judged(
            "multicast", Status.WARN, f"discovery (239.255.0.1) leaves by {out}, not by {iface}", why,
            f"sudo ip route add 239.0.0.0/8 dev {iface}",
        )  # fmt: skip
    return ok("multicast", f"{iface}: on, and discovery (239.255.0.1) leaves by it", why)


def _number(text: str | None) -> int | None:
    try:
        return None if text is None else int(text.split()[0])
    except (ValueError, IndexError):
        return None
