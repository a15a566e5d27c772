from __future__ import annotations

import os
import threading

from linkrover.live.output import QUEUE_BYTES, Output


def read_all(fd):
    parts = []
    while part := os.read(fd, 65536):
        parts.append(part)
    os.close(fd)
    return b"".join(parts)


def test_everything_is_written_in_order():
    reading, writing = os.pipe()
    got = []
    reader = threading.Thread(target=lambda: got.append(read_all(reading)))
    reader.start()
    output = Output(writing)
    for n in range(5000):
        output.write(f"{n}\n")
    output.close()
    os.close(writing)
    reader.join()
    assert got == ["".join(f"{n}\n" for n in range(5000)).encode()]
    assert output.dropped == 0


def test_a_pipe_nobody_reads_holds_up_nobody_and_memory_is_bounded():
    reading, writing = os.pipe()
    output = Output(writing)
    line = b"x" * 1000
    for _ in range(3 * QUEUE_BYTES // 1000):
        output.write(line)
    assert output.dropped > 0
    assert output._queued_bytes <= QUEUE_BYTES
    output.close(0.05)
    os.close(reading)
    os.close(writing)


def test_a_new_frame_takes_the_place_of_one_not_written_yet():
    reading, writing = os.pipe()
    output = Output(writing)
    output.write(b"f" * 200_000)  # more than a pipe holds: the writer waits
    output.write("not a frame;")
    for n in range(100):
        output.write(f"frame {n};", frame=True)
    got = []
    reader = threading.Thread(target=lambda: got.append(read_all(reading)))
    reader.start()
    output.close()
    os.close(writing)
    reader.join()
    frames = got[0].replace(b"f" * 200_000, b"").decode()
    assert frames == "not a frame;frame 99;"


def test_a_reader_that_goes_away_is_told_of_once():
    reading, writing = os.pipe()
    told = threading.Event()
    output = Output(writing, on_broken=told.set)
    os.close(reading)
    output.write("x")
    assert told.wait(20)
    assert output.broken
    output.write("y")
    output.close()
    os.close(writing)


def test_a_non_blocking_descriptor_loses_nothing():
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    got = []
    reader = threading.Thread(target=lambda: got.append(read_all(reading)))
    reader.start()
    output = Output(writing)
    output.write(b"z" * 500_000)
    output.close(20)
    os.close(writing)
    reader.join()
    assert got == [b"z" * 500_000]
