"""Asynchronous components: one loop for a bridge, limits, and cancellation at the end."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from concurrent.futures import Future
from typing import Any

import pytest
from tests.local import talk
from tests.local.typed_parts import Started, leave_behind, wait_long

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.local._loop import Coroutines, LoopThread
from uoarm.model import Role
from uoarm.testing import Background, Collector, patience

THREE = [{"value": value} for value in range(3)]


@pytest.fixture(autouse=True)
def _fresh() -> None:
    Started.cancelled.clear()
    Started.begun.clear()
    Started.threads.clear()


def test_an_asynchronous_service_replies() -> None:
    assert talk.call("add", {"value": 1}) == {"value": 2}


def test_handlers_run_in_one_thread_of_the_bridge() -> None:
    with talk.bridge() as made:
        for name in ("one", "two"):
            endpoint = talk.at("add", Role.SERVICE)
            assert made.call(endpoint, {"value": 1}, timeout=patience()), name
        taken = Collector()
        made.open_source(talk.at("add", Role.OUTPUT), talk.ANY, taken.deliver)
        made.open_sink(talk.at("add", Role.INPUT), talk.ANY).send({"value": 5})
        assert taken.wait(1) == [{"value": 6}]
    assert Started.threads == {"uoarm-p-loop"}
    assert "uoarm-p-loop" not in {thread.name for thread in threading.enumerate()}


def test_an_asynchronous_generator_answers_a_message_with_several() -> None:
    assert talk.through("count_up", {"value": 3}, 3) == THREE


@pytest.mark.filterwarnings("error")
def test_a_decorator_that_hides_what_is_asynchronous_changes_nothing() -> None:
    assert talk.call("add_decorated", {"value": 1}) == {"value": 2}
    assert talk.through("add_decorated", {"value": 1}) == [{"value": 2}]
    assert talk.through("count_up_decorated", {"value": 3}, 3) == THREE


def test_an_asynchronous_generator_is_a_source(caplog: pytest.LogCaptureFixture) -> None:
    described = talk.describe("counting", Role.OUTPUT).message
    assert described is not None
    assert described.native_type == "Count"
    assert talk.given("counting", 3) == THREE
    assert not caplog.records


def test_who_stops_the_loop_stops_no_other_component() -> None:
    with talk.bridge() as made:
        for name, value in (("stop_the_loop", 1), ("add", 2), ("stop_the_loop", 3)):
            endpoint = talk.at(name, Role.SERVICE)
            reply = made.call(endpoint, {"value": value}, timeout=patience())
            assert reply == {"value": value + (name == "add")}


def test_a_task_that_raises_as_the_loop_ends_keeps_no_other_from_its_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    loop = LoopThread("ends")
    coroutines = Coroutines(loop, patience())
    coroutines.run("leaves", leave_behind({"value": 1}))
    waits = Background(lambda: coroutines.run("waits", wait_long({"value": 1})))
    assert Started.begun.wait(patience())
    loop.close()
    with pytest.raises(BridgeError, match="was cancelled: it closes"):
        waits.result()
    assert "a task that a component left behind raised" in caplog.text


def test_an_asynchronous_class_is_closed_in_the_loop() -> None:
    with talk.bridge() as made:
        endpoint = talk.at("Adder", Role.SERVICE, start=1)
        assert made.call(endpoint, {"value": 2}, timeout=patience()) == {"value": 3}
        assert made.call(endpoint, {"value": 2}, timeout=patience()) == {"value": 5}
        assert not Started.cancelled.is_set()
    assert Started.cancelled.is_set()


def test_a_service_that_takes_too_long_is_cancelled() -> None:
    with talk.bridge() as made:
        while not Started.begun.is_set():  # its time may be over before it has begun
            with pytest.raises(BridgeTimeoutError):
                made.call(talk.at("wait_long", Role.SERVICE), {"value": 1}, timeout=0.05)
        assert Started.cancelled.wait(patience())


def test_a_handler_that_takes_too_long_is_cancelled() -> None:
    with talk.bridge(timeout=0.05) as made:
        sink = made.open_sink(talk.at("wait_long", Role.INPUT), talk.ANY)
        while not Started.begun.is_set():  # its time may be over before it has begun
            with pytest.raises(BridgeTimeoutError, match=r"wait_long did not finish within 0\.05"):
                sink.send({"value": 1})
        assert Started.cancelled.wait(patience())


def test_a_handler_is_cancelled_when_its_input_closes() -> None:
    with talk.bridge(timeout=patience()) as made:
        sink = made.open_sink(talk.at("wait_long", Role.INPUT), talk.ANY)
        sending = Background(lambda: sink.send({"value": 1}))
        assert Started.begun.wait(patience())
        sink.close()
        assert Started.cancelled.wait(patience())
        with pytest.raises(BridgeError, match="was cancelled: it closes") as caught:
            sending.result()
        assert caught.value.reason is FailureReason.CLOSED


def test_a_source_that_says_nothing_is_cancelled_with_its_bridge() -> None:
    with talk.bridge() as made:
        made.open_source(talk.at("silent_source", Role.OUTPUT), talk.ANY, Collector().deliver)
        assert Started.begun.wait(patience())
    assert Started.cancelled.wait(patience())


class _CancelsAtOnce(LoopThread):
    """Lets the component be closed just after a coroutine was submitted."""

    coroutines: Coroutines

    def submit(self, coroutine: Coroutine[Any, Any, Any]) -> Future[Any]:
        future = super().submit(coroutine)
        self.coroutines.cancel()
        return future


def test_a_coroutine_that_was_just_submitted_is_cancelled_too() -> None:
    loop = _CancelsAtOnce("cancels")
    loop.coroutines = Coroutines(loop, patience())
    try:
        with pytest.raises(BridgeError, match="was cancelled: it closes"):
            loop.coroutines.run("a wait", asyncio.Event().wait())
    finally:
        loop.close()
