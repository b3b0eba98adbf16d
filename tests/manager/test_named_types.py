"""The structure of a native type by its name, as the plugins of a robot's bridges know it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from uoarm import RobotManager
from uoarm.bridge import BridgeType, Registry
from uoarm.config import loads
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import MessageStructure, Options
from uoarm.testing import MemoryBridge

ROBOT = """
version: 1
bridges:
  plain: {plugin: plain}
  apart: {plugin: first, host: {}}
  later: {plugin: second}
  one: {plugin: first}
functions: {}
"""
TEXT = MessageStructure({"type": "string"}, native_type="text")
Find = Callable[[str, Options], "MessageStructure | None"]


def robot_of(first: Find, second: Find) -> RobotManager:
    registry = Registry([])

    def make(name: str, options: Options) -> MemoryBridge:
        pytest.fail(f"bridge {name!r} was started")

    for name, find in (("first", first), ("second", second), ("plain", None)):
        registry.add(BridgeType(name, "for tests", make, structure_of_type=find, contract=2))
    return RobotManager(loads(ROBOT, types=registry.types), registry=registry)


def nothing(name: str, options: Options) -> None:
    del name, options


def test_plugins_are_asked_in_the_configurations_order_and_no_bridge_is_started() -> None:
    asked: list[str] = []

    def first(name: str, options: Options) -> MessageStructure:
        del options
        asked.append(f"first {name}")
        return TEXT

    def second(name: str, options: Options) -> MessageStructure | None:
        del options
        asked.append(f"second {name}")
        return TEXT if name == "text" else None

    with robot_of(first, second) as robot:
        assert robot.structure_of_type("text") is TEXT
        assert asked == ["second text"]
        assert robot.structure_of_type("number") is TEXT
        assert asked == ["second text", "second number", "first number"]


def test_a_type_that_no_plugin_knows() -> None:
    with robot_of(nothing, nothing) as robot:
        assert robot.structure_of_type("text") is None


def test_a_plugin_that_raises_is_named() -> None:
    def broken(name: str, options: Options) -> MessageStructure:
        raise RuntimeError("no such folder")

    with robot_of(broken, nothing) as robot, pytest.raises(BridgeError) as caught:
        robot.structure_of_type("text")
    assert str(caught.value) == (
        "bridge 'one': looking for type 'text' failed: RuntimeError: no such folder"
    )


def test_a_plugin_that_returns_something_else_is_named() -> None:
    with (
        robot_of(lambda *_: {"type": "string"}, nothing) as robot,  # type: ignore[arg-type]  # the mistake
        pytest.raises(BridgeError, match="structure_of_type returned dict") as caught,
    ):
        robot.structure_of_type("text")
    assert caught.value.reason is FailureReason.CONTRACT


def test_a_plugin_that_hangs_is_given_up() -> None:
    release = threading.Event()

    def hanging(name: str, options: Options) -> None:
        del name, options
        release.wait()

    try:
        with (
            robot_of(hanging, nothing) as robot,
            pytest.raises(BridgeTimeoutError, match="bridge 'one': looking for type 'text'"),
        ):
            robot.structure_of_type("text", timeout=0.05)
    finally:
        release.set()
