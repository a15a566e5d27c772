from __future__ import annotations

import os

from linkrover.ros2.stderr import CapturedStderr

CYCLONE = b"1795277386.745570 [5]        tev: ddsi_udp_conn_write to udp/10.77.0.2:%d failed with retcode -1\n"


def test_what_c_code_says_is_handed_over_and_cyclones_repetitions_once() -> None:
    lines: list[str] = []
    captured = CapturedStderr()
    captured.start(lines.append)
    try:
        for port in (1, 22, 333):
            os.write(2, CYCLONE % port)
        os.write(2, b"something \xff else\n" * 2 + b"no end")
    finally:
        captured.close()
    assert lines == [
        "linkrover: WARNING: Cyclone DDS: ddsi_udp_conn_write to udp/10.77.0.2:1 failed with retcode -1\n",
        "something \ufffd else\n",
        "something \ufffd else\n",
        "no end",
    ]
    assert os.fstat(2).st_ino == os.fstat(captured.terminal).st_ino
    os.close(captured.terminal)
