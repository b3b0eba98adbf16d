"""Each hostile input has one plain error for an answer; beside it others are served."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping

import pytest
from ros import Ros, Serve, url
from tests.server.hostile import attack_beside, resident  # type: ignore[import-not-found]
from tests.server.talk import eventually  # type: ignore[import-not-found]

from uoarm.server import Limits, Server

LARGEST = 16_777_216 - 1024
LATCHED = 4_010_000
"""Octets of the longest frame, which a server takes with its settings as they come."""
MEMORY = 50_000_000
CPU_SECONDS = 0.2
"""Of the loop, in one step: a tenth of what these took."""


def call(value: str) -> str:
    return f'{{"op":"call_service","service":"/anything","id":"h","args":{value}}}'


def many(item: str, octets: int = LARGEST) -> str:
    """Return a list as JSON text that is filled with one item."""
    return f"[{','.join([item] * (octets // (len(item) + 1)))}]"


def in_fragments(whole: str, pieces: int) -> Iterator[str]:
    size = -(-len(whole) // pieces)
    for place in range(pieces):
        data = whole[place * size : (place + 1) * size]
        yield json.dumps({"op": "fragment", "id": "f", "num": place, "total": pieces, "data": data})


HOSTILE: Mapping[str, Callable[[], Iterator[str]]] = {
    "empty lists": lambda: iter([call(many("[]"))]),
    "small objects": lambda: iter([call(many('{"a":[]}'))]),
    "empty lists in fragments": lambda: in_fragments(call(many("[]", 8_000_000)), 4),
    # A value where a short text is expected: it must not be written out in the error.
    "a list as a count": lambda: iter(
        [f'{{"op":"subscribe","topic":"/t","id":"h","throttle_rate":{many("1", 900_000)}}}']
    ),
}


@pytest.mark.parametrize("frames", HOSTILE.values(), ids=HOSTILE.keys())
def test_it_is_refused_and_the_session_goes_on(
    serve: Serve, frames: Callable[[], Iterator[str]]
) -> None:
    server = serve(Limits(elements_per_second=1e9))  # at what pace, the core's test_intake.py has
    with Ros(url(server)) as client:
        for frame in frames():
            client.socket.send(frame)
        client.send(op="call_service", service="/rosapi/get_time", id="last")
        received = [client.receive() for _ in range(2)]
    assert received[0].get("level") == "error" or received[0]["result"] is False
    assert received[-1]["result"] is True
    assert all(len(json.dumps(answer)) < 600 for answer in received)


def small_objects(server: Server) -> None:
    with Ros(url(server)) as client:
        for frame in HOSTILE["small objects"]():
            client.socket.send(frame)
        client.receive()


def latch(server: Server) -> None:
    with Ros(url(server)) as client:
        text = "x" * (LATCHED - 1000)
        for number in range(30):
            client.send(op="publish", topic=f"/t{number}", latch=True, msg={"data": text})
        while client.receive()["op"] != "status":
            """Until the first is refused."""


@pytest.mark.parametrize("attack", [small_objects, latch])
def test_a_well_behaved_client_is_served_beside_it(
    serve: Serve, longest_step: Callable[[str], float], attack: Callable[[Server], None]
) -> None:
    server = serve(Limits(memory_bytes=MEMORY))

    def ask() -> None:
        assert caller.call("/uoarm/add", [1, 2]) == {"value": 3}

    with Ros(url(server)) as caller:
        ask()
        before = resident()
        held = attack_beside(server, attack, ask)
    assert 0 < longest_step("uoarm-serve") < CPU_SECONDS
    # What arrives is counted from its first octet. As memory is full, a client may have as much
    # waiting as the largest message has, one message more, and the one that is acted on.
    assert held <= MEMORY + LARGEST + 2 * LATCHED
    eventually(lambda: server.held_octets == 0, "everything was let go")
    eventually(lambda: resident() < before + 4 * MEMORY, "memory is given back")
