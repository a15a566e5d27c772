"""The guest itself: a real 802.11 stack is there."""

from __future__ import annotations

from pathlib import Path


def test_the_guest_kernel_has_wireless():
    assert Path("/sys/module/cfg80211").exists()
