"""A server and its clients take hardly any processor time while nothing happens, or little does."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

import pytest
from tests.server.conftest import Between, Connect, Serve
from tests.server.robot import script
from tests.server.talk import Talk, eventually

from uoarm.client import connect
from uoarm.server import Limits, Server
from uoarm.server.access import Admission
from uoarm.testing import Background, hold_idle, patience, wait

CLIENTS = 10
SELDOM_SECONDS = 0.2


def test_a_server_without_clients_looks_twice_a_second(
    waits: Callable[[str], list[float]], serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Admission] = []

    def refresh(admission: Admission) -> None:
        read.append(admission)

    monkeypatch.setattr(Admission, "refresh", refresh)
    serve()
    looks = waits("uoarm-serve")
    looks.clear()  # those of its start
    wait(lambda: len(looks) >= 3)
    assert set(looks) == {0.5}
    assert not read, "there is no access file"


def test_clients_that_wait_cost_hardly_anything(server: Server, talk: Connect) -> None:
    del server
    clients = [talk(binary=bool(number % 2)) for number in range(CLIENTS)]
    hold_idle("while clients ask nothing")
    for client in clients:
        client.open("numbers")
        client.ask("Status", "watch")
    hold_idle("while clients wait for messages and changes")
    stop = threading.Event()

    def emit() -> None:
        while not stop.wait(SELDOM_SECONDS):
            script.put({"value": 1})

    emitting = Background(emit)
    try:
        hold_idle("between messages")
    finally:
        stop.set()
    emitting.result(patience())
    hold_idle("after the last message")


def test_a_client_whose_link_is_dead_costs_hardly_anything(serve: Serve, between: Between) -> None:
    """Its messages wait, then its session; neither is looked at without a pause."""
    server = serve(Limits(resume_seconds=patience()))
    proxy = between(server)
    with Talk(f"ws://127.0.0.1:{proxy.port}/") as client:
        client.ask("Resume")
        client.open("numbers")
        proxy.hold(to_server=True, to_client=True)
        script.put(*({"value": number} for number in range(100)))
        hold_idle("while a client does not read")
        proxy.cut(admit=False)
        hold_idle("while a session is kept")


async def test_a_client_whose_server_is_gone_tries_again_with_pauses(
    server: Server, between: Between
) -> None:
    proxy = between(server)

    async with connect(f"ws://127.0.0.1:{proxy.port}/") as client:
        await client.request("numbers")
        proxy.cut(admit=False)
        await asyncio.to_thread(eventually, lambda: proxy.refused > 1, "it tries again")
        await asyncio.to_thread(hold_idle, "while the server is gone")
