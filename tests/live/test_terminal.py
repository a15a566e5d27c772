from __future__ import annotations

import fcntl
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import time

import pytest

from linkrover.agent import AgentConfig
from linkrover.agent.machine import collect_manifest
from linkrover.live.output import Output
from linkrover.live.terminal import TerminalView
from linkrover.records import (
    Continuity,
    EventKind,
    LinkEvent,
    LinkUtilization,
    NetworkErrors,
    ProbeResult,
    ProbeState,
    WirelessLink,
)

S = 1_000_000_000


@pytest.fixture
def view(monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    fd = os.open(os.devnull, os.O_WRONLY)
    output = Output(fd)
    yield TerminalView(output, fd, collect_manifest(AgentConfig()), recording="runs/1/robot")
    output.close()
    os.close(fd)


def at(second):
    return {"wall_ns": second * S, "mono_ns": second * S}


@pytest.mark.parametrize("width", [40, 80, 200])
def test_an_empty_view_and_a_full_one_fit_the_width(view, width):
    assert "LinkRover agent, robot" in view.render(200)
    for second in range(70):
        view.take(LinkUtilization(iface="wlan0", rx_rate_bps=1e6, tx_rate_bps=4.2e7, **at(second)))
        view.take(
            WirelessLink(iface="wlan0", source="wext", rssi_dbm=-61.0, ssid="robots", connected=True, **at(second))
        )
        view.take(NetworkErrors(iface="wlan0", tcp_retransmits=second, **at(second)))
        view.take(
            ProbeResult(peer="p", session=1, sequence=second, state=ProbeState.ANSWERED, rtt_ns=3210000, **at(second))
        )
    view.take(LinkEvent(iface="wlan0", peer="p", kind=EventKind.OUTAGE_BEGAN, detail="no answer", **at(70)))
    text = view.render(width)
    assert all(len(line) <= width for line in text.splitlines())
    if width == 200:
        words = ["wlan0", "1 Mbit/s", "42 Mbit/s", "-61 dBm", "robots", "3.21 ms", "tcp_retransmits 69"]
        for word in [*words, "NO ANSWER", "outage began", "runs/1/robot", "▁"]:
            assert word in text


def test_what_is_unknown_is_shown_as_unknown(view):
    view.take(LinkUtilization(iface="wlan0", continuity=Continuity.GONE, **at(1)))
    view.take(WirelessLink(iface="wlan0", source="wext", connected=False, **at(1)))
    view.take(ProbeResult(peer="p", session=1, sequence=1, state=ProbeState.LOST, **at(1)))
    text = view.render(160)
    assert "gone" in text
    assert "not connected" in text
    assert "lost" in text


@pytest.mark.parametrize("ssid", ["[red]x[/blue]", "\x1b]0;owned\x07", "[/]", ":smile:", "a\nb"])
def test_a_hostile_network_name_is_shown_and_does_nothing(view, ssid):
    view.take(WirelessLink(iface="wlan0", source="wext", rssi_dbm=-60.0, ssid=ssid, **at(1)))
    view.take(LinkEvent(iface="wlan0", kind=EventKind.ROAMED, detail=ssid, **at(1)))
    text = view.render(160)
    assert "\x1b]" not in text
    assert "\x07" not in text
    if ssid.isprintable():
        assert ssid in text


def test_on_a_real_terminal_it_draws_and_gives_the_screen_back():
    main, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("4H", 30, 120, 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-m", "linkrover", "agent", "--interface", "lo"],
        stdout=terminal,
        stderr=terminal,
        env={**os.environ, "TERM": "xterm"},
    )
    os.close(terminal)
    seen = b""
    deadline = time.monotonic() + 30
    while seen.count(b"LinkRover agent") < 2 and time.monotonic() < deadline:
        seen += os.read(main, 65536)
    process.send_signal(signal.SIGINT)
    while True:
        try:
            part = os.read(main, 65536)
        except OSError:  # the other side of the terminal is closed
            break
        if not part:
            break
        seen += part
    os.close(main)
    assert process.wait(20) == 0
    assert b"interface" in seen
    assert seen.index(b"\x1b[?1049h") < seen.rindex(b"\x1b[?1049l")
    assert b"Traceback" not in seen
