"""Plain log lines, for a log file or a service manager."""

from __future__ import annotations

from linkrover.records import Continuity, LinkEvent, Record, SelfAccount

from .state import InterfaceState, LiveState, PeerState


def clean(text: str) -> str:
    """Text from outside made safe for a terminal: an SSID may hold escape sequences."""
    return text if text.isprintable() else "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


def rate(bits_per_s: float | None) -> str:
    """A rate for a reader: 3.2 Mbit/s."""
    if bits_per_s is None:
        return "?"
    for unit, size in (("Gbit/s", 1e9), ("Mbit/s", 1e6), ("kbit/s", 1e3)):
        if bits_per_s >= size * 0.9995:
            return f"{bits_per_s / size:{'.3g' if bits_per_s < size * 999.5 else '.0f'}} {unit}"
    return f"{bits_per_s:.0f} bit/s"


def duration(nanoseconds: float | None) -> str:
    """A short time for a reader: 3.21 ms."""
    if nanoseconds is None:
        return "?"
    for unit, size in (("s", 1e9), ("ms", 1e6), ("us", 1e3)):
        if nanoseconds >= size:
            return (
                f"{nanoseconds / size:.3g} {unit}" if nanoseconds < size * 999.5 else f"{nanoseconds / size:.0f} {unit}"
            )
    return f"{nanoseconds:.0f} ns"


def interface_line(state: InterfaceState) -> str:
    """One interface in one line."""
    parts = [state.name]
    traffic = state.utilization
    if traffic is not None:
        if traffic.continuity is Continuity.GONE:
            parts.append("GONE")
        else:
            parts.append(f"rx {rate(traffic.rx_rate_bps)} tx {rate(traffic.tx_rate_bps)}")
    link = state.wireless
    if link is not None:
        if link.rssi_dbm is not None:
            parts.append(f"RSSI {link.rssi_dbm:.0f} dBm")
        elif link.connected is False:
            parts.append("not connected")
    if state.error_totals:
        parts.append(", ".join(f"{field} +{count}" for field, count in state.error_totals.items()))
    return "  ".join(parts)


def peer_line(state: PeerState) -> str:
    """One peer in one line."""
    loss = state.loss()
    text = f"peer {state.name}  RTT {duration(state.median_rtt_ns())}"
    if loss is not None:
        text += f"  loss {loss * 100:.1f} % (last minute)"
    out_ns = state.out_for_ns()
    if out_ns is not None:
        text += f"  NO ANSWER for {out_ns / 1e9:.1f} s"
    elif state.outages:
        text += f"  outages {state.outages} ({state.out_total_ns / 1e9:.1f} s)"
    return text


def account_line(account: SelfAccount) -> str:
    """What measuring costs, in one line."""
    share = account.cpu_ns / account.interval_ns * 100 if account.interval_ns else 0.0
    text = f"self: {share:.2f} % CPU, {account.rss_bytes / 1e6:.0f} MB"
    if account.missed_slots:
        text += f", {account.missed_slots} slots missed"
    if account.records_written:
        text += f", {account.records_written} records written ({account.bytes_written / 1e6:.1f} MB)"
    if account.records_lost:
        text += f", {account.records_lost} records LOST"
    return text


def summary_lines(state: LiveState) -> list[str]:
    """All there is to say now."""
    lines = [interface_line(interface) for interface in state.interfaces.values()]
    lines += [peer_line(peer) for peer in state.peers.values()]
    if state.account is not None:
        lines.append(account_line(state.account))
    return lines


def event_line(record: Record) -> str | None:
    """A line for an event, None for any other record."""
    if not isinstance(record, LinkEvent):
        return None
    return f"{record.iface or '-'}: {record.kind.value}" + (f": {record.detail}" if record.detail else "")
