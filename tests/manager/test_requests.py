"""Requests: opened whole or not at all, shared by count, killed from anywhere."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Callable

import pytest
from tests.manager import stage

from uoarm import (
    AsyncRobotManager,
    BridgeError,
    BridgeTimeoutError,
    ConnectionClosedError,
    MessageError,
    ResolutionError,
    RobotManager,
    StatusEvent,
    UsageError,
)
from uoarm.bridge import Bridge, Capabilities, Description, Source
from uoarm.config import loads
from uoarm.model import ConnectionState, Deliver, Endpoint, MessageStructure, StatusMap
from uoarm.testing import MemoryBridge, patience, wait

Make = Callable[[str], RobotManager]
HEAD = "version: 1\nbridges: {python: {}}\nfunctions:\n"


def source(name: str = "narrow") -> str:
    address = f'["tests.manager.stage:{name}"]'
    return (
        f"  {name}:\n    components:\n"
        f"      - {{name: {name}, bridge: python, output: {{endpoint: {address}}}}}\n"
    )


def step(function: str, target: str, feed: str | None, queue: str = "") -> str:
    address = f'["tests.manager.stage:{target}"]'
    fed = "" if feed is None else f"from: {feed}, "
    return (
        f"  {function}:\n    components:\n"
        f"      - name: {function}\n        bridge: python\n"
        f"        input: {{{fed}endpoint: {address}{queue}}}\n"
        f"        output: {{endpoint: {address}}}\n"
    )


def nothing_is_open(robot: RobotManager) -> bool:
    status = robot.status()
    channels = sum(bridge.open_channels for bridge in status.bridges)
    return not (status.components or status.connections or status.routes or channels)


def wait_for(robot: RobotManager, change: str) -> threading.Event:
    seen = threading.Event()

    def listen(event: StatusEvent) -> None:
        if event.subject.startswith("connection") and event.change == change:
            seen.set()

    robot.listen(listen)
    return seen


def test_messages_flow_from_the_source_to_the_application(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "take_broad", "narrow"))
    with robot.request("wanted", validate="always") as connection:
        for value in range(3):
            stage.script.put({"value": value})
        assert [connection.get(patience())["value"] for _ in range(3)] == [0, 1, 2]

        def delivered() -> dict[tuple[str, str], int]:
            return {
                (route.producer, route.consumer): route.delivered for route in robot.status().routes
            }

        ends = ("narrow.default", "wanted.default"), ("wanted.default", connection.id)
        wait(lambda: delivered() == dict.fromkeys(ends, 3))  # counted once it was taken
    assert nothing_is_open(robot)


def test_an_orderly_end_delivers_what_is_under_way_and_ends_the_iteration(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "take_broad", "narrow"))
    for value in range(5):
        stage.script.put({"value": value})
    stage.script.put(stage.END)
    with robot.request("wanted") as connection:
        assert [message["value"] for message in connection] == [0, 1, 2, 3, 4]
    assert nothing_is_open(robot)


def test_a_source_that_dies_fails_every_connection_that_needs_it(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "take_broad", "narrow"))
    failed = wait_for(robot, "failed")
    first, second = robot.request("wanted"), robot.request("narrow")
    stage.script.put(RuntimeError("the cable is out"))
    for connection in (first, second):
        with pytest.raises(ConnectionClosedError, match=r"narrow.*the cable is out"):
            connection.get(patience())
    assert failed.wait(patience())
    assert first.state is second.state is ConnectionState.FAILED
    assert nothing_is_open(robot)


def test_a_component_that_two_connections_need_is_opened_once(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "Counted", "narrow"))
    first = robot.request("wanted")
    second = robot.request("wanted")
    assert stage.built == ["counted"]
    stage.script.put({"value": 1})
    assert first.get(patience()) == second.get(patience()) == {"value": 1}
    first.kill()
    assert stage.closed == []
    stage.script.put({"value": 2})
    assert second.get(patience()) == {"value": 2}
    second.kill()
    assert stage.closed == ["counted"]
    assert nothing_is_open(robot)


def gives_up(step: str, ask: Callable[[float], object]) -> None:
    """Hold that a step is the one that is given up, where there is time for those before it."""
    limit, text = 0.1, ""
    while not re.search(step, text):
        assert limit < patience(), text
        with pytest.raises(BridgeTimeoutError) as caught:
            ask(limit)
        limit, text = 2 * limit, str(caught.value)


def test_killing_twice_and_from_a_callback_is_harmless(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "take_broad", "narrow"))
    ended = wait_for(robot, "closed")
    connection = robot.request("wanted")
    connection.subscribe(lambda _: connection.kill())
    stage.script.put({"value": 1})
    assert ended.wait(patience())
    connection.kill()
    assert nothing_is_open(robot)
    with pytest.raises(ConnectionClosedError):
        connection.send({"value": 1})


def test_an_error_while_opening_rolls_everything_back(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "Unbuildable", "narrow"))
    with pytest.raises(BridgeError, match="no such device"):
        robot.request("wanted")
    assert nothing_is_open(robot)


def test_a_bridge_that_hangs_while_opening_is_given_up_and_named(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "Slow", "narrow"))
    gives_up(r"opening .*wanted", lambda limit: robot.request("wanted", timeout=limit))
    assert not robot.status().connections
    with robot.request("narrow") as other:
        stage.script.put({"value": 5})
        assert other.get(patience()) == {"value": 5}


class Watching(MemoryBridge):
    """Keeps whether it opened in the thread of the test; says whether all of it is quick."""

    def __init__(self, name: str, *, is_quick: bool, links: bool = False) -> None:
        super().__init__(name)
        self.capabilities = Capabilities(link=links)
        self.said = is_quick
        self.here: list[bool] = []
        self._test = threading.current_thread()

    def _is_quick(self, endpoint: Endpoint) -> bool:
        return self.said

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Source:
        self.here.append(threading.current_thread() is self._test)
        return super()._open_source(endpoint, structure, deliver)


@pytest.mark.parametrize(
    ("is_quick", "links", "is_here"),
    [(True, False, True), (False, False, False), (True, True, False)],
)
def test_a_request_stays_in_its_thread_where_every_bridge_of_it_is_quick(
    *, is_quick: bool, links: bool, is_here: bool
) -> None:
    """A plan that has to be sought first is not, nor one of which two ends may be linked."""
    one, two = Watching("one", is_quick=True), Watching("two", is_quick=is_quick, links=links)
    one.emitter("eye", {"type": "integer"})
    two.loop("finder", {"type": "integer"})
    with RobotManager(loads(stage.FACE), bridges={"one": one, "two": two}) as robot:
        robot.request("face").kill()
        assert one.here + two.here == [False, False]
        robot.request("face").kill()
        assert one.here + two.here == [False, is_here, False, is_here]


def test_the_status_can_be_asked_for_before_anything_of_a_connection_is_open(
    make_robot: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = make_robot(HEAD + source())
    robot.resolve("narrow")
    get, seen = robot._bridges.get, list[ConnectionState]()

    def get_watched(name: str) -> Bridge:
        seen.extend(status.state for status in robot.status().connections)
        return get(name)

    monkeypatch.setattr(robot._bridges, "get", get_watched)
    with robot.request("narrow") as connection:
        assert seen == [ConnectionState.OPENING]
        assert connection.flush(0)


def test_a_component_that_hangs_in_send_stalls_no_other(make_robot: Make) -> None:
    queue = ", queue: {policy: latest}"
    robot = make_robot(HEAD + source() + step("wanted", "stuck", "narrow", queue))
    with robot.request("narrow") as direct, robot.request("wanted"):
        for value in range(50):
            stage.script.put({"value": value})
        assert [direct.get(patience())["value"] for _ in range(50)] == list(range(50))


def test_a_lie_is_counted_and_not_forwarded(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "take_broad", "narrow"))
    with robot.request("wanted", validate="always") as connection:
        for message in ({"value": 256}, {"valu": 1}, {"value": 1}):
            stage.script.put(message)
        assert connection.get(patience()) == {"value": 1}
        (route,) = [r for r in robot.status().routes if r.producer == "narrow.default"]
        assert route.invalid == 2
        assert dict(route.dropped) == {"invalid": 2}


def test_a_shared_edge_is_checked_as_the_strictest_of_its_users_wishes(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "take_broad", "narrow"))
    with robot.request("wanted", validate="off") as careless:
        stage.script.put({"value": 256})
        assert careless.get(patience()) == {"value": 256}
        with robot.request("wanted", validate="always") as careful:
            for value in (256, 1):
                stage.script.put({"value": value})
            assert careful.get(patience()) == {"value": 1}
        assert careless.get(patience()) == {"value": 1}
        stage.script.put({"value": 256})
        assert careless.get(patience()) == {"value": 256}


def test_the_application_feeds_an_input_and_learns_of_a_mismatch(make_robot: Make) -> None:
    robot = make_robot(HEAD + step("wanted", "take_broad", None))
    with robot.request("wanted", validate="sampled") as connection:
        connection.send({"value": -5})
        assert connection.get(patience()) == {"value": -5}
        with pytest.raises(MessageError, match=r"wanted\.default: value"):
            connection.send({"value": "five"})
        with pytest.raises(UsageError, match="no input 'other'"):
            connection.send({"value": 1}, port="other")


def test_a_service_is_called_checked_and_timed(make_robot: Make) -> None:
    text = (
        HEAD + "  greet:\n    components:\n"
        "      - {name: greet, bridge: python, "
        'service: {endpoint: ["tests.manager.stage:greet"]}}\n'
        "  hang:\n    components:\n"
        "      - {name: hang, bridge: python, "
        'service: {endpoint: ["tests.manager.stage:hang"]}}\n'
    )
    robot = make_robot(text)
    assert robot.call("greet", {"value": 3}) == {"value": -3}
    with pytest.raises(MessageError, match="value"):
        robot.call("greet", {"value": 300})
    gives_up("calling", lambda limit: robot.call("hang", {"value": 1}, timeout=limit))


def test_nothing_is_admitted_after_close(make_robot: Make) -> None:
    robot = make_robot(HEAD + source())
    connection = robot.request("narrow")
    robot.close()
    robot.close()
    assert connection.ended
    with pytest.raises(ConnectionClosedError):
        robot.request("narrow")


def test_an_unknown_function_is_named_with_a_guess(make_robot: Make) -> None:
    with pytest.raises(ResolutionError, match="did you mean 'narrow'"):
        make_robot(HEAD + source()).request("narow")


@pytest.mark.parametrize("name", ["narrow.none", "narrow.default.none"])
def test_of_an_output_that_there_is_not_no_plan_is_shown(make_robot: Make, name: str) -> None:
    robot = make_robot(HEAD + source())
    for ask in (robot.resolve, robot.request, robot.resolve):
        with pytest.raises(UsageError, match="say which output of 'narrow' is meant"):
            ask(name)
    assert robot.resolve("narrow.default").function == "narrow"


@pytest.mark.parametrize("name", [".x", "narrow.", "."])
def test_half_of_a_name_is_refused_whole(make_robot: Make, name: str) -> None:
    robot = make_robot(HEAD + source())
    for ask in (robot.resolve, robot.request):
        with pytest.raises(UsageError, match=re.escape(f"function.output, got {name!r}")):
            ask(name)


def test_events_come_numbered_and_in_order(make_robot: Make) -> None:
    robot = make_robot(HEAD + source())
    events: list[StatusEvent] = []
    closed = wait_for(robot, "closed")
    robot.listen(events.append)
    robot.request("narrow").kill()
    assert closed.wait(patience())
    robot.close()
    assert [event.number for event in events] == list(range(1, len(events) + 1))
    changes = [event.change for event in events if event.subject == "connection c1"]
    assert changes == ["opening", "running", "closed"]


def test_an_unknown_way_to_validate_is_refused_with_those_there_are(make_robot: Make) -> None:
    robot = make_robot(HEAD + source())
    with pytest.raises(
        UsageError, match="'allways': expected off, sampled or always; did you mean 'always'"
    ):
        robot.request("narrow", validate="allways")
    assert nothing_is_open(robot)


def test_asyncio_reads_waits_and_kills(make_robot: Make) -> None:
    robot = make_robot(HEAD + source() + step("wanted", "take_broad", "narrow"))

    async def play() -> tuple[list[int], StatusMap]:
        twin = AsyncRobotManager(robot)
        async with await twin.request("wanted") as connection:
            for value in range(10):
                stage.script.put({"value": value})
            stage.script.put(stage.END)
            values = [message["value"] async for message in connection]
        return values, twin.status()

    values, status = asyncio.run(play())
    assert values == list(range(10))
    assert not status.connections


class Mute(MemoryBridge):
    """A bridge of a framework that says nothing of its messages."""

    def _describe(self, endpoint: Endpoint) -> Description:
        super()._describe(endpoint)
        return Description()


@pytest.mark.parametrize(
    ("port", "name", "key"),
    [
        ("output: {endpoint: [eye]}", "output.default", "structure"),
        ("service: {endpoint: [ask]}", "request", "request"),
    ],
)
def test_a_structure_that_no_component_states_is_asked_for_by_its_key(
    port: str, name: str, key: str
) -> None:
    lab = Mute("lab", {})
    lab.emitter("eye", {})
    lab.service("ask", {}, {}, lambda item: item)
    text = (
        "version: 1\nbridges: {lab: {plugin: memory}}\nfunctions:\n"
        f"  see: {{components: [{{name: eye, bridge: lab, {port}}}]}}\n"
    )
    with (
        RobotManager(loads(text), bridges={"lab": lab}) as robot,
        pytest.raises(ResolutionError) as caught,
    ):
        robot.resolve("see")
    assert (
        f"the structure of '{name}' is not known to bridge 'lab': declare it in the "
        f"configuration, as `{key}` beside its `endpoint`"
    ) in str(caught.value)
