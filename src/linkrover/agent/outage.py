"""Outages: maximal stretches of time without an answered probe."""

from __future__ import annotations

from linkrover.records import EventKind, LinkEvent, Now, ProbeResult, ProbeState


class OutageWatch:
    """Turns probe results of one peer into OUTAGE_BEGAN and OUTAGE_ENDED events.

    An outage spans from the sending of the last probe that was answered to the sending of the next one that is;
    it counts once that is longer than threshold_ns. gap_ns of the ending event is its length.
    """

    def __init__(self, iface: str, peer: str, threshold_ns: int, start: Now) -> None:
        self.iface = iface
        self.peer = peer
        self.threshold_ns = threshold_ns
        self.out = False
        self._last = start  # of the last answered probe's sending
        self._answered_once = False

    def take(self, result: ProbeResult) -> list[LinkEvent]:
        """One result, in whatever order they become known."""
        if result.state is not ProbeState.ANSWERED or result.mono_ns <= self._last.mono_ns:
            return []
        gap_ns = result.mono_ns - self._last.mono_ns
        events = []
        if gap_ns > self.threshold_ns and self._answered_once and not self.out:
            # it began and ended before anybody looked
            events.append(self._began())
            self.out = True
        if self.out:
            events.append(
                LinkEvent(
                    wall_ns=result.wall_ns,
                    mono_ns=result.mono_ns,
                    iface=self.iface,
                    kind=EventKind.OUTAGE_ENDED,
                    peer=self.peer,
                    gap_ns=gap_ns,
                    detail=f"{self.peer} answers again after {gap_ns / 1e9:.2f} s"
                    if self._answered_once
                    else f"{self.peer} answers, {gap_ns / 1e9:.2f} s after the start",
                )
            )
            self.out = False
        self._last = Now(result.wall_ns, result.mono_ns)
        self._answered_once = True
        return events

    def look(self, mono_ns: int) -> list[LinkEvent]:
        """Whether an outage has begun by now."""
        if self.out or mono_ns - self._last.mono_ns <= self.threshold_ns:
            return []
        self.out = True
        return [self._began()]

    def _began(self) -> LinkEvent:
        return LinkEvent(
            wall_ns=self._last.wall_ns,
            mono_ns=self._last.mono_ns,
            iface=self.iface,
            kind=EventKind.OUTAGE_BEGAN,
            peer=self.peer,
            detail=f"no answer from {self.peer} for more than {self.threshold_ns / 1e9:g} s",
        )
