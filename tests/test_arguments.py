"""Public functions refuse an argument of a wrong type by name, with what to call instead."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.sweeps import for_all

import uoarm
from uoarm import (
    AsyncRobotManager,
    Connection,
    QueuePolicy,
    RobotManager,
    UsageError,
    config,
    local,
    testing,
)
from uoarm import client as remote
from uoarm._arguments import _kinds_of, arguments, built_with_arguments
from uoarm.client._stream import RemoteStream

PUBLIC: list[tuple[Any, ...]] = [
    (RobotManager, "__init__", "from_file", "resolve", "request", "call", "structures"),
    (RobotManager, "structure_of_type", "offer", "discover", "listen", "apply", "reload"),
    (RobotManager, "rollback", "stop_all", "release", "playback"),
    (Connection, "get", "send", "stop", "hold", "leave", "flush", "subscribe"),
    (AsyncRobotManager, "__init__", "from_file", "request", "call", "listen"),
    (uoarm.AsyncConnection, "subscribe", "hold"),
    (remote, "connect"),
    (remote.RemoteRobot, "request", "call", "resolve", "configure", "rollback"),
    (remote.RemoteRobot, "stop_recording", "dump_recording", "playback"),
    (RemoteStream, "get", "send", "stop", "hold"),
    (config, "load", "loads", "inspect"),
    (local, "structure"),
    (testing, "wait", "free_port", "losses", "copies", "raising", "hanging", "lying"),
    (testing.ManualClock, "__init__"),
    (testing.MemoryBridge, "__init__"),
    (testing.Background, "__init__"),
    (testing.MemoryService, "__init__"),
    (QueuePolicy, "__init__"),
    (local.Range, "__init__"),
]


class Wrong:
    """What no parameter expects."""


def parameters() -> Iterator[tuple[Callable[..., Any], str]]:
    for owner, *names in PUBLIC:
        for name in names:
            function = getattr(owner, name)
            function = getattr(function, "__func__", function)
            hints = inspect.get_annotations(inspect.unwrap(function))
            for parameter in hints.keys() - {"return", "message", "as_type", "T"}:
                if "Any" not in str(hints[parameter]) and hints[parameter] != "object":
                    yield function, parameter


def finished(done: object) -> None:
    if inspect.iscoroutine(done):
        asyncio.run(done)


@for_all("taken", sorted(parameters(), key=str))
def test_every_public_argument_is_looked_at(taken: tuple[Callable[..., Any], str]) -> None:
    function, parameter = taken
    first = next(iter(inspect.signature(function).parameters))
    others = {} if first not in {"self", "cls"} else {first: None}
    with pytest.raises(UsageError) as caught:
        finished(function(**others, **{parameter: Wrong()}))
    assert f"{parameter}: expected " in str(caught.value)
    assert "got a Wrong" in str(caught.value)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda _: RobotManager("robot.yaml"),  # type: ignore[arg-type]
            "expected a Robot, got the text 'robot.yaml'; RobotManager.from_file(path) reads ",
        ),
        (
            lambda _: AsyncRobotManager("robot.yaml"),  # type: ignore[arg-type]
            "AsyncRobotManager.from_file(path) reads a file",
        ),
        (lambda robot: robot.request(3), "request: name: expected a text, got 3"),
        (lambda robot: robot.request("a", timeout="5"), "expected a number, got the text '5'"),
        (lambda robot: robot.request("a", timeout=True), "expected a number, got True"),
        (lambda robot: robot.request("a", queue=5), "expected a QueuePolicy or None, got 5"),
        (lambda robot: robot.request("a", timeot=5), "did you mean 'timeout'?"),
        (lambda robot: robot.offer("a"), "what is offered stands in the configuration"),
        (lambda robot: robot.apply("robot.yaml"), "reload(path) reads a file"),
        (lambda robot: robot.reload(robot.config), "apply(robot) takes a Robot"),
        (lambda robot: robot.listen(None), "expected something that can be called, got None"),
        (lambda _: QueuePolicy("5"), "length: expected a whole number, got the text '5'"),  # type: ignore[arg-type]
    ],
)
def test_what_to_call_instead_is_said(call: Callable[[RobotManager], Any], said: str) -> None:
    with (
        RobotManager(config.loads("version: 1\nbridges: {}\nfunctions: {}\n")) as robot,
        pytest.raises(UsageError) as caught,
    ):
        call(robot)
    assert said in str(caught.value)


@arguments()
def taken(
    number: float,
    whole: int = 1,
    path: str | Path = "",
    *more: int,
    of: dict[str, int] | None = None,
    anything: Any = None,
    **others: str,
) -> str:
    return f"{number} {whole} {path} {more} {of} {anything} {others}"


def test_what_stands_for_a_type_is_taken() -> None:
    assert taken(1, np.int64(2), Path("a"), 3, of={}, anything=4, b="c")
    assert taken(np.float32(1.5), 2, "a")
    assert taken(number=2.5)


async def take_later(_: object) -> None: ...


class TakesLater:
    async def __call__(self, _: object) -> None: ...


@pytest.mark.parametrize(
    "callback", [take_later, TakesLater(), TakesLater().__call__, partial(take_later, 1)]
)
@pytest.mark.parametrize(
    ("function", "parameter"),
    [
        (RobotManager.request, "on_message"),
        (RobotManager.listen, "listener"),
        (AsyncRobotManager.request, "on_message"),
        (AsyncRobotManager.listen, "listener"),
        (Connection.subscribe, "callback"),
        (uoarm.AsyncConnection.subscribe, "callback"),
    ],
)
def test_a_callback_that_nothing_would_await_is_refused(
    callback: Any, function: Callable[..., Any], parameter: str
) -> None:
    with pytest.raises(UsageError) as caught:
        finished(function(None, **{parameter: callback}))
    assert f"{parameter}: expected something that can be called" in str(caught.value)
    assert "got a coroutine function, which nothing awaits" in str(caught.value)


def test_names_of_functions_and_their_words_stay() -> None:
    assert RobotManager.request.__name__ == "request"
    assert "Resolve a function" in str(RobotManager.request.__doc__)
    assert inspect.iscoroutinefunction(remote.RemoteRobot.call)


@pytest.mark.parametrize("hint", [Any, object, "T", type[int]])
def test_what_a_hint_leaves_open_is_not_looked_at(hint: Any) -> None:
    assert _kinds_of(hint) == ()


def test_it_is_for_classes_of_attrs_too() -> None:
    from attrs import frozen

    @built_with_arguments
    @frozen
    class Point:
        x: float

    assert Point(1).x == 1
    with pytest.raises(UsageError, match="Point: x: expected a number, got the text '1'"):
        Point("1")  # type: ignore[arg-type]


def test_a_method_is_named_with_the_class_that_its_caller_knows() -> None:
    class Counter:
        @arguments()
        def __init__(self, start: int = 0) -> None: ...

        @arguments()
        def count(self, most: int) -> None: ...

        @classmethod
        @arguments()
        def to(cls, most: int) -> None: ...

    class SlowCounter(Counter): ...

    wrong: Any = "many"
    with pytest.raises(UsageError, match=r"Counter: start: expected"):
        Counter(wrong)
    with pytest.raises(UsageError, match=r"SlowCounter\.count: most: expected"):
        SlowCounter().count(wrong)
    with pytest.raises(UsageError, match=r"SlowCounter\.to: most: expected"):
        SlowCounter.to(wrong)
