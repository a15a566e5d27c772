from __future__ import annotations

import os

import pytest

from linkrover.emulator.driver import HEADER, DriverFile, level_dbm, wireless_line

REAL_LINE = (
    b" wlan1: 0000   38.  -72.  -256        0      0      0      0      8        0\n"  # mac80211_hwsim, Linux 6.1
)


def test_the_line_is_the_kernels_own_text():
    kernel = REAL_LINE.replace(b"     8        0", b"     0        0")
    assert wireless_line("wlan1", -72) == kernel


@pytest.mark.parametrize(("rssi", "level"), [(-71.5, -72), (-40.4, -40), (-140, -110), (3, -1)])
def test_levels_are_whole_dbm_in_the_drivers_range(rssi, level):
    assert level_dbm(rssi) == level
    assert f"{level:3d}.".encode() in wireless_line("wlan0", rssi)


def test_a_reader_that_keeps_its_descriptor_open_sees_changes_and_the_headers_alone_when_not_associated(tmp_path):
    file = DriverFile(tmp_path / "wireless")
    reader = os.open(tmp_path / "wireless", os.O_RDONLY)
    assert os.pread(reader, 4096, 0) == HEADER
    file.write(-55.2, -94.0, retry_drops=123_456_789)
    longer = os.pread(reader, 4096, 0)
    assert longer.startswith(HEADER)
    assert b" -55. " in longer
    file.write(-60)
    assert os.pread(reader, 4096, 0) == HEADER + wireless_line("wlan0", -60)
    file.write(None)
    assert os.pread(reader, 4096, 0) == HEADER
    os.close(reader)
    file.close()
