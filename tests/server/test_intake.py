"""Clients are read at a fair pace, and what is heavy to decode holds up no other."""

from __future__ import annotations

import asyncio
import gc
import json
import threading
import time
import tracemalloc
from contextlib import suppress

from hypothesis import given
from hypothesis import strategies as st
from tests.server.conftest import Serve
from tests.server.talk import Talk, eventually, frame, open_socket

from uoarm.server import Limits, Server
from uoarm.server.session._incoming import FrameDecoder, RateLimiter
from uoarm.testing import patience

MESSAGES = st.lists(
    st.tuples(st.floats(0, 2), st.integers(0, 5_000), st.integers(0, 5_000)), max_size=40
)


@given(MESSAGES)
def test_no_rate_is_passed_by_a_client_that_is_made_to_wait(
    messages: list[tuple[float, int, int]],
) -> None:
    limits = Limits(messages_per_second=10, octets_per_second=1000, elements_per_second=100)
    pace, now = RateLimiter(limits, 0.0), 0.0
    octets = elements = 0
    for place, (pause, size, values) in enumerate(messages):
        now += pause
        # Before a message is read, no bucket is overdrawn: at most one second's worth was saved up.
        assert place <= 10 * (now + 1) + 1e-6
        assert octets <= 1000 * (now + 1) + 1e-6
        assert elements <= 100 * (now + 1) + 1e-6
        octets, elements = octets + size, elements + values
        now += pace.spend(now, octets=size, elements=values)


def test_a_client_within_its_rates_never_waits() -> None:
    pace = RateLimiter(Limits(messages_per_second=10, octets_per_second=1000), 0.0)
    assert not any(pace.spend(0.1 * index, octets=100, elements=1) for index in range(1, 1000))


def test_a_large_message_is_taken_and_waited_for_afterwards() -> None:
    pace = RateLimiter(Limits(octets_per_second=1000), 0.0)
    assert pace.spend(0.0, octets=5000, elements=1) == 4.0
    assert pace.spend(4.0, octets=500, elements=1) == 0.5
    assert pace.spend(100.0, octets=1000, elements=1) == 0.0


def test_a_clock_that_goes_back_takes_nothing_away() -> None:
    pace = RateLimiter(Limits(messages_per_second=10), 100.0)
    assert pace.spend(50.0, octets=1, elements=1) == 0.0


def test_others_are_served_while_something_heavy_is_decoded() -> None:
    """Also when that never ends: each decoding here waits for what the loop does meanwhile."""

    async def serve() -> list[str]:
        decoder, loop, done = FrameDecoder(), asyncio.get_running_loop(), []
        gate = threading.Event()

        def heavy() -> str:
            assert threading.current_thread() is not loop_thread
            assert gate.wait(patience())
            return "heavy"

        loop_thread = threading.current_thread()
        waiting = [loop.create_task(decoder.run(100_000, heavy)) for _ in range(3)]
        for item in waiting:
            item.add_done_callback(lambda task: done.append(task.result()))
        done.append(await decoder.run(100, lambda: "light"))
        gate.set()
        await asyncio.gather(*waiting)
        decoder.close()
        return done

    assert asyncio.run(serve()) == ["light", "heavy", "heavy", "heavy"]


def test_light_and_heavy_messages_of_a_client_stay_in_order(serve: Serve) -> None:
    server = serve()
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/uoarm") as client:
        connection = client.open("echo")
        fill = "x" * 20_000
        for number in range(40):
            fields = {"op": "Data", "type": connection, "id": str(1000 + number)}
            padding = {"x-fill": fill} if number % 2 else {}
            client.raw(json.dumps({**fields, "jsonMessage": {"value": number}, **padding}))
        assert client.data(connection, 40) == [{"value": number} for number in range(40)]


def test_elements_are_paced(serve: Serve) -> None:
    """More than a second's worth of values takes its time; what follows is answered, too."""
    server = serve(Limits(elements_per_second=100_000))
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/uoarm") as client:
        start = time.monotonic()
        for _ in range(3):
            client.send("Call", "anything", [1] * 100_000)
        client.ask("List")
        assert time.monotonic() - start >= 1.5


def test_the_last_message_of_a_client_goes_with_it(server: Server) -> None:
    """Also before the garbage collector finds what its end left behind."""
    gc.collect()
    gc.disable()
    tracemalloc.start()
    try:
        for _ in range(4):
            with Talk(f"ws://127.0.0.1:{server.ports[0]}/uoarm") as client:
                client.raw("x" * 8_000_000)
                client.answer(None)
        eventually(lambda: tracemalloc.get_traced_memory()[0] < 6_000_000, "it is freed")
    finally:
        tracemalloc.stop()
        gc.enable()


def test_few_frames_of_a_client_wait_to_be_read(serve: Serve) -> None:
    """One that is made to wait soon cannot send: its frames would be in the server's memory."""
    server = serve(Limits(octets_per_second=1.0, ping_seconds=600, stall_seconds=600))
    large = frame(b"x" * 4_000_000)
    with open_socket(server.ports[0]) as plain:
        plain.settimeout(3)
        sent = 0
        with suppress(TimeoutError):
            for _ in range(30):
                plain.sendall(large)
                sent += 1
    assert sent <= 8  # one that was read, three in the queue, and what the two sockets buffer
