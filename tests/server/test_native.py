"""The native protocol against a running server, in both forms."""

from __future__ import annotations

import asyncio
import json
import math
import threading
from typing import Any

import pytest
from tests.server import robot as components
from tests.server.conftest import Connect, Serve
from tests.server.robot import END, script
from tests.server.talk import Talk, eventually

from uoarm import RobotManager
from uoarm._wire._binary import write_binary
from uoarm.server import Limits
from uoarm.server.streams import ClientStreams, Feed, FeedRegistry
from uoarm.testing import patience

FORMS = pytest.mark.parametrize("binary", [False, True], ids=["json", "cbor"])


def connections(robot: RobotManager) -> int:
    return len(robot.status().connections)


@FORMS
def test_a_function_is_opened_received_and_killed(
    talk: Connect, robot: RobotManager, binary: bool
) -> None:
    client = talk(binary=binary)
    reply = client.ask("Request", "doubled")
    assert reply["components"] == ["numbers", "doubled"]
    script.put({"value": 1}, {"value": 2})
    connection = reply["connection"]
    assert client.data(connection, 2) == [{"value": 2}, {"value": 4}]
    assert client.ask("Kill", connection) is None
    eventually(lambda: connections(robot) == 0, "nothing is open")
    assert client.refused("Kill", connection)["code"] == "unknown"


def test_the_hello_names_version_and_limits(talk: Connect) -> None:
    hello = talk().hello
    assert hello["protocol"] == 1
    assert hello["role"] == "local"
    assert hello["depth"] == Limits().depth


@FORMS
def test_pictures_keep_their_octets(talk: Connect, binary: bool) -> None:
    client = talk(binary=binary)
    connection = client.open("picture")
    script.put({"width": 2, "data": bytes(range(256)) * 40})
    sent = client.data(connection, 1)[0]["data"]
    if not binary:
        import base64

        sent = base64.b64decode(sent)
    assert sent == bytes(range(256)) * 40


@FORMS
def test_messages_are_sent_and_come_back(talk: Connect, binary: bool) -> None:
    client = talk(binary=binary)
    connection = client.open("echo")
    identities = [client.send("Data", connection, {"value": value}) for value in range(100)]
    assert all(client.answer(identity)["op"] == "Reply" for identity in identities)
    assert [item["value"] for item in client.data(connection, 100)] == list(range(100))


@FORMS
@pytest.mark.parametrize("value", [300, -1, 1.5, "7x", None, [1]])
def test_a_message_of_another_structure_is_refused(talk: Connect, binary: bool, value: Any) -> None:
    client = talk(binary=binary)
    connection = client.open("echo")
    error = client.refused("Data", connection, {"value": value})
    assert error["code"] == "message"
    assert "value" in error["text"]


def test_a_message_to_an_input_that_is_not_there_names_those_that_are(talk: Connect) -> None:
    client = talk()
    connection = client.open("echo")
    error = client.refused("Data", f"{connection}.other", {"value": 1})
    assert error["code"] == "usage"
    assert "default" in error["text"]


@FORMS
def test_a_service_is_called(talk: Connect, binary: bool) -> None:
    client = talk(binary=binary)
    assert client.ask("Call", "add", {"a": 2, "b": 3}) == {"value": 5}


@FORMS
@pytest.mark.parametrize("number", [2**60, 2**63, 2**64, -(2**63) - 1, 10**30])
def test_whole_numbers_keep_their_digits_there_and_back(
    talk: Connect, binary: bool, number: int
) -> None:
    client = talk(binary=binary)
    expected = number + 1 if binary else str(number + 1)
    assert client.ask("Call", "add", {"a": number, "b": 1}) == {"value": expected}
    if not binary:
        assert client.ask("Call", "add", {"a": str(number), "b": 1}) == {"value": expected}


def test_a_name_that_is_given_twice_is_refused_in_both_forms(talk: Connect) -> None:
    fields = {"op": "Call", "id": "1", "type": "add", "jsonMessage": {"a": 1, "b": 2}}
    client = talk()
    client.raw(json.dumps(fields).replace('"b"', '"a"'))
    assert "given twice" in client.answer(None)["jsonMessage"]["text"]
    client = talk(binary=True)
    client.raw(write_binary(fields).replace(b"ab\x02", b"aa\x02"))
    assert "uplicate" in client.answer(None)["jsonMessage"]["text"]


def test_what_a_service_raises_is_reported(talk: Connect) -> None:
    error = talk().refused("Call", "broken", {"value": 9})
    assert error["code"] == "bridge"
    assert "cannot do 9" in error["text"]


def test_a_service_that_quits_is_reported_and_ends_nothing(talk: Connect) -> None:
    client = talk()
    for number, kind in enumerate(
        ["SystemExit", "CancelledError", "KeyboardInterrupt", "GeneratorExit"]
    ):
        error = client.refused("Call", "quits", {"value": number})
        assert error["code"] == "bridge"
        assert kind in error["text"]
    assert client.ask("Call", "add", {"a": 2, "b": 3}) == {"value": 5}


def test_a_slow_call_holds_up_nothing(talk: Connect) -> None:
    client = talk()
    slow = client.send("Call", "slow", {"value": 1})
    assert client.ask("Call", "add", {"a": 1, "b": 1}) == {"value": 2}
    script.gate.set()
    assert client.answer(slow)["jsonMessage"] == {"value": 1}


def test_a_call_that_takes_too_long_fails_alone(talk: Connect) -> None:
    client = talk()
    late = client.send("Call", "slow", {"value": 1}, **{"x-timeout": 0.05})
    assert client.answer(late)["jsonMessage"]["code"] == "timeout"
    assert client.ask("Call", "add", {"a": 1, "b": 1}) == {"value": 2}


def test_functions_are_listed(talk: Connect) -> None:
    functions = {function["name"]: function for function in talk().ask("List")["functions"]}
    assert functions["numbers"]["description"] == "what a test plays"
    assert functions["numbers"]["outputs"] == ["default"]
    assert functions["echo"]["inputs"] == ["default"]
    assert functions["add"]["service"] is True
    assert functions["doubled"]["inputs"] == []


def test_a_plan_is_explained_without_opening_anything(talk: Connect, robot: RobotManager) -> None:
    client = talk()
    plan = client.ask("Resolve", "picture")
    structure = plan["plan"]["steps"][0]["structures"]["output.default"]["schema"]
    assert structure["properties"]["data"]["contentEncoding"] == "base64"
    assert "picture" in plan["text"]
    assert connections(robot) == 0
    binary = talk(binary=True).ask("Resolve", "picture")
    structure = binary["plan"]["steps"][0]["structures"]["output.default"]["schema"]
    assert structure["properties"]["data"]["x-octets"] is True


@pytest.mark.parametrize("op", ["Resolve", "Request", "Call"])
def test_what_cannot_be_resolved_is_explained(talk: Connect, op: str) -> None:
    error = talk().refused(op, "missing")
    assert error["code"] == "resolution"
    assert "nothing" in error["text"]


def test_an_unknown_name(talk: Connect) -> None:
    assert talk().refused("Request", "numbrs")["code"] == "resolution"
    for op in ("Request", "Call", "Kill", "Data", "Resolve"):
        assert len(talk().refused(op, "n" * 50_000)["text"]) < 2_500


@FORMS
def test_every_wrong_message_has_its_error(talk: Connect, binary: bool) -> None:
    client = talk(binary=binary)
    assert client.refused("Fly", "numbers")["code"] == "unreadable"
    assert client.refused("Data", "c1")["code"] == "unreadable"
    client.raw(b"\xff\xff" if binary else "42")
    assert client.answer(None)["jsonMessage"]["code"] == "unreadable"
    client.raw("{}" if binary else b"{}")
    assert "frame" in client.answer(None)["jsonMessage"]["text"]
    assert client.refused("Data", "c99", {"value": 1})["code"] == "unknown"
    assert client.ask("List")


@pytest.mark.parametrize(
    ("op", "kind", "message", "field"),
    [
        ("Request", "numbers", {"wait": math.nan}, "jsonMessage.wait"),
        ("Request", "numbers", {"every": math.nan}, "jsonMessage.every"),
        ("Request", "numbers", {"queue": {"age": math.nan}}, "jsonMessage.queue.age"),
        ("Record", "", {"functions": ["numbers"], "ring": math.nan}, "jsonMessage.ring"),
        ("Call", "add", None, "x-timeout"),
    ],
)
def test_a_bounded_number_is_one(
    talk: Connect, op: str, kind: str, message: object, field: str
) -> None:
    more = {"x-timeout": math.nan} if field == "x-timeout" else {}
    error = talk(binary=True).refused(op, kind, message, **more)
    assert error["code"] == "unreadable"
    assert error["text"] == f"{op}: {field}: nan is not of type 'number'"


def test_asking_twice_for_one_function_is_reported(talk: Connect) -> None:
    client = talk()
    client.open("numbers")
    assert client.refused("Request", "numbers")["code"] == "usage"


def test_asking_again_just_as_the_function_ends_is_reported(
    talk: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both requests join one feed. It must not be handed out again behind its end."""
    join = FeedRegistry.join
    joined: list[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = []

    async def join_late(registry: FeedRegistry, *asked: Any) -> Feed:
        feed = await join(registry, *asked)
        joined.append((asyncio.get_running_loop(), asyncio.Event()))
        if len(joined) > 1:
            await joined[-1][1].wait()
        return feed

    monkeypatch.setattr(FeedRegistry, "join", join_late)
    client = talk()
    client.open("numbers")
    again = client.send("Request", "numbers")
    eventually(lambda: len(joined) > 1, "the second request has joined")
    script.put(END)
    client.next("connection")
    loop, gate = joined[-1]
    loop.call_soon_threadsafe(gate.set)
    assert client.answer(again)["jsonMessage"]["code"] == "usage"


def test_one_connection_serves_all_clients_and_the_last_one_closes_it(
    talk: Connect, robot: RobotManager
) -> None:
    clients = [talk(), talk(), talk(binary=True)]
    names = {client.open("numbers") for client in clients}
    assert len(names) == 1
    assert connections(robot) == 1
    connection = names.pop()
    script.put({"value": 2**60})
    assert clients[0].data(connection, 1) == [{"value": str(2**60)}]
    assert clients[2].data(connection, 1) == [{"value": 2**60}]
    clients[0].ask("Kill", connection)
    clients[1].close()
    script.put({"value": 5})
    assert clients[2].data(connection, 1) == [{"value": 5}]
    clients[2].close()
    eventually(lambda: connections(robot) == 0, "the last client's connection is closed")


def test_the_end_of_a_source_is_reported_after_its_last_message(talk: Connect) -> None:
    client = talk()
    connection = client.open("numbers")
    script.put({"value": 1}, END)
    assert client.data(connection, 1) == [{"value": 1}]
    report = client.next("connection")["jsonMessage"]
    assert report["connection"] == connection
    assert report["state"] == "closed"
    assert "finished" in report["cause"]


def test_the_death_of_a_component_is_reported_with_its_cause(talk: Connect) -> None:
    client = talk()
    connection = client.open("numbers")
    script.put(RuntimeError("lens fell off"))
    report = client.next("connection")["jsonMessage"]
    assert (report["connection"], report["state"]) == (connection, "failed")
    assert "lens fell off" in report["cause"]
    script.reset()
    assert client.open("numbers") != connection


def test_changes_are_reported_to_watchers(talk: Connect) -> None:
    watcher, other = talk(), talk()
    assert watcher.ask("Status", "watch")["connections"] == []
    connection = other.open("numbers")
    reports = [watcher.next("change")["jsonMessage"] for _ in range(2)]
    assert [report["subject"] for report in reports] == [f"connection {connection}"] * 2
    assert [report["change"] for report in reports] == ["opening", "running"]
    watcher.ask("Status", "unwatch")
    other.ask("Kill", connection)
    status = watcher.ask("Status")
    assert [bridge["name"] for bridge in status["bridges"]] in ([], ["python"])


def test_the_status_has_the_client_s_own_counters(talk: Connect) -> None:
    client = talk()
    connection = client.open("numbers")
    script.put({"value": 1})
    client.data(connection, 1)
    status = client.ask("Status")
    own = status["own"][0]
    assert (own["connection"], own["received"], own["sent"]) == (connection, 1, 1)
    assert status["components"][0]["name"] == "numbers"
    assert status["routes"][0]["received"] == 1


def test_a_client_can_ask_for_fewer_messages(talk: Connect) -> None:
    client = talk()
    connection = client.open("numbers", every=3600)
    script.put(*({"value": value} for value in range(50)))
    eventually(
        lambda: client.ask("Status")["own"][0]["received"] == 50, "every message was received"
    )
    assert client.data(connection, 1) == [{"value": 0}]
    assert client.ask("Status")["own"][0]["left_out"] == 49


def test_a_message_without_a_form_is_a_reported_gap(talk: Connect) -> None:
    client = talk()
    connection = client.open("numbers")
    script.put({"value": 1}, {"value": object()}, {"value": 3})
    assert [client.next(connection)["x-number"] for _ in range(2)] == [1, 3]
    error = client.answer(None)
    assert error["type"] == connection
    assert error["jsonMessage"]["code"] == "message"


def test_who_sends_waits_for_those_who_were_to_receive_before(
    talk: Connect, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What comes of a message would be lost to a client that asked for it before it was sent."""
    steps: list[tuple[str, bool]] = []
    begun, gate = threading.Event(), threading.Event()
    request = robot.request

    def slow(name: str, **options: Any) -> Any:
        receives = options["on_message"].__name__ == "take"
        steps.append(("begins", receives))
        begun.set()
        if receives:
            assert gate.wait(patience())
        made = request(name, **options)
        steps.append(("is open", receives))
        return made

    monkeypatch.setattr(robot, "request", slow)
    receiver, sender = talk(), talk()
    receiving = receiver.send("Request", "echo")
    assert begun.wait(patience())
    sending = sender.send("Request", "echo", {"receive": False})
    for _ in range(20):  # in turn with what the server does for it
        sender.ask("List")
    gate.set()
    for client, asked in ((receiver, receiving), (sender, sending)):
        assert client.answer(asked)["op"] == "Reply"
    assert steps == [(step, who) for who in (True, False) for step in ("begins", "is open")]


def test_kill_waits_for_what_was_sent_before_it(talk: Connect) -> None:
    listener, client = talk(), talk()
    connection = listener.open("echo")
    own = client.open("echo", receive=False)
    assert own != connection
    for value in range(50):
        client.send("Data", own, {"value": value})
    client.ask("Kill", own)
    assert [item["value"] for item in listener.data(connection, 50)] == list(range(50))


def test_a_request_waits_for_the_kill_before_it(talk: Connect) -> None:
    client = talk()
    first = client.open("hang", receive=False)
    client.ask("Data", first, {"text": ""})  # is with the component, so that the kill has to wait
    killed = client.send("Kill", first)
    again = client.send("Request", "hang", {"receive": False})
    client.ask("List")  # by then the request was looked at
    script.gate.set()
    assert client.answer(killed)["op"] == "Reply"
    opened = client.answer(again)
    assert opened["op"] == "Reply", opened
    client.ask("Data", opened["jsonMessage"]["connection"], {"text": ""})


def test_requests_under_way_are_limited(serve: Serve) -> None:
    server = serve(Limits(calls=2))
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as client:
        waiting = [client.send("Call", "slow", {"value": 1}) for _ in range(2)]
        assert client.refused("Call", "slow", {"value": 1})["code"] == "limit"
        script.gate.set()
        assert all(client.answer(name)["op"] == "Reply" for name in waiting)
        assert client.ask("Call", "add", {"a": 1, "b": 1})


def test_workers_of_all_clients_are_limited(serve: Serve) -> None:
    server = serve(Limits(workers=1))
    url = f"ws://127.0.0.1:{server.ports[0]}/"
    with Talk(url) as one, Talk(url) as two:
        one.ask("Resolve", "slow")
        waiting = one.send("Call", "slow", {"value": 1})
        one.ask("List")
        eventually(
            lambda: two.answer(two.send("Call", "parrot", {"text": ""}))["op"] == "Error",
            "the worker is taken",
        )
        assert two.refused("Call", "add", {"a": 1, "b": 1})["code"] == "busy"
        script.gate.set()
        assert one.answer(waiting)["op"] == "Reply"


def test_a_function_that_cannot_be_had_is_waited_for_where_asked(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = serve()
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as client:
        assert client.refused("Request", "missing")["code"] == "resolution"
        waiting = client.send("Request", "missing", {"wait": 600})
        reports = client.next("waiting")
        assert (reports["id"], reports["jsonMessage"]["function"]) == (waiting, "missing")
        assert "nothing" in reports["jsonMessage"]["cause"]
        monkeypatch.setattr(components, "nothing", components.numbers, raising=False)
        opened = client.answer(waiting)
        assert (opened["op"], opened["jsonMessage"]["function"]) == ("Reply", "missing")


def test_waiting_ends_with_the_cause(serve: Serve) -> None:
    server = serve()
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as client:
        refused = client.refused("Request", "missing", {"wait": 0.001})
        assert refused["code"] == "timeout"
        assert "could not be had within 0.001 s: " in refused["text"]


def test_functions_that_are_opened_wait_for_threads_and_are_no_calls(serve: Serve) -> None:
    server = serve(Limits(calls=1, workers=1, openings=1))
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as client:
        names = ("numbers", "picture", "doubled", "echo")
        asked = [client.send("Request", name) for name in names]
        assert [client.answer(text)["op"] for text in asked] == ["Reply"] * len(names)


def test_open_connections_are_limited(serve: Serve) -> None:
    server = serve(Limits(streams=1))
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as client:
        connection = client.open("numbers")
        assert client.refused("Request", "echo")["code"] == "limit"
        client.ask("Kill", connection)
        client.open("echo")


def test_what_came_by_each_connection_is_written_beside_the_loop(
    talk: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The counters of a thousand took the loop 4 ms for each Status."""
    threads: list[str] = []
    counters = ClientStreams.counters

    def noted(streams: ClientStreams) -> list[dict[str, object]]:
        threads.append(threading.current_thread().name)
        return counters(streams)

    monkeypatch.setattr(ClientStreams, "counters", noted)
    talk().ask("Status", "watch")
    assert threads == ["uoarm-serve-view"]
