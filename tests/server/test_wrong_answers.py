"""A server that answers what the protocol does not have: the client says so, in its own errors."""

from __future__ import annotations

import asyncio
import inspect
import json
import re
from collections.abc import Awaitable, Callable, Iterable
from contextlib import suppress
from copy import deepcopy
from datetime import datetime, timezone
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosedError as Dropped
from websockets.exceptions import InvalidStatus
from websockets.http11 import Response

from uoarm._wire import TEXT_FORM
from uoarm.cli._remote import _shown_approval
from uoarm.client import RemoteRobot, RemoteStream
from uoarm.client._socket import ClientSocket, Received
from uoarm.errors import BridgeTimeoutError, ControlMessageError, UoarmError
from uoarm.model import find_trouble, format_status

HELLO = {"protocol": 1, "message_bytes": 4096, "time": 1.5, "manager": "ab"}
CHANGE = {
    "revision": 1, "differences": ["+ a"], "connections": [], "is_applied": True, "is_kept": False,
    "time": 1.0, "text": "revision 1",
}  # fmt: skip
ENVELOPE = {"ranges": [], "count": 1, "rate": None}
APPROVAL = {
    "approval": "a1", "phase": "pending", "requester": "x", "operation": "call", "function": "add",
    "port": "", "arguments": {}, "digest": "d", "envelope": ENVELOPE, "components": ["c"],
    "revision": 1, "preview": "", "left": 1.0,
}  # fmt: skip
RECORDING = {"recording": "r1", "state": "ended", "files": ["x.mcap"]}
PLAYER = {"bridge": "played", "functions": ["f"], "may_move": True, "cause": ""}
COMMAND = {"phase": "moving", "since": 0.1, "left": None, "dropped": [["late", 1]], "cause": ""}
CHANNEL = {
    "port": "input.default", "facts": [["peers", 1]], "lifetime": 1.0, "command": COMMAND,
    "lease": {"holder": {"id": "session 1", "role": ""}, "left": 0.5},
    "limits": [{"path": "x", "minimum": None, "maximum": 1.0, "rate": None}],
}  # fmt: skip
COMPONENT = {
    "name": "c", "health": "degraded", "cause": "", "last_error": "e", "channels": [CHANNEL],
}  # fmt: skip
ROUTE = {"producer": "c.default", "consumer": "c1", "age": 1.0, "refusal": "no", "dropped": []}
CONNECTION = {"id": "c1", "components": ["c"], "state": "running", "cause": "waits"}
STATUS: dict[str, Any] = {
    "version": 1, "time": 1.0, "held": 1.0, "own": [], "components": [COMPONENT],
    "routes": [ROUTE], "connections": [CONNECTION],
    "bridges": [{"name": "python", "facts": [["turns", 1]], "assigned": []}],
}  # fmt: skip
CHANGES = {
    "since": 1, "elapsed": 0.5, "version": 2, "components": {"changed": [COMPONENT], "gone": ["d"]},
    "routes": {"changed": [ROUTE], "gone": [["c.default", "c2"]]},
    "connections": {"gone": ["c2"]},
}  # fmt: skip
STRUCTURES = {
    "output.default": {"schema": {"type": "integer"}},
    "reply": {"schema": {"type": "integer"}},
}
PLAN = {"steps": [{"component": {"name": "c"}, "structures": STRUCTURES}]}
OUTCOME = {
    "function": "f", "component": "c", "port": "p", "stopped": True, "since": 0.1, "cause": "",
}  # fmt: skip
OPENED = {
    "connection": "c1", "inputs": ["default"], "warnings": [], "lifetimes": {"default": 1.0},
    "latched": False, "number": 0,
}  # fmt: skip
FUNCTION = {
    "name": "f", "description": "", "service": False, "outputs": ["default"], "inputs": [],
    "components": [{"name": "c", "bridge": "python", "plugin": "python", "priority": 0}],
}  # fmt: skip


async def look_at_status(robot: RemoteRobot) -> None:
    for _ in range(2):
        status = await robot.status()
        format_status(status)
        find_trouble(status, "c1")


async def look_at_functions(robot: RemoteRobot) -> None:
    for function in await robot.functions():
        for component in function["components"]:
            assert isinstance(component["name"] + function["name"], str)


async def look_at_plan(robot: RemoteRobot) -> None:
    found = await robot.resolve("f")
    assert all(step["component"]["name"] + found["text"] for step in found["plan"]["steps"])


async def look_at_approvals(robot: RemoteRobot) -> None:
    assert all(_shown_approval(approval) for approval in await robot.approvals())


async def look_at_revisions(robot: RemoteRobot) -> None:
    for revision in await robot.revisions():
        assert datetime.fromtimestamp(revision["time"], timezone.utc).isoformat()
        assert [*revision["differences"], *revision["connections"], revision["text"]]


async def use_stream(robot: RemoteRobot) -> None:
    stream: RemoteStream[Any] = await robot.request("f", as_type=int)
    await stream.send(1)
    await stream.stop()
    async with stream.hold(1, period=0.001):
        pass
    try:
        await stream.get(0.001)
    except TimeoutError:
        assert isinstance("".join(stream.trouble), str)
    assert isinstance(stream.connection + "".join((*stream.inputs, *stream.warnings)), str)
    await stream.kill()


async def watch_once(robot: RemoteRobot) -> None:
    async for event in robot.watch():
        assert str(event)
        return


QUESTIONS: dict[str, tuple[Callable[[RemoteRobot], Awaitable[Any]], list[Any]]] = {
    "functions": (look_at_functions, [{"functions": [FUNCTION]}]),
    "resolve": (look_at_plan, [{"plan": PLAN, "text": "f"}]),
    "status": (look_at_status, [STATUS, CHANGES]),
    "request": (use_stream, [{"plan": PLAN, "text": "f"}, OPENED, None, STATUS]),
    "call": (lambda robot: robot.call("f", 1, as_type=int), [{"plan": PLAN, "text": "f"}, 1]),
    "watch": (watch_once, [STATUS]),
    "configure": (lambda robot: robot.configure("version: 1"), [CHANGE]),
    "rollback": (lambda robot: robot.rollback(1), [CHANGE]),
    "revisions": (look_at_revisions, [{"revisions": [CHANGE]}]),
    "discover": (lambda robot: robot.discover(), [{"bridges": [{"bridge": "ros"}]}]),
    "stop_all": (
        lambda robot: robot.stop_all(), [{"stopped": True, "inputs": [OUTCOME], "text": "all"}],
    ),
    "release": (lambda robot: robot.release(), [None]),
    "approvals": (look_at_approvals, [{"approvals": [APPROVAL]}]),
    "approve": (lambda robot: robot.approve("a1"), [APPROVAL]),
    "record": (lambda robot: robot.record("f"), [RECORDING]),
    "recordings": (lambda robot: robot.recordings(), [{"recordings": [RECORDING]}]),
    "stop_recording": (lambda robot: robot.stop_recording("r1"), [RECORDING]),
    "dump_recording": (lambda robot: robot.dump_recording("r1"), [RECORDING]),
    "players": (lambda robot: robot.players(), [{"players": [PLAYER]}]),
    "playback": (lambda robot: robot.playback("played"), [PLAYER]),
    "ask": (lambda robot: robot.ask("Discover"), [{"bridges": []}]),
}  # fmt: skip
NOTICES = [
    {"op": "Status", "type": "hello", "jsonMessage": HELLO},
    {"op": "Data", "type": "c1", "x-number": 1, "jsonMessage": 1},
    {
        "op": "Status", "type": "change",
        "jsonMessage": {
            "number": 1, "time": 1.0, "subject": "bridge ros", "change": "lost", "cause": "",
            "function": "", "error_code": "",
        },
    },
    {"op": "Error", "type": "c1", "jsonMessage": {"code": "message", "text": "no form"}},
    {"op": "Reply", "id": "keep", "jsonMessage": {"key": "k", "seconds": 0.01}},
]  # fmt: skip
END = {"connection": "c1", "state": "closed", "cause": "killed", "number": 1}
NOTICES.append({"op": "Status", "type": "connection", "jsonMessage": END})


def test_every_question_of_the_client_is_tried() -> None:
    public = {name for name, _ in inspect.getmembers(RemoteRobot, inspect.isfunction)}
    others = {"drop", "ended", "running", "ask_in_thread"}  # ask the server nothing in this loop
    assert {name for name in public if not name.startswith("_")} - others == QUESTIONS.keys()


class Socket:
    """A connection to a server that answers with what it is given, after notices; then it drops."""

    paused = False

    def __init__(self, answers: list[Any], notices: list[Any]) -> None:
        self._answers, self._notices = list(answers), notices
        self._came: asyncio.Queue[Any] = asyncio.Queue()

    async def close(self, code: int = 1000) -> None: ...

    async def send(self, frame: bytes, text: bool) -> None:
        assert text
        asked = json.loads(frame)
        if asked["op"] == "Resume":
            return
        for notice in self._notices:
            self._came.put_nowait(notice)
        reply = {"op": "Reply", "id": asked["id"], "type": asked.get("type")}
        if asked["op"] not in {"Data", "Kill"} and (asked["op"] != "Stop" or "type" not in asked):
            if not self._answers:
                self._came.put_nowait(None)
                return
            reply["jsonMessage"] = self._answers.pop(0)
        self._came.put_nowait(reply)
        if asked.get("type") == "watch":
            self._came.put_nowait(None)

    send_whole = send

    async def hand_over(self, take: Callable[[Received], object]) -> None:
        while (message := await self._came.get()) is not None:
            take(json.dumps(message))
        raise Dropped(None, None)


async def ask(name: str, answers: list[Any], notices: list[Any]) -> None:
    """Ask one question of a server that answers so."""
    sockets = [Socket(answers, notices)]

    async def opening() -> ClientSocket:
        if not sockets:
            raise InvalidStatus(Response(401, "", Headers()))
        return cast("ClientSocket", sockets.pop())

    async with RemoteRobot(opening, TEXT_FORM).running(resume=True) as robot:
        await QUESTIONS[name][0](robot)


@pytest.mark.parametrize("name", QUESTIONS)
async def test_what_the_protocol_has_is_taken(name: str) -> None:
    await ask(name, QUESTIONS[name][1], NOTICES[:3])


LEAVES = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=3)
)
NAMES = st.sampled_from(["c", "c1", "default", "since", "changed", "gone", "type", "id", "op"])
ANYTHING = st.recursive(
    LEAVES | NAMES,
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(NAMES, inner, max_size=2),
    max_leaves=4,
)


def paths(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items: Iterable[tuple[Any, Any]] = enumerate(value) if isinstance(value, list) else ()
    items = value.items() if isinstance(value, dict) else items
    return [path, *(place for key, item in items for place in paths(item, (*path, key)))]


@st.composite
def spoilt(draw: st.DrawFn, right: list[Any]) -> list[Any]:
    """Messages of which one is wrong somewhere: a part is another, or missing."""
    messages = deepcopy(right)
    *outer, last = draw(st.sampled_from([path for path in paths(messages) if path]))
    place: Any = messages
    for key in outer:
        place = place[key]
    if draw(st.booleans()) and isinstance(place, dict):
        del place[last]
    else:
        place[last] = draw(ANYTHING)
    return messages


@pytest.mark.parametrize("name", QUESTIONS)
@given(data=st.data())
def test_a_wrong_answer_is_an_error_of_ours(name: str, data: st.DataObject) -> None:
    answers = data.draw(spoilt(QUESTIONS[name][1]))
    with suppress(UoarmError):
        asyncio.run(ask(name, answers, NOTICES[:1]))


@given(data=st.data())
def test_a_wrong_notice_is_an_error_of_ours(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["request", "watch", "functions"]))
    notices = data.draw(spoilt(NOTICES))
    with suppress(UoarmError):
        asyncio.run(ask(name, QUESTIONS[name][1], notices))


@pytest.mark.parametrize(
    ("answer", "what"),
    [
        (None, "expected object, got NoneType"),
        ({"functions": None}, "functions: expected list, got NoneType"),
        ({"functions": [{"name": 1}]}, "functions.0.name: expected text, got int"),
    ],
)
async def test_what_is_wrong_with_an_answer_is_said(answer: Any, what: str) -> None:
    text = f"the server's Reply to List: {what}"
    with pytest.raises(ControlMessageError, match=re.escape(text)):
        await ask("functions", [answer], [])


class Mute(Socket):
    """A connection to a server that is there and answers nothing, or reads nothing either."""

    def __init__(self, *, reads: bool) -> None:
        super().__init__([], [])
        self.paused = not reads

    async def send(self, frame: bytes, text: bool) -> None:
        assert frame, text
        if self.paused and b"Resume" not in frame:
            await asyncio.Event().wait()

    send_whole = send


@pytest.mark.parametrize("reads", [True, False])
async def test_a_server_that_answers_nothing_is_not_waited_for_without_end(reads: bool) -> None:
    async def opening() -> ClientSocket:
        return cast("ClientSocket", Mute(reads=reads))

    async with RemoteRobot(opening, TEXT_FORM, answer=0.01).running(resume=True) as robot:
        with pytest.raises(BridgeTimeoutError, match=r"has not answered List within 0\.01 s"):
            await robot.functions()
        with pytest.raises(BridgeTimeoutError, match=r"has not answered Call add within 0\.02 s"):
            await robot.call("add", 1, timeout=0.01)
        with pytest.raises(BridgeTimeoutError, match=r"has not answered Request f within 0\.03 s"):
            await robot.request("f", wait=0.02)
