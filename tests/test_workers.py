"""The worker pool: threads up to a limit, used again, and none that an end waits for."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import weakref
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import pytest

import uoarm
from uoarm._support import workers
from uoarm._support.workers import Job, Lanes, WorkerPool, WorkerPoolClosedError
from uoarm.testing import ResourceSnapshot, patience, wait


def test_no_more_run_at_once_than_the_limit_and_the_rest_waits() -> None:
    before = ResourceSnapshot()
    pool = WorkerPool("test", 2)
    gate, begun = threading.Event(), list[int]()

    def begin(number: int) -> None:
        begun.append(number)
        gate.wait(patience())

    for number in range(5):
        assert pool.submit(begin, number)
    wait(lambda: len(begun) == 2)
    assert pool.busy == 5
    assert not pool.submit(begin, 5, queue=False)
    gate.set()
    wait(lambda: len(begun) == 5)
    assert sorted(begun) == [0, 1, 2, 3, 4]
    wait(lambda: pool.busy == 0)
    assert pool.close() == 0
    before.check()


def test_without_a_limit_no_call_waits_for_another() -> None:
    before = ResourceSnapshot()
    pool = WorkerPool("test")
    together = threading.Barrier(20)
    passed: list[int] = []
    for _ in range(20):
        pool.submit(lambda: passed.append(together.wait(patience())))
    wait(lambda: len(passed) == 20)
    pool.close()
    before.check()


def test_calls_that_are_held_up_hold_up_no_others_where_the_pool_has_patience() -> None:
    before = ResourceSnapshot()
    pool = WorkerPool("test", 2, patience=0.01)
    together = threading.Barrier(20)
    passed: list[int] = []
    for _ in range(20):
        pool.submit(lambda: passed.append(together.wait(patience())))
    wait(lambda: len(passed) == 20)
    pool.close()
    before.check()


def test_at_the_end_what_waits_is_done_though_all_threads_are_held_up() -> None:
    before = ResourceSnapshot()
    pool = WorkerPool("test", 1, patience=patience())
    gate, done = threading.Event(), list[int]()
    pool.submit(gate.wait, patience())
    for number in range(3):
        pool.submit(done.append, number)
    assert pool.close(drop=False) == 0
    wait(lambda: sorted(done) == [0, 1, 2])
    gate.set()
    before.check()


def test_calls_that_get_on_have_no_more_threads_than_the_limit() -> None:
    before = ResourceSnapshot()
    pool = WorkerPool("test", 2, patience=patience())
    seen, done = set[int](), list[int]()

    def act(number: int) -> None:
        seen.add(threading.get_ident())
        done.append(number)

    for number in range(1000):
        pool.submit(act, number)
    wait(lambda: len(done) == 1000)
    assert len(seen) <= 2
    pool.close()
    before.check()


def test_one_thread_keeps_the_order_and_outlives_what_a_call_raises(
    caplog: pytest.LogCaptureFixture,
) -> None:
    pool = WorkerPool("test", 1)
    done: list[int] = []

    def act(number: int) -> None:
        done.append(number)
        if number == 3:
            raise SystemExit("the third one fails")

    for number in range(10):
        pool.submit(act, number)
    wait(lambda: len(done) == 10)
    assert done == list(range(10))
    assert "a call in a thread of test failed" in caplog.text
    pool.close()


def test_an_idle_thread_is_used_again_and_the_last_one_first() -> None:
    pool = WorkerPool("test", idle_seconds=patience())
    gate, together = threading.Event(), threading.Barrier(3)
    for _ in range(2):
        pool.submit(lambda: (together.wait(patience()), gate.wait(patience())))
    together.wait(patience())
    gate.set()
    wait(lambda: len(pool._idle) == 2)
    used: list[int] = []
    for number in range(1, 11):
        pool.submit(lambda: used.append(threading.get_ident()))
        wait(lambda: len(used) == number and len(pool._idle) == 2)  # noqa: B023 - called here
    assert len(set(used)) == 1
    pool.close()


def test_idle_threads_end_and_new_ones_come() -> None:
    pool = WorkerPool("test", 1, idle_seconds=0.01)
    used: list[threading.Thread] = []
    for number in (1, 2, 3):
        pool.submit(lambda: used.append(threading.current_thread()))
        wait(lambda: len(used) == number and not used[-1].is_alive())  # noqa: B023 - called here
    assert len(set(used)) == 3
    assert {thread.name for thread in used} == {"test"}


def test_a_thread_that_is_to_wait_for_nothing_ends_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Endless(SimpleQueue[Any]):
        """With no time left, CPython 3.10 waits without a limit."""

        def get(self, block: bool = True, timeout: float | None = None) -> Any:
            return super().get(block)

    monkeypatch.setattr(workers, "SimpleQueue", Endless)
    before = ResourceSnapshot()
    pool, done = WorkerPool("test", idle_seconds=0), threading.Event()
    pool.submit(done.set)
    assert done.wait(patience())
    before.check()


def test_a_call_that_comes_when_a_thread_is_about_to_end_is_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = ResourceSnapshot()
    pool = WorkerPool("test", 1)
    done = threading.Event()

    class Ending(SimpleQueue[Any]):
        """The wait ends, and a call is handed over before the thread can say that it ends."""

        def get(self, block: bool = True, timeout: float | None = None) -> Any:
            if timeout is not None and not done.is_set():
                assert pool.submit(done.set)
                raise Empty
            return super().get(block, timeout)

    monkeypatch.setattr(workers, "SimpleQueue", Ending)
    pool.submit(lambda: None)
    assert done.wait(patience())
    pool.close()
    before.check()


def test_an_idle_thread_holds_nothing_of_what_it_did() -> None:
    class Message:
        pass

    pool = WorkerPool("test", idle_seconds=patience())
    message = Message()
    held = weakref.ref(message)
    pool.submit(lambda _: Message(), message, done=lambda result, _: result)
    del message
    wait(lambda: len(pool._idle) == 1 and held() is None)
    pool.close()


def test_the_callback_gets_the_result_or_the_error_and_finds_room() -> None:
    pool = WorkerPool("test", 1)
    reports: list[tuple[object, BaseException | None]] = []
    again: list[bool] = []

    def done(result: object, error: BaseException | None) -> None:
        again.append(pool.submit(lambda: None, queue=False))
        reports.append((result, error))

    assert pool.submit(divmod, 7, 2, done=done)
    wait(lambda: len(reports) == 1 and pool.busy == 0)
    assert reports == [((3, 1), None)]
    assert pool.submit(divmod, 7, 0, done=done)
    wait(lambda: len(reports) == 2)
    assert isinstance(reports[1][1], ZeroDivisionError)
    assert again == [True, True]
    pool.close()


def test_a_callback_that_fails_is_logged_and_the_next_call_is_done(
    caplog: pytest.LogCaptureFixture,
) -> None:
    pool = WorkerPool("test", 1)
    done = threading.Event()
    pool.submit(lambda: None, done=lambda *_: 1 // 0)
    pool.submit(done.set)
    assert done.wait(patience())
    assert "the callback of a call in a thread of test failed" in caplog.text
    pool.close()


def test_what_has_not_begun_when_it_closes_is_dropped_and_reported() -> None:
    before = ResourceSnapshot()
    pool = WorkerPool("test", 1)
    gate, begun = threading.Event(), threading.Event()
    done: list[str] = []
    reports: list[BaseException | None] = []

    def first() -> None:
        begun.set()
        gate.wait(patience())
        done.append("first")

    pool.submit(first)
    assert begun.wait(patience())
    pool.submit(done.append, "second", done=lambda _, error: reports.append(error))
    assert pool.close() == 1
    assert pool.busy == 1
    assert isinstance(reports[0], WorkerPoolClosedError)
    assert pool.close() == 0
    gate.set()
    assert not pool.submit(done.append, "third")
    before.check()
    assert done == ["first"]


def test_a_close_that_drops_nothing_has_all_done_first() -> None:
    before = ResourceSnapshot()
    pool = WorkerPool("test", 1)
    gate = threading.Event()
    done: list[int] = []
    pool.submit(gate.wait, patience())
    for number in range(3):
        pool.submit(done.append, number)
    assert pool.close(drop=False) == 0
    gate.set()
    before.check()
    assert done == [0, 1, 2]


def test_where_the_system_gives_no_thread_nothing_is_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pool = WorkerPool("test", 1)
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", _start_none)
        with pytest.raises(RuntimeError, match="new thread"):
            pool.submit(lambda: None)
    done = threading.Event()
    assert pool.busy == 0
    assert pool.submit(done.set, queue=False)
    assert done.wait(patience())
    pool.close()


def _start_none(thread: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


ENDS = """
import threading
from uoarm._support import workers
from uoarm._support.workers import WorkerPool
begun = threading.Event()
pool = WorkerPool("test", 1)
pool.submit(lambda: (begun.set(), threading.Event().wait()))
begun.wait()
"""


def test_a_call_that_hangs_keeps_no_process_alive() -> None:
    done = subprocess.run([sys.executable, "-c", ENDS], check=False, timeout=patience())
    assert done.returncode == 0


def test_a_thread_that_was_prepared_takes_the_next_call_and_ends_with_the_pool() -> None:
    before = ResourceSnapshot()
    pool = WorkerPool("test")
    gate, ran = threading.Event(), list[int | None]()

    def act() -> None:
        ran.append(threading.current_thread().ident)
        gate.wait(patience())

    pool.submit(act)
    pool.prepare()
    pool.prepare()
    wait(lambda: len(ran) == len(pool._idle) == 1)
    pool.prepare()
    spare = {thread.ident for thread in threading.enumerate() if thread.name == "test"} - set(ran)
    pool.submit(act)
    wait(lambda: len(ran) == 2)
    assert {ran[1]} == spare
    gate.set()
    pool.close()
    before.check()


def test_no_wait_that_must_end_is_at_a_simple_queue() -> None:
    """With no time left, CPython 3.10 to 3.12 may wait there until something is put."""
    source = Path(uoarm.__file__).parent
    modules = [*source.rglob("*.py"), *source.parents[1].glob("plugins/*/src/**/*.py")]
    found = {
        path.name
        for path in modules
        for text in [path.read_text()]
        for name in re.findall(r"(\w+): (?:\w+\.)?SimpleQueue\[", text)
        if f"{name}.get(timeout=" in text
    }
    assert found == {"workers.py"}  # of whose threads it ends those alone that nothing needs


@pytest.mark.parametrize("is_served", [False, True])
def test_who_comes_to_drive_a_lane_that_was_abandoned_waits_for_no_reply(is_served: bool) -> None:
    """So a thread of a request that is given up before it begins does not stay for ever."""
    started, done = list[Job](), list[str]()
    lanes = Lanes(started.append)
    lanes.reserve("request")
    lanes.put("request", partial(done.append, "opened"))
    lanes.abandon("request")
    lanes.reply("request", None)
    if is_served:
        started[0]()
    late = threading.Thread(target=lanes.drive, args=("request",), daemon=True)
    late.start()
    late.join(patience())
    assert not late.is_alive()
    if not is_served:
        assert not done
        started[0]()
    assert done == ["opened"]
