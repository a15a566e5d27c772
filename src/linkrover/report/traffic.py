"""Which topic fills the air, which connection retransmits, and why one end receives more than it sends."""

from __future__ import annotations

import re
from collections.abc import Sequence

from linkrover.analysis.connections import ConnectionFigures
from linkrover.analysis.summary import RunSummary
from linkrover.analysis.topics import TopicFigures

from .section import Section
from .table import Column, Table, without_unknown

MOST_LISTED = 15
SMALL_MB = 0.001
MORE_RECEIVED = 1.05
WORTH_NAMING = 0.05  # of the heaviest topic


def traffic_section(summary: RunSummary) -> Section:
    """Topics, connections and the balance of both directions, as far as they were recorded."""
    section = Section("Traffic")
    topics = [t for t in summary.topics if t.on_host is not True and t.rate_mbps]
    connections = shown_connections(summary.connections)
    section.words += topic_words(topics) + connection_words(connections)
    if topics or connections or _speaks_ros1(summary):
        section.words += balance_words(summary, topics)
    if topics:
        section.tables.append(topic_table(summary, topics))
    if connections:
        section.tables.append(connection_table(summary, connections))
    return section


def shown_connections(connections: Sequence[ConnectionFigures]) -> list[ConnectionFigures]:
    """Those on the air that moved something; of one recorded at both ends only the sides that sent."""
    both = {(c.local, c.remote) for c in connections}

    def kept(c: ConnectionFigures) -> bool:
        sent, received = c.sent_mb or 0.0, c.received_mb or 0.0
        if c.on_host or sent + received <= 0:
            return False
        return bool(c.retransmits) or sent >= SMALL_MB or (c.remote, c.local) not in both

    return [c for c in connections if kept(c)]


def counted_once(topics: Sequence[TopicFigures]) -> list[TopicFigures]:
    """Without the receiving end's count of what the sending end counted too."""
    sent = {(t.topic, t.local, t.remote) for t in topics if t.direction == "out" and t.local}
    return [t for t in topics if t.direction == "out" or (t.topic, t.remote, t.local) not in sent]


def topic_table(summary: RunSummary, topics: Sequence[TopicFigures]) -> Table:
    """One topic, node and peer a row, the busiest first."""
    columns = (
        Column("topic"),
        Column("at"),
        Column("node", spare=True),
        Column("peer"),
        Column("rate (Mbit/s)", 3, short="Mbit/s"),
        Column("share (%)", 1, short="share %"),
        Column("messages/s", 1, short="msg/s", spare=True),
        Column("a message (kB)", 1, short="kB each", spare=True),
        Column("retransmits", 0, short="retr."),
        Column("RTT 95th percentile (ms)", 1, short="rtt p95 ms", spare=True),
    )
    table = Table("Topics on the air", columns, name=f"topics-{summary.run}")
    once = counted_once(topics)
    for t in once[:MOST_LISTED]:
        way = {"out": "sends", "in": "receives"}.get(t.direction, t.direction)
        row: list[str | float | int | None] = [t.topic, f"{t.end} {way}", short_name(t.node), short_name(t.peer)]
        row += [t.rate_mbps, t.share_percent, t.messages_per_s, t.message_kb]
        table.rows.append([*row, t.retransmits, t.rtt_p95_ms])
    _left_out(table, len(once), "flows")
    inside = sum(t.on_host is True for t in summary.topics)
    if inside:
        table.notes.append(f"{inside} flows between nodes of one machine never reach the air and are left out.")
    table.notes.append(
        "From the nodes' own bus statistics; of what both ends counted the sender's row stands. Share: of all that its "
        "interface carried in that direction meanwhile. Retransmits and RTT: of its TCP connection, joined by "
        "addresses, at the sending end. A * stands for the number of an anonymous node."
    )
    return without_unknown(table)


def short_name(node: str) -> str:
    """A node's name without the process number and time that anonymous ones carry (rospy, roscpp)."""
    return re.sub(r"(_\d+)?_\d{13,19}$", "*", node)


def connection_table(summary: RunSummary, connections: Sequence[ConnectionFigures]) -> Table:
    """One connection a row, those that retransmit most first."""
    carried = topics_by_place(summary.topics)
    columns = (
        Column("from"),
        Column("to"),
        Column("process", spare=True),
        Column("topic"),
        Column("sent (MB)", 3, short="sent MB"),
        Column("retransmits", 0, short="retr."),
        Column("sent again (%)", 2, short="again %"),
        Column("RTT median (ms)", 1, short="rtt ms", spare=True),
        Column("RTT 95th percentile (ms)", 1, short="p95 ms"),
        Column("congestion window (segments)", 0, short="cwnd", spare=True),
        Column("limited by the receiver (%)", 0, short="rcv lim %", spare=True),
        Column("by the send buffer (%)", 0, short="buf lim %", spare=True),
    )
    table = Table("TCP connections on the air", columns, name=f"connections-{summary.run}")
    for c in connections[:MOST_LISTED]:
        row: list[str | float | int | None] = [f"{c.end} {c.local}", c.remote, c.process]
        row += [carried.get((c.local, c.remote)), c.sent_mb, c.retransmits, c.retransmitted_percent]
        row += [c.rtt_median_ms, c.rtt_p95_ms, c.congestion_window_median]
        table.rows.append([*row, c.receiver_limited_percent, c.buffer_limited_percent])
    _left_out(table, len(connections), "connections")
    inside = sum(c.on_host is True for c in summary.connections)
    if inside:
        table.notes.append(f"{inside} connections within one machine are left out.")
    table.notes.append(
        "As the kernel of the end named counts. RTT is its smoothed value at the samples before which something was "
        "sent; it holds the wait in the queue before the radio. Limited: share of the time in which there was "
        "something to send; where neither limit is large, the network was the limit."
    )
    return without_unknown(table)


def topics_by_place(topics: Sequence[TopicFigures]) -> dict[tuple[str, str], str]:
    """Which topic a connection carries, by the addresses in the direction of its data."""
    found: dict[tuple[str, str], str] = {}
    for t in topics:
        if t.local and t.remote:
            found[(t.local, t.remote) if t.direction == "out" else (t.remote, t.local)] = t.topic
    return found


def _left_out(table: Table, count: int, what: str) -> None:
    if count > MOST_LISTED:
        table.notes.append(f"{count - MOST_LISTED} smaller {what} are not listed; --format json has all.")


def topic_words(topics: Sequence[TopicFigures]) -> list[str]:
    """Which topic fills the air."""
    top = max(topics, key=lambda t: t.rate_mbps or 0.0, default=None)
    if top is None or not top.rate_mbps:
        return []
    way = f"sent by the {top.end} to {short_name(top.peer)}" if top.direction == "out" else f"received by the {top.end}"
    share = f", {top.share_percent:.0f} % of what its interface carried that way" if top.share_percent else ""
    return [f"Most of the air goes to {top.topic}, {way}: {top.rate_mbps:.2f} Mbit/s{share}."]


def connection_words(connections: Sequence[ConnectionFigures]) -> list[str]:
    """Which connection retransmits."""
    counted = [c for c in connections if c.retransmits is not None]
    worst = max(counted, key=lambda c: c.retransmits or 0.0, default=None)
    if worst is None:
        return []
    if not worst.retransmits:
        return ["No TCP connection seen on the air sent anything again."]
    who = f" ({worst.process})" if worst.process else ""
    share = worst.retransmitted_percent
    part = f", {share:.2f} % of its bytes" if share is not None else ""
    everything = sum(c.retransmits or 0.0 for c in counted)
    of = f" of {everything:.0f} in all" if everything > worst.retransmits else ""
    which = f"{worst.end} {worst.local} to {worst.remote}{who}"
    return [f"Most retransmits: {which}: {worst.retransmits:.0f} segments{of}{part}."]


def balance_words(summary: RunSummary, topics: Sequence[TopicFigures]) -> list[str]:
    """Where received data exceed sent data, and why."""
    words = []
    ros = bool(topics) or _speaks_ros1(summary)
    roscore = next((role for role, b in summary.balance.items() if b.runs_roscore), None)
    for role, b in summary.balance.items():
        exceeds = b.received_to_sent is not None and b.received_to_sent > MORE_RECEIVED
        if not exceeds and role != roscore:
            continue
        side = ", the roscore's side" if role == roscore else ""
        verdict = "received data exceed sent data" if exceeds else "received data do not exceed sent data"
        figures = f"{b.received_mbps:.2f} Mbit/s received, {b.sent_mbps:.2f} sent"
        cause = _heavy(role, topics, exceeds=exceeds) if ros else ""
        words.append(f"At the {role}{side}, {verdict} ({b.iface}: {figures}){cause}.")
    if words:
        words.append(_ROS_CAUSE if ros else _PLAIN_CAUSE)
    robot, station = summary.balance.get("robot"), summary.balance.get("station")
    if words and robot is not None and station is not None:
        words.append(
            f"The robot sent {robot.sent_mbps:.2f} Mbit/s, the station received {station.received_mbps:.2f}; the "
            f"station sent {station.sent_mbps:.2f}, the robot received {robot.received_mbps:.2f}. Less received than "
            "sent was lost or dropped on the way; more came from other senders, or the two ends' readings cover "
            "different stretches of time."
        )
    return words


def _speaks_ros1(summary: RunSummary) -> bool:
    named = any((setup.middleware or "").startswith("ros1") for setup in summary.setup.values())
    return named or any(b.runs_roscore is not None for b in summary.balance.values())


_PLAIN_CAUSE = "The side that takes in the bulk of the data sends back little but acknowledgements."
_ROS_CAUSE = (
    "Data go straight from publisher to subscriber; the roscore only tells them of each other, so where it runs does "
    "not decide this: the side that subscribes to the heavy topics receives more, and sends back little but "
    "acknowledgements."
)


def _heavy(role: str, topics: Sequence[TopicFigures], *, exceeds: bool) -> str:
    """The topics that make the difference at one end."""
    wanted = "in" if exceeds else "out"
    rates: dict[str, float] = {}
    for t in topics:
        if t.end == role and t.direction == wanted and t.rate_mbps:
            rates[t.topic] = rates.get(t.topic, 0.0) + t.rate_mbps
    if not rates:
        return ""
    most = max(rates.values())
    named = [f"{topic} at {rate:.2f} Mbit/s" for topic, rate in rates.items() if rate > WORTH_NAMING * most]
    return f": it {'subscribes to' if exceeds else 'publishes'} {', '.join(named[:3])}"
