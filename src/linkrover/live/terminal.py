"""The live view of one end on a terminal."""

from __future__ import annotations

import contextlib
import io
import os
import time

from rich.console import Console
from rich.table import Table
from rich.text import Text

from linkrover.records import Continuity, Manifest, ProbeState, Record

from .lines import account_line, clean, duration, event_line, rate
from .output import Output
from .spark import spark
from .state import InterfaceState, LiveState, PeerState

_HOME = "\x1b[H"
_CLEAR_LINE = "\x1b[K"
_CLEAR_BELOW = "\x1b[J"
_ALTERNATE, _MAIN = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"
_HISTORY_MOST, _HISTORY_LEAST = 30, 4


class TerminalView:
    """A sink that draws; draw() is a job of the agent's loop, the writing is the output's own thread's.

    It uses the terminal's alternate screen, so that what was there before is there again afterwards.
    """

    def __init__(self, output: Output, fd: int, manifest: Manifest, *, recording: str | None = None) -> None:
        self.state = LiveState()
        self._output = output
        self._fd = fd
        self._manifest = manifest
        self._recording = recording
        self._colour = "NO_COLOR" not in os.environ
        self._output.write(_ALTERNATE)

    def take(self, record: Record) -> None:
        """One record."""
        self.state.take(record)

    def draw(self) -> tuple[()]:
        """Draw one frame; an earlier one that was not written yet is dropped."""
        width, height = self._size()
        lines = self.render(width).splitlines()[: max(1, height - 1)]
        frame = _HOME + "".join(f"{line}{_CLEAR_LINE}\r\n" for line in lines) + _CLEAR_BELOW
        self._output.write(frame, frame=True)
        return ()

    def close(self) -> None:
        """Give the terminal back."""
        self._output.write(_MAIN)

    def render(self, width: int) -> str:
        """The whole view as text with colours."""
        buffer = io.StringIO()
        console = Console(
            file=buffer,
            width=width,
            force_terminal=True,
            color_system="standard" if self._colour else None,
            legacy_windows=False,
            highlight=False,
            markup=False,
            emoji=False,
        )
        console.print(self._head())
        if self.state.interfaces:
            console.print(self._interfaces(width))
            console.print(self._errors())
        if self.state.peers:
            console.print(self._peers(width))
        self._foot(console)
        return buffer.getvalue()

    def _head(self) -> Text:
        manifest = self._manifest
        ran_s = (time.monotonic_ns() - self.state.started_ns) // 1_000_000_000
        text = Text(f"LinkRover agent, {manifest.role.value} ", style="bold")
        text.append(f"on {manifest.host}", style="not bold")
        text.append(f"   {ran_s // 3600}:{ran_s // 60 % 60:02}:{ran_s % 60:02}", style="not bold")
        if self._recording:
            text.append(f"   recording to {self._recording} (process {os.getpid()})", style="not bold")
        text.append("   Ctrl-C ends", style="dim")
        return text

    def _interfaces(self, width: int) -> Table:
        history = _history_width(width - 70, 3)
        table = _table("interface", "receive", "", "send", "", "RSSI", "", "link")
        for state in self.state.interfaces.values():
            traffic, link = state.utilization, state.wireless
            gone = traffic is not None and traffic.continuity is Continuity.GONE
            table.add_row(
                Text(state.name, style="bold red" if gone else "bold"),
                Text("gone", style="red") if gone else (rate(traffic.rx_rate_bps) if traffic else "?"),
                spark(state.rx_history, history, least=0.0),
                "" if gone else (rate(traffic.tx_rate_bps) if traffic else "?"),
                spark(state.tx_history, history, least=0.0),
                "-" if link is None else (f"{link.rssi_dbm:.0f} dBm" if link.rssi_dbm is not None else "?"),
                spark(state.rssi_history, history),
                _link_words(state),
            )
        return table

    def _errors(self) -> Text:
        """What has been added to the error counters; TCP's and UDP's are the whole machine's."""
        totals: dict[str, dict[str, int]] = {}
        for state in self.state.interfaces.values():
            for field, count in state.error_totals.items():
                owner = "machine" if field.startswith(("tcp_", "udp_")) else state.name
                totals.setdefault(owner, {})[field] = count
        if not totals:
            return Text("errors since the start: none", style="dim")
        parts = [
            f"{owner}: " + ", ".join(f"{field} {count}" for field, count in fields.items())
            for owner, fields in totals.items()
        ]
        return Text("errors since the start   " + "   ".join(parts), style="yellow")

    def _peers(self, width: int) -> Table:
        history = _history_width(width - 85, 1)
        table = _table("peer (last minute)", "RTT now", "median", "", "loss", "lost / sent", "outages")
        for state in self.state.peers.values():
            loss = state.loss()
            table.add_row(
                clean(state.name),
                _last_words(state),
                duration(state.median_rtt_ns()),
                spark(state.rtt_history, history, least=0.0),
                "?" if loss is None else Text(f"{loss * 100:.1f} %", style="red" if loss > 0.01 else ""),
                f"{state.lost} / {state.sent}",
                _outage_words(state),
            )
        return table

    def _foot(self, console: Console) -> None:
        if self.state.account is not None:
            console.print(Text(account_line(self.state.account), style="dim"))
        for event in self.state.events:
            at = time.strftime("%H:%M:%S", time.localtime(event.wall_ns / 1e9))
            console.print(Text(f"{at}  {clean(event_line(event) or '')}"), overflow="ellipsis", no_wrap=True)

    def _size(self) -> tuple[int, int]:
        with contextlib.suppress(OSError):
            columns, lines = os.get_terminal_size(self._fd)
            if columns > 0 and lines > 0:
                return columns, lines
        return 100, 30


def _table(*titles: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for title in titles:
        # figures change all the time: a least width keeps the columns where they are
        least = {"receive": 11, "send": 11, "RSSI": 7, "RTT now": 7}.get(title)
        table.add_column(title, no_wrap=True, overflow="ellipsis", header_style="dim", min_width=least)
    return table


def _history_width(room: int, lines: int) -> int:
    return max(_HISTORY_LEAST, min(_HISTORY_MOST, room // lines))


def _link_words(state: InterfaceState) -> str:
    link = state.wireless
    if link is None:
        return "wired"
    words = [] if link.ssid is None else [clean(link.ssid)]
    if len(state.peers) > 1:
        words.append(f"weakest of {len(state.peers)} peers")
    if link.frequency_mhz is not None:
        words.append(f"{link.frequency_mhz} MHz")
    if link.connected is False:
        words.append("not connected")
    elif link.connected is None and link.rssi_dbm is None:
        words.append(link.mode or "?")
    return " ".join(words) or "connected"


def _last_words(state: PeerState) -> Text:
    if state.last is None:
        return Text("?")
    if state.last.state is not ProbeState.ANSWERED:
        return Text("lost", style="red")
    return Text(duration(state.last.rtt_ns))


def _outage_words(state: PeerState) -> Text:
    out_ns = state.out_for_ns()
    if out_ns is not None:
        return Text(f"NO ANSWER for {out_ns / 1e9:.1f} s", style="bold red")
    if state.outages:
        return Text(f"{state.outages} ({state.out_total_ns / 1e9:.1f} s)", style="yellow")
    return Text("none")
