"""Daemon threads: as many as may be, the rest in order, and none that an end waits for."""

from __future__ import annotations

import subprocess
import sys
import threading
from functools import partial

import pytest

from uoarm._host._daemons import DaemonThreads
from uoarm.testing import Census, patience, wait


def test_no_more_run_at_once_than_may_and_the_rest_waits() -> None:
    before = Census()
    threads = DaemonThreads("test", 2)
    gate, begun = threading.Event(), list[int]()

    def begin(number: int) -> None:
        begun.append(number)
        gate.wait(patience())

    for number in range(5):
        assert threads.submit(partial(begin, number))
    wait(lambda: len(begun) == 2)
    gate.set()
    wait(lambda: len(begun) == 5)
    assert sorted(begun) == [0, 1, 2, 3, 4]
    threads.close()
    before.check()


def test_one_thread_keeps_the_order_and_outlives_what_an_action_raises(
    caplog: pytest.LogCaptureFixture,
) -> None:
    threads = DaemonThreads("test", 1)
    done: list[int] = []

    def act(number: int) -> None:
        done.append(number)
        assert number != 3, "the third one fails"

    for number in range(10):
        threads.submit(partial(act, number))
    wait(lambda: len(done) == 10)
    assert done == list(range(10))
    assert "a thread of test failed" in caplog.text
    threads.close()


def test_what_has_not_begun_when_it_closes_never_does() -> None:
    before = Census()
    threads = DaemonThreads("test", 1)
    gate, begun = threading.Event(), threading.Event()
    done: list[str] = []

    def first() -> None:
        begun.set()
        gate.wait(patience())
        done.append("first")

    threads.submit(first)
    assert begun.wait(patience())
    threads.submit(lambda: done.append("second"))
    threads.close()
    gate.set()
    assert not threads.submit(lambda: done.append("third"))
    before.check()
    assert done == ["first"]


ENDS = """
import threading
from uoarm._host._daemons import DaemonThreads
begun = threading.Event()
threads = DaemonThreads("test", 1)
threads.submit(lambda: (begun.set(), threading.Event().wait()))
begun.wait()
"""


def test_an_action_that_hangs_keeps_no_process_alive() -> None:
    done = subprocess.run([sys.executable, "-c", ENDS], check=False, timeout=patience())
    assert done.returncode == 0
