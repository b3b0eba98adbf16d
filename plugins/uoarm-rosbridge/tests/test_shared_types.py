"""Topics between clients whose types are known: what does not fit goes nowhere and is reported."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros import Ros, url
from tests.server.talk import eventually  # type: ignore[import-not-found]
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._publication import SharedPublication
from uoarm_rosbridge._types import read_arguments

from uoarm import RobotManager
from uoarm.bridge import BridgeType, Registry
from uoarm.config import loads
from uoarm.errors import MessageError, UoarmError
from uoarm.model import Message, MessageStructure, Options
from uoarm.server import Limits, ServerOptions, serve_in_thread
from uoarm.server.front_end import Backend, Client, Envelope
from uoarm.testing import MemoryBridge, patience


def record(name: str, **fields: object) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": fields,
        "required": list(fields),
        "additionalProperties": False,
        "x-native-type": name,
    }


NUMBER = {"type": "number"}
VECTOR = record("geo/msg/Vector", x=NUMBER, y=NUMBER)
TIME = record("builtin_interfaces/msg/Time", sec={"type": "integer"}, nanosec={"type": "integer"})
TWIST = record(
    "geo/msg/Twist",
    linear=VECTOR,
    octets={"type": "array", "items": {"type": "integer"}, "x-octets": True},
    stamp=TIME,
)
PATH = record("geo/msg/Path", points={"type": "array", "items": VECTOR})
STRUCTURES = {
    "geo/msg/Twist": MessageStructure(TWIST, native_type="geo/msg/Twist"),
    "geo/msg/Path": MessageStructure(PATH, native_type="geo/msg/Path"),
}
WHOLE = {"linear": {"x": 1, "y": 2.5}, "octets": "AAEC", "stamp": {"sec": 1, "nanosec": 2}}
FLOAT = "number or NaN, Infinity, -Infinity"
LONG = "A" * 16_384


class Types:
    """Knows types, once it may."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.may_answer = threading.Event()
        self.may_answer.set()
        self.fails = False

    def find(self, name: str, options: Options) -> MessageStructure | None:
        del options
        self.asked.append(name)
        self.may_answer.wait(patience())
        if self.fails:
            raise RuntimeError("broken")
        return STRUCTURES.get(name)


@pytest.fixture
def types() -> Iterator[Types]:
    made = Types()
    yield made
    made.may_answer.set()


@pytest.fixture
def pair(types: Types) -> Iterator[tuple[Ros, Ros]]:
    """Who publishes and who listens, before a robot that knows types."""
    registry = Registry([])

    def make(name: str, options: Options) -> MemoryBridge:
        return MemoryBridge(name, options)

    registry.add(BridgeType("named", "", make, structure_of_type=types.find, contract=2))
    robot = loads("{version: 1, bridges: {named: {}}, functions: {}}", types=registry.types)
    with ExitStack() as stack:
        manager = stack.enter_context(RobotManager(robot, registry=registry))
        settings = ServerOptions(port=0, limits=Limits())
        server = stack.enter_context(serve_in_thread(manager, settings))
        speaker, listener = (stack.enter_context(Ros(url(server))) for _ in range(2))
        yield speaker, listener


def listen(listener: Ros) -> None:
    listener.send(op="subscribe", topic="/talk")
    listener.call("/rosapi/has_param", {"name": "x"})  # what came before is done


def publish(speaker: Ros, *messages: object) -> None:
    for number, message in enumerate(messages):
        speaker.send(op="publish", topic="/talk", id=str(number), msg=message)


def test_what_is_left_out_has_the_value_of_ros_and_octets_are_octets(
    pair: tuple[Ros, Ros],
) -> None:
    speaker, listener = pair
    listen(listener)
    speaker.send(op="advertise", topic="/talk", type="geo/msg/Twist")
    publish(speaker, {}, {"linear": {"x": 1}}, WHOLE)
    zero = {"sec": 0, "nanosec": 0}
    assert listener.messages(3) == [
        {"linear": {"x": 0.0, "y": 0.0}, "octets": [], "stamp": zero},
        {"linear": {"x": 1, "y": 0.0}, "octets": [], "stamp": zero},
        WHOLE,
    ]


def test_the_count_in_a_header_of_ros_1_is_left_out() -> None:
    header = MessageStructure(
        record("std_msgs/msg/Header", stamp=TIME, frame_id={"type": "string"})
    )
    sent = {"seq": 3, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "base"}
    read = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base"}
    assert read_arguments(header, sent) == read


def test_the_times_of_ros_1_are_understood(pair: tuple[Ros, Ros]) -> None:
    speaker, listener = pair
    listen(listener)
    speaker.send(op="advertise", topic="/talk", type="geo/msg/Twist")
    publish(speaker, {**WHOLE, "stamp": {"secs": 3, "nsecs": 4}})
    assert listener.messages(1)[0]["stamp"] == {"sec": 3, "nanosec": 4}


@pytest.mark.parametrize(
    ("message", "received"),
    [
        ({"linear": {"x": "fast"}}, f"$.linear.x: expected a {FLOAT}, got 'fast'"),
        ({"linear": {"x": None}}, "linear.x: expected a number, got nothing"),
        ({"linear": 5}, "linear: expected a mapping, got 5"),
        ({"other": 1}, "other: unknown field (known fields: linear, octets, stamp)"),
    ],
)  # fmt: skip
def test_what_does_not_fit_goes_nowhere_and_is_reported(
    pair: tuple[Ros, Ros], message: object, received: str
) -> None:
    speaker, listener = pair
    listen(listener)
    speaker.send(op="advertise", topic="/talk", type="geo/msg/Twist")
    publish(speaker, message, WHOLE)
    status = speaker.receive()
    assert (status["op"], status["level"], status["id"]) == ("status", "error", "0")
    assert status["msg"] == f"message: /talk: {received} (UOA-501)"
    assert listener.messages(1) == [WHOLE]


def test_an_unknown_type_is_not_checked(pair: tuple[Ros, Ros], types: Types) -> None:
    speaker, listener = pair
    listen(listener)
    speaker.send(op="advertise", topic="/talk", type="other/msg/Thing")
    publish(speaker, {"linear": "as it is"})
    assert listener.messages(1) == [{"linear": "as it is"}]
    assert types.asked == ["other/msg/Thing"]


def test_a_publisher_that_states_no_type_has_that_of_the_topic(pair: tuple[Ros, Ros]) -> None:
    speaker, listener = pair
    listen(listener)
    listener.send(op="advertise", topic="/talk", type="geo/msg/Twist")
    listener.call("/rosapi/has_param", {"name": "x"})
    publish(speaker, {"linear": 5})
    assert speaker.receive()["msg"] == "message: /talk: linear: expected a mapping, got 5 (UOA-501)"


def test_a_plugin_that_fails_checks_nothing(
    pair: tuple[Ros, Ros], types: Types, caplog: pytest.LogCaptureFixture
) -> None:
    types.fails = True
    speaker, listener = pair
    listen(listener)
    speaker.send(op="advertise", topic="/talk", type="geo/msg/Twist")
    publish(speaker, {"linear": 5})
    assert listener.messages(1) == [{"linear": 5}]
    assert "messages of type 'geo/msg/Twist' are not checked" in caplog.text
    assert "RuntimeError: broken" in caplog.text


def test_messages_wait_for_the_type_in_their_order_and_the_server_does_not(
    pair: tuple[Ros, Ros], types: Types
) -> None:
    types.may_answer.clear()
    speaker, listener = pair
    listen(listener)
    speaker.send(op="advertise", topic="/talk", type="geo/msg/Twist")
    publish(speaker, WHOLE, {"linear": 5}, {**WHOLE, "octets": LONG}, WHOLE)
    speaker.send(op="unadvertise", topic="/talk")
    # Both are answered while the plugin is asked, so that the loop does not wait for it.
    assert speaker.call("/rosapi/topics")["topics"]
    listener.call("/rosapi/has_param", {"name": "x"})
    types.may_answer.set()
    reports = listener.messages(3)
    assert [len(report["octets"]) for report in reports] == [4, len(LONG), 4]
    assert speaker.receive()["msg"] == "message: /talk: linear: expected a mapping, got 5 (UOA-501)"
    listener.send(op="unsubscribe", topic="/talk")
    eventually(lambda: "/talk" not in speaker.call("/rosapi/topics")["topics"], "the topic is gone")
    assert types.asked == ["geo/msg/Twist"]


def test_a_client_that_goes_while_the_type_is_looked_for_leaves_nothing(
    pair: tuple[Ros, Ros], types: Types
) -> None:
    types.may_answer.clear()
    speaker, listener = pair
    speaker.send(op="advertise", topic="/talk", type="geo/msg/Twist")
    publish(speaker, WHOLE)
    eventually(lambda: types.asked, "the plugin is asked")
    speaker.__exit__()
    eventually(
        lambda: "/talk" not in listener.call("/rosapi/topics")["topics"], "the topic is gone"
    )


def test_little_text_does_not_become_a_large_message() -> None:
    with pytest.raises(MessageError, match="more than 100,000 values are left out"):
        read_arguments(STRUCTURES["geo/msg/Path"], {"points": [{}] * 50_001})
    read_arguments(STRUCTURES["geo/msg/Path"], {"points": [{}] * 50_000})


class World:
    """One publication before a backend that answers when it likes."""

    def __init__(self, pauses: Iterator[int]) -> None:
        self._pauses = pauses
        self.limits = Limits()
        self.account = self
        self.octets = 0
        self.got: list[Message] = []

    async def structure_of_type(self, name: str) -> MessageStructure | None:
        await self._pause()
        return STRUCTURES.get(name)

    async def in_worker(self, action: Callable[[], Any]) -> Any:
        await self._pause()
        return action()

    def charge(self, kind: object, octets: int) -> Any:
        del kind
        self.octets += octets
        return _Charge(self, octets)

    def offer(self, envelope: Envelope) -> None:
        self.got.append(envelope.message)

    async def _pause(self) -> None:
        for _ in range(next(self._pauses, 0)):
            await asyncio.sleep(0)


class _Charge:
    def __init__(self, world: World, octets: int) -> None:
        self._world, self.octets = world, octets

    def release(self) -> None:
        self._world.octets -= self.octets
        self.octets = 0


steps = st.lists(
    st.tuples(
        st.sampled_from(["fits", "does not"]),
        st.sampled_from([100, 9_000, 700_000]),
        st.integers(0, 3),
    ),
    max_size=30,
)


@given(steps, st.lists(st.integers(0, 5)), st.sampled_from(["geo/msg/Twist", "other", ""]))
def test_each_message_goes_on_once_in_its_order_or_is_reported(
    steps: list[tuple[str, int, int]], pauses: list[int], kind: str
) -> None:
    world = World(iter(pauses))
    reports: list[int] = []

    async def act() -> None:
        hub = Hub()
        hub.listen("/talk", "", cast("Any", world), world)
        backend, client = cast("Backend", world), cast("Client", world)
        publication = SharedPublication("/talk", kind, hub, backend, client)
        for number, (fits, octets, turns) in enumerate(steps):
            message = {"linear": {"x": number, "y": 0 if fits == "fits" else None}}

            def done(error: BaseException | None, number: int = number) -> None:
                if error is not None:
                    reports.append(number)

            try:
                publication.publish(message, done, octets, None)
            except UoarmError:
                reports.append(number)
            for _ in range(turns):
                await asyncio.sleep(0)
        publication.close()
        await asyncio.gather(*(asyncio.all_tasks() - {asyncio.current_task()}))
        assert not hub.type_of("/talk")

    asyncio.run(act())
    wrong = [i for i, step in enumerate(steps) if step[0] != "fits" and kind == "geo/msg/Twist"]
    assert reports == wrong
    assert [cast("Any", item)["linear"]["x"] for item in world.got] == [
        number for number in range(len(steps)) if number not in wrong
    ]
    assert world.octets == 0
