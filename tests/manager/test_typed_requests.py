"""Applications get messages as their own types, and send objects; mypy knows which.

`assert_type` says nothing at run time: mypy reads this module with all others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, TypedDict

import attrs
import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import assert_type

from uoarm import AsyncConnection, AsyncRobotManager, Connection, RobotManager
from uoarm.errors import MessageError, UsageError
from uoarm.local import Range
from uoarm.testing import Collector, patience

Make = Callable[[str], RobotManager]

ROBOT = """
version: 1
bridges: {python: {}}
functions:
  scan:
    components:
      - {name: laser, bridge: python, output: {endpoint: ["tests.manager.typed_parts:scans"]}}
  stop:
    components:
      - name: stop
        bridge: python
        input: {endpoint: ["tests.manager.typed_parts:nearest"]}
        output: {endpoint: ["tests.manager.typed_parts:nearest"]}
  nearest:
    components:
      - {name: asked, bridge: python, service: {endpoint: ["tests.manager.typed_parts:nearest"]}}
"""


@attrs.frozen
class Header:
    frame: str
    number: int


@dataclass
class Scan:
    header: Header
    ranges: NDArray[np.float32]


class Loose(TypedDict):
    header: dict[str, str | int]
    ranges: list[float]


@dataclass
class Value:
    value: int


@dataclass
class Small:
    value: Annotated[int, Range(0, 5)]


SCAN = Scan(Header("laser", 7), np.array([4.5, 6.0], np.float32))


def test_messages_come_as_the_type_that_was_asked_for(make_robot: Make) -> None:
    with make_robot(ROBOT).request("scan", as_type=Scan) as connection:
        assert_type(connection, Connection[Scan])
        first = connection.get(patience())
        assert_type(first, Scan)
        assert isinstance(first, Scan)
        assert first.header == Header("laser", 0)
        assert first.ranges.dtype == np.float32
        numbers = []
        for scan in connection:
            assert_type(scan, Scan)
            numbers.append(scan.header.number)
        assert numbers == [1, 2]


def test_without_a_type_messages_are_plain(make_robot: Make) -> None:
    with make_robot(ROBOT).request("scan") as connection:
        message = connection.get(patience())
        assert_type(message, Any)
        assert message["header"] == {"frame": "laser", "number": 0}


def test_a_typed_dict_and_other_hints_are_types_too(make_robot: Make) -> None:
    robot = make_robot(ROBOT)
    with robot.request("scan", as_type=Loose) as connection:
        loose = connection.get(patience())
        assert_type(loose, Loose)
        assert loose["header"]["frame"] == "laser"
    with robot.request("stop", as_type=Value | None) as either:
        assert_type(either, Connection[Any])  # a union is no `type` to type checkers


def test_callbacks_get_the_type(make_robot: Make) -> None:
    collector = Collector()

    def take(scan: Scan) -> None:
        collector.deliver(scan.header.number)

    with make_robot(ROBOT).request("scan", as_type=Scan, on_message=take):
        assert collector.wait(3, patience()) == [0, 1, 2]


def _what_mypy_refuses(robot: RobotManager, take: Callable[[str], None]) -> None:
    robot.request("scan", as_type=Scan).subscribe(take)  # type: ignore[arg-type]
    robot.request("scan", as_type=Scan).get().speed  # type: ignore[attr-defined] # noqa: B018
    robot.call("nearest", SCAN, as_type=Value).header  # type: ignore[attr-defined] # noqa: B018


def test_objects_are_sent_and_come_back(make_robot: Make) -> None:
    with make_robot(ROBOT).request("stop", as_type=Value) as connection:
        for message in (
            SCAN,
            {"header": Header("laser", 1), "ranges": SCAN.ranges},
            {"header": {"frame": "laser", "number": np.int64(3)}, "ranges": [np.float32(4.0), 9]},
        ):
            connection.send(message)
            assert connection.get(patience()) == Value(4)


def test_services_take_and_give_objects(make_robot: Make) -> None:
    robot = make_robot(ROBOT)
    reply = robot.call("nearest", SCAN, as_type=Value)
    assert_type(reply, Value)
    assert reply == Value(4)
    assert robot.call("nearest", SCAN) == {"value": 4}


def test_an_object_that_is_not_what_it_says_is_refused_with_its_place(make_robot: Make) -> None:
    broken = Scan(Header("laser", "seven"), SCAN.ranges)  # type: ignore[arg-type]
    robot = make_robot(ROBOT)
    text = "this is no Scan: header.number: expected an integer, got 'seven'"
    with robot.request("stop") as connection, pytest.raises(MessageError, match=text):
        connection.send(broken)
    with pytest.raises(MessageError, match=text):
        robot.call("nearest", broken)


@pytest.mark.parametrize(
    ("hint", "text"),
    [
        (Small, r"(?s)function 'stop' may give messages that are no Small:\n  - value: .*plain"),
        (Scan, r"the fields? '?header"),
        (int, "may give messages that are no int"),
        (complex, "as_type of function 'stop': .*complex.* has no message structure"),
    ],
)
def test_a_type_that_does_not_fit_is_refused_before_anything_opens(
    make_robot: Make, hint: Any, text: str
) -> None:
    robot = make_robot(ROBOT)
    with pytest.raises(UsageError, match=text):
        robot.request("stop", as_type=hint)
    status = robot.status()
    assert not status.connections
    assert not status.components


def test_a_reply_that_may_be_something_else_is_refused_before_the_call(make_robot: Make) -> None:
    with pytest.raises(UsageError, match="the reply of 'nearest' may give messages that are no"):
        make_robot(ROBOT).call("nearest", SCAN, as_type=Small)


async def _asynchronous(robot: RobotManager) -> None:
    async with AsyncRobotManager(robot) as asynchronous:
        async with await asynchronous.request("scan", as_type=Scan) as connection:
            assert_type(connection, AsyncConnection[Scan])
            scan = await connection.get(patience())
            assert_type(scan, Scan)
            assert scan.header == Header("laser", 0)
        reply = await asynchronous.call("nearest", SCAN, as_type=Value)
        assert_type(reply, Value)
        assert reply == Value(4)


def test_the_asynchronous_twins_do_the_same(make_robot: Make) -> None:
    import asyncio

    asyncio.run(_asynchronous(make_robot(ROBOT)))
