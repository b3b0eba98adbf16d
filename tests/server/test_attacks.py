"""Beside hostile clients a well-behaved one is served, in bounded memory; a fast `bench.attack`.

What a client may wait for is the longest step of the server's loop, in CPU time: that does not
depend on what else the machine does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress

import pytest
from tests.server.conftest import Serve
from tests.server.hostile import HOSTILE, Hostile, attack_beside, resident
from tests.server.robot import END, script
from tests.server.serving import url
from tests.server.talk import Talk, eventually, frame, open_socket
from websockets.frames import Opcode

from uoarm.server import Limits, Server
from uoarm.testing import patience

MEMORY = 50_000_000
CPU_SECONDS = 0.2
"""Of the loop, in one step: a tenth of what these took."""
LONG = 1_000_000


def one(hostile: Hostile) -> Callable[[Server], None]:
    def attack(server: Server) -> None:
        with Talk(url(server), binary=hostile.form == "cbor") as client:
            for sent in hostile.frames():
                client.raw(sent)
            client.ask("List")

    return attack


def data(server: Server) -> None:
    for _ in range(3):
        with Talk(url(server)) as client:
            connection = client.open("hang")
            sent = [client.send("Data", connection, {"text": "x" * 2_000_000}) for _ in range(20)]
            for identity in sent:
                client.answer(identity)
        eventually(lambda: server.held_octets < MEMORY // 10, "it was let go")


def kills(server: Server) -> None:
    with Talk(url(server)) as client:
        connection = client.open("hang")
        client.ask("Data", connection, {"text": "x"})
        for _ in range(500):
            client.send("Kill", connection)
        client.ask("List")


def pings(server: Server) -> None:
    with open_socket(server.ports[0]) as plain, suppress(OSError):
        plain.settimeout(1)
        for _ in range(50):
            plain.sendall(frame(b"", Opcode.PING) * 10_000)


def long_answers(server: Server) -> None:
    """In CBOR, which takes longest to write."""
    with Talk(url(server), binary=True) as client:
        for _ in range(3):
            client.send("Call", "many", {"value": 1_000_000})
            client.socket.recv(timeout=patience())


def long_messages(server: Server) -> None:
    with Talk(url(server), binary=True) as client:
        client.open("numbers", validate="off")  # they are none that its structure allows
        script.put(*[{"value": [0.5] * 1_000_000}] * 3, END)
        # Two of them are more than may wait for a client: of one that reads slowly the older is
        # dropped. The report of the end never is, and is the first that is short.
        while len(client.socket.recv(timeout=patience())) > LONG:
            pass


ATTACKS: Mapping[str, Callable[[Server], None]] = {
    "60,000 dimensions": one(HOSTILE["60,000 dimensions"]),
    "huge dimensions": one(HOSTILE["huge dimensions"]),
    "empty lists": one(HOSTILE["empty lists"]),
    "small objects": one(HOSTILE["small objects"]),
    "data for what hangs": data,
    "kills of what hangs": kills,
    "pings": pings,
    "long answers": long_answers,
    "long messages": long_messages,
}


@pytest.mark.parametrize("attack", ATTACKS.values(), ids=ATTACKS.keys())
def test_a_well_behaved_client_is_served_beside_it(
    serve: Serve, longest_step: Callable[[str], float], attack: Callable[[Server], None]
) -> None:
    server = serve(Limits(memory_bytes=MEMORY))

    def ask() -> None:
        assert caller.ask("Call", "add", {"a": 1, "b": 2}) == {"value": 3}

    with Talk(url(server)) as caller:
        ask()
        before = resident()
        held = attack_beside(server, attack, ask)
    assert 0 < longest_step("uoarm-serve") < CPU_SECONDS
    assert held <= MEMORY
    script.gate.set()
    eventually(lambda: server.held_octets == 0, "everything was let go")
    eventually(lambda: resident() < before + 4 * MEMORY, "memory is given back")
