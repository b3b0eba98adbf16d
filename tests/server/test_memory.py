"""What the server holds for its clients is counted in octets, bounded, and let go with them."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.server.conftest import Connect, Serve
from tests.server.robot import script
from tests.server.serving import url
from tests.server.talk import Talk, eventually

from uoarm import RobotManager
from uoarm._control import Connection
from uoarm._wire import TEXT_FORM
from uoarm.model import MessageStructure
from uoarm.server import Limits, Server
from uoarm.server._failures import BusyError, LimitError
from uoarm.server.streams._input_sender import InputSender, read_message
from uoarm.server.streams._memory import Account, Charge, MemoryUse, ServerMemory
from uoarm.server.streams._workers import LoopMailbox, Workers
from uoarm.testing import patience

MANY = 10**9


steps = st.lists(
    st.tuples(
        st.sampled_from(["charge", "hold", "resize", "release", "leave"]),
        st.integers(0, 3),
        st.integers(0, 60),
    ),
    max_size=60,
)


@given(steps)
def test_whatever_is_charged_is_released_with_the_client(plan: list[tuple[str, int, int]]) -> None:
    memory = ServerMemory(most=100, most_each=50)
    accounts: dict[int, Account] = {}
    made: dict[int, list[Charge]] = {}
    gone: list[Charge] = []
    for step, who, octets in plan:
        account = accounts.get(who) or accounts.setdefault(who, memory.open())
        charges = made.setdefault(who, [])
        if step == "charge":
            before, room = account.held, account.has_room(octets)
            try:
                charges.append(account.charge(MemoryUse.ASKED, octets))
                assert room
            except (LimitError, BusyError):
                assert not room
                assert account.held == before
        elif step == "hold":
            charges.append(account.hold(MemoryUse.DATA))
        elif step == "resize" and charges:
            one = charges[octets % len(charges)]
            one.resize(min(octets, one.octets))
        elif step == "release" and charges:
            charges[octets % len(charges)].release()
        elif step == "leave":
            account.close()
            gone += made.pop(who)
            del accounts[who]
        for late in gone:  # what still runs for a client that has gone
            late.resize(octets)
        assert memory.held == sum(account.held for account in accounts.values())
        assert memory.held == sum(memory.kinds.values())
        assert all(
            account.held == sum(charge.octets for charge in made.get(who, ()))
            for who, account in accounts.items()
        )
        assert all(account.held <= 50 for account in accounts.values())
        assert memory.held <= 200
    for account in accounts.values():
        account.close()
    assert memory.held == 0


def test_a_client_below_its_share_is_not_refused_because_of_others() -> None:
    memory = ServerMemory(most=100, most_each=80)
    one, other = memory.open(), memory.open()
    one.charge(MemoryUse.SENDING, 80)
    with pytest.raises(LimitError, match="one client may have"):
        one.charge(MemoryUse.SENDING, 1)
    other.charge(MemoryUse.SENDING, 50)
    with pytest.raises(BusyError, match="ask again later"):
        other.charge(MemoryUse.SENDING, 1)


def test_data_for_a_component_that_hangs_is_bounded_and_goes_with_its_client(
    serve: Serve, robot: RobotManager
) -> None:
    server = serve(Limits(memory_bytes=2_000_000))
    with Talk(url(server)) as client:
        connection = client.open("hang")
        sent = [client.send("Data", connection, {"text": "x" * 300_000}) for _ in range(30)]
        answers = [client.answer(name) for name in sent]
        refused = [answer["jsonMessage"]["code"] for answer in answers if answer["op"] == "Error"]
        assert set(refused) <= {"limit"}
    eventually(lambda: server.held_octets == 0, "everything was let go")
    eventually(lambda: not robot.status().connections, "it is closed")


def sending(
    connection: Any, workers: Workers, account: Account, command: object = None
) -> InputSender:
    structure = MessageStructure(schema={"type": "object"})
    endpoint = SimpleNamespace(command=command)
    component = SimpleNamespace(
        name="it",
        function="it",
        inputs=[SimpleNamespace(name="in", source=None, endpoint=endpoint)],
    )
    connection.id, connection.cause = "c1", ""
    connection.plan = SimpleNamespace(
        provider=SimpleNamespace(component=component, structures={"input.in": structure})
    )
    return InputSender(
        cast("Connection", connection),
        partial(read_message, TEXT_FORM),
        workers,
        account,
        limit=100,
    )


async def until(condition: Callable[[], bool]) -> None:
    """Let the loop turn until something is so; `run` bounds it."""
    while not condition():  # noqa: ASYNC110 - a condition of another's making, not an event
        await asyncio.sleep(0.001)


def run(work: Any) -> None:
    asyncio.run(asyncio.wait_for(work, patience()))


def test_what_ends_motion_is_handed_over_though_all_is_taken_and_hangs() -> None:
    gate, taken = threading.Event(), []

    async def work() -> None:
        workers = Workers(1, 1, LoopMailbox(asyncio.get_running_loop()))
        account = ServerMemory(10, 10).open()
        sender = sending(
            SimpleNamespace(_send=lambda *m, **_: taken.append(m[0])), workers, account
        )
        hanging = [workers.start(lambda: gate.wait(patience()))]
        hanging += [workers.start(lambda: gate.wait(patience()), always=True) for _ in range(2)]
        received: list[BaseException | None] = []
        with pytest.raises(BusyError, match="all 1 workers"):
            sender.send({"go": 1}, None, received.append, 10)
        with pytest.raises(LimitError):
            sender.send({"go": 2}, None, received.append, 20)
        sender.send({"cancel": 1}, None, received.append, 20, ends_motion=True)
        await until(lambda: received == [None])
        assert (taken, account.held) == ([{"cancel": 1}], 0)
        gate.set()
        await asyncio.gather(*hanging)
        workers.close()

    run(work())


def test_what_a_client_moves_is_stopped_though_all_that_is_freed_hangs() -> None:
    gate, left = threading.Event(), threading.Event()

    async def work() -> None:
        workers = Workers(1, 1, LoopMailbox(asyncio.get_running_loop()))
        account = ServerMemory(10, 10).open()
        connection = SimpleNamespace(leave=lambda _: left.set())
        sender = sending(connection, workers, account, SimpleNamespace(lease=1.0))
        hanging = [workers.free(lambda: gate.wait(patience())) for _ in range(50)]
        sender.close()
        await until(left.is_set)
        gate.set()
        await asyncio.gather(*hanging)
        workers.close()

    run(work())


@pytest.mark.parametrize(("size", "left"), [(2_000_000, 2), (2_000, 0)], ids=["large", "small"])
def test_what_waits_fails_and_is_released_with_the_client_though_the_component_hangs(
    size: int, left: int
) -> None:
    """Large messages are handed over one by one, so that one that hangs keeps none behind it."""
    gates = [threading.Event(), threading.Event()]
    taken: list[object] = []

    def take(message: object, *_: object, **__: object) -> None:
        taken.append(message)
        gates[len(taken) - 1].wait(patience())

    async def work() -> None:
        workers = Workers(4, 4, LoopMailbox(asyncio.get_running_loop()))
        account = ServerMemory(MANY, MANY).open()
        one = sending(SimpleNamespace(_send=take), workers, account)
        received: list[BaseException | None] = []
        for _ in range(4):
            one.send({"data": "x" * size}, None, received.append, size)
        assert account.held == 4 * size
        gates[0].set()
        await until(lambda: len(taken) == 2)
        assert received == [None]
        one.close()
        assert len(received) == 1 + left
        assert account.held == (3 - left) * size
        gates[1].set()
        await until(lambda: len(received) == 4)
        assert len(taken) == 2
        assert sum("has ended" in str(outcome) for outcome in received) == 2
        assert account.held == 0
        workers.close()

    run(work())


def test_many_wait_for_one_flush() -> None:
    gate = threading.Event()
    flushes: list[float] = []

    def flush(timeout: float) -> bool:
        flushes.append(timeout)
        gate.wait(patience())
        return True

    async def work() -> None:
        workers = Workers(4, 4, LoopMailbox(asyncio.get_running_loop()))
        one = sending(SimpleNamespace(flush=flush), workers, ServerMemory(MANY, MANY).open())
        done: list[int] = []
        for number in range(100):
            one.after(lambda number=number: done.append(number))  # type: ignore[misc]
        gate.set()
        await until(lambda: len(done) == 100)
        assert done == list(range(100))
        assert len(flushes) == 1
        workers.close()

    run(work())


def test_killing_again_what_hangs_takes_no_more_threads(talk: Connect) -> None:
    client, operator = talk(), talk()
    connection = client.open("hang")
    client.ask("Data", connection, {"text": "x"})
    eventually(lambda: script.hanging, "it hangs")
    before = threading.active_count()
    kills = [client.send("Kill", connection) for _ in range(200)]
    client.ask("List")  # all kills were begun
    assert threading.active_count() <= before + 2
    reports = [client.answer(kill) for kill in kills]
    assert [report["op"] for report in reports[:32]] == ["Reply"] * 32
    assert all(report["jsonMessage"]["code"] in {"limit", "unknown"} for report in reports[32:])
    assert operator.ask("List")


def test_opening_what_hangs_again_and_again_is_refused_and_takes_bounded_threads(
    server: Server, robot: RobotManager
) -> None:
    message = '{"op":"Data","id":"d","type":"%s","jsonMessage":{"text":"x"}}'
    before, codes, sent = threading.active_count(), [], 0
    for _ in range(12):
        with Talk(url(server)) as client:
            report = client.answer(client.send("Request", "hang"))["jsonMessage"]
            if "code" in report:
                codes.append(report["code"])
            else:
                client.raw(message % report["connection"])
                client.answer("d")
                sent += 1
                eventually(lambda: len(script.hanging) == sent, "the component has taken it")  # noqa: B023
        eventually(lambda: not robot.status().connections, "it is closed")
    assert len(codes) > 3  # the opening of a component with four threads that hang in it
    assert set(codes) == {"bridge"}
    assert threading.active_count() <= before + 4 + 16 + 4  # hung, for freeing, for asking
    script.gate.set()

    def opens() -> bool:
        with Talk(url(server)) as client:
            return bool(client.answer(client.send("Request", "hang"))["op"] == "Reply")

    eventually(opens, "it can be had again")


def test_a_client_that_goes_leaves_nothing_that_was_asked(serve: Serve) -> None:
    server = serve(Limits(memory_bytes=2000))
    with Talk(url(server)) as client:
        calls = [client.send("Call", "slow", {"value": 1}) for _ in range(10)]
        assert client.answer(calls[-1])["jsonMessage"]["code"] == "limit"
        assert server.held_octets > 1000
    eventually(lambda: server.held_octets == 0, "everything was let go")
