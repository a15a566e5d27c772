from __future__ import annotations

import os
import signal
import socket
import threading
import time
from pathlib import Path

import pytest

from linkrover.loop import Loop

MS = 1_000_000


@pytest.fixture
def loop():
    loop = Loop()
    yield loop
    loop.close()


def test_slots_lie_at_start_plus_k_periods_whatever_the_job_takes(loop):
    start = time.monotonic_ns()
    slots = []

    def job(slot):
        slots.append(slot)
        if slot.index == 1:
            time.sleep(0.003)
        if len(slots) == 6:
            loop.stop()

    loop.every(10 * MS, job, start_ns=start)
    loop.run()
    assert all(slot.due_ns == start + slot.index * 10 * MS for slot in slots)
    assert all(slot.late_ns >= 0 for slot in slots)


def test_slots_that_passed_are_counted_and_not_made_up_for(loop):
    slots = []

    def job(slot):
        slots.append(slot)
        if len(slots) == 1:
            time.sleep(0.055)
        else:
            loop.stop()

    handle = loop.every(10 * MS, job)
    loop.run()
    first, second = slots
    assert second.missed == second.index - 1 >= 4
    assert second.late_ns < second.due_ns - first.due_ns
    assert handle.missed_total == second.missed


def test_a_job_never_runs_before_its_slot(loop):
    early = []

    def job(slot):
        early.append(time.monotonic_ns() < slot.due_ns)
        if slot.index >= 20:
            loop.stop()

    loop.every(2 * MS, job)
    loop.run()
    assert not any(early)


def test_a_cancelled_job_runs_no_more(loop):
    runs = []
    job = loop.every(MS, lambda slot: (runs.append(slot.index), job.cancel()))
    loop.at(time.monotonic_ns() + 20 * MS, loop.stop)
    loop.run()
    assert runs == [0]


def test_jobs_due_together_run_in_the_order_of_their_slots(loop):
    order = []
    start = time.monotonic_ns() + 5 * MS
    loop.every(1000 * MS, lambda _: order.append("second"), start_ns=start + 1)
    loop.every(1000 * MS, lambda _: order.append("first"), start_ns=start)
    loop.at(start + 10 * MS, loop.stop)
    loop.run()
    assert order == ["first", "second"]


def test_run_ends_at_the_time_given_even_with_nothing_to_do(loop):
    until = time.monotonic_ns() + 20 * MS
    loop.run(until)
    assert time.monotonic_ns() >= until


def test_a_timer_runs_once_and_not_early(loop):
    due = time.monotonic_ns() + 10 * MS
    ran = []
    loop.at(due, lambda: ran.append(time.monotonic_ns()))
    loop.at(due + 20 * MS, loop.stop)
    loop.run()
    assert len(ran) == 1
    assert ran[0] >= due


def test_a_readable_file_calls_back_until_removed(loop):
    one, two = socket.socketpair()
    got = []

    def read():
        got.append(one.recv(10))
        if len(got) == 1:
            two.send(b"b")
        else:
            remove()
            two.send(b"c")
            loop.at(time.monotonic_ns() + 5 * MS, loop.stop)

    remove = loop.reader(one, read)
    two.send(b"a")
    loop.run()
    assert got == [b"a", b"b"]
    remove()  # again: nothing left to do
    one.close()
    two.close()


def test_a_reader_removed_and_closed_by_another_of_the_same_round_is_not_called(loop):
    ends = [socket.socketpair() for _ in range(2)]
    removers = {}
    called = []

    def reader(number):
        def read():
            called.append(number)
            other = 1 - number
            removers[other]()
            ends[other][0].close()
            loop.stop()

        return read

    for number, (inner, outer) in enumerate(ends):
        removers[number] = loop.reader(inner, reader(number))
        outer.send(b"x")
    loop.run()
    assert len(called) == 1
    for inner, outer in ends:
        inner.close()
        outer.close()


def test_a_reader_may_be_removed_after_its_socket_was_closed(loop):
    one, two = socket.socketpair()
    remove = loop.reader(one, lambda: None)
    one.close()
    remove()
    two.close()


def test_call_soon_from_another_thread_wakes_the_loop(loop):
    threads = []

    def run(thread_id):
        threads.append(thread_id)
        loop.stop()

    helper = threading.Thread(target=lambda: loop.call_soon(lambda: run(threading.get_ident())))
    helper.start()
    loop.run()
    helper.join()
    assert threads == [threading.get_ident()]


def test_call_soon_many_times_over_loses_nothing(loop):
    done = []
    for number in range(100_000):
        loop.call_soon(lambda number=number: done.append(number))
    loop.call_soon(loop.stop)
    loop.run()
    assert done == list(range(100_000))


def test_stop_in_a_signal_handler_ends_the_wait(loop):
    before = signal.signal(signal.SIGUSR1, lambda *_: loop.stop())
    try:
        threading.Timer(0.05, lambda: os.kill(os.getpid(), signal.SIGUSR1)).start()
        loop.run(time.monotonic_ns() + 60_000 * MS)
    finally:
        signal.signal(signal.SIGUSR1, before)


@pytest.mark.parametrize("period", [0, -1])
def test_a_period_that_is_not_positive_is_refused(loop, period):
    with pytest.raises(ValueError, match="positive"):
        loop.every(period, lambda _: None)


def test_a_closed_loop_is_not_woken_through_somebody_elses_file():
    loop = Loop()
    loop.close()
    reading, writing = os.pipe()  # gets the numbers the loop had
    os.set_blocking(reading, False)
    loop.call_soon(lambda: None)
    loop.stop()
    with pytest.raises(BlockingIOError):
        os.read(reading, 1)
    os.close(reading)
    os.close(writing)


def test_no_file_descriptor_is_left_open():
    before = sum(1 for _ in Path("/proc/self/fd").iterdir())
    for _ in range(5):
        Loop().close()
    assert sum(1 for _ in Path("/proc/self/fd").iterdir()) == before


def test_what_another_thread_asks_for_is_done_and_none_of_it_is_lost():
    loop = Loop()
    done: list[int] = []
    many = 20_000

    def ask() -> None:
        for number in range(many):
            loop.call_soon(lambda number=number: done.append(number))
        loop.call_soon(loop.stop)

    asking = threading.Thread(target=ask)
    asking.start()
    loop.run(time.monotonic_ns() + 60_000_000_000)
    asking.join()
    loop.close()
    assert done == list(range(many))
