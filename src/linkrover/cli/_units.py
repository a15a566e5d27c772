"""Figures for a reader: the unit that keeps three or four digits."""

from __future__ import annotations

from collections.abc import Callable


def duration(ns: float | None) -> str:
    """Nanoseconds as us, ms or s."""
    if ns is None:
        return "unknown"
    size = abs(ns)
    if size < 999_500:
        return f"{ns / 1e3:.1f} us"
    if size < 999_500_000:
        return f"{ns / 1e6:.2f} ms"
    return f"{ns / 1e9:.2f} s"


def bit_rate(bps: float | None) -> str:
    """Bits per second as kbit/s or Mbit/s."""
    if bps is None:
        return "unknown"
    return f"{bps / 1e3:.1f} kbit/s" if abs(bps) < 999_500 else f"{bps / 1e6:.2f} Mbit/s"


def share(part: float | None) -> str:
    """0..1 as per cent."""
    return "unknown" if part is None else f"{part * 100:.1f} %"


def on_interrupt(stop: Callable[[], None]) -> Callable[[], None]:
    """Call `stop` on SIGINT and SIGTERM instead of breaking off. Returns what restores the former handlers."""
    import signal

    former = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def handle(_number: int, _frame: object) -> None:
        stop()

    for number in former:
        signal.signal(number, handle)

    def restore() -> None:
        for number, handler in former.items():
            signal.signal(number, handler)

    return restore
