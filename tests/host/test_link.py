"""Requests over a link are always answered, and errors cross it whole."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from functools import partial
from queue import SimpleQueue
from typing import Any

import pytest

from uoarm._host.transport.transport import Reply, Transport
from uoarm._host.transport.zenoh_transport import ZenohTransport
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    FailureReason,
    MessageError,
    PluginError,
    UoarmError,
)
from uoarm.testing import Background, free_port, patience, wait

Ends = tuple[Transport, Transport]


def _settle(near: Transport, far: Transport) -> None:
    """Wait until what `far` declared before is known to `near`."""
    seen = threading.Event()
    near.watch_alive("test/settled", lambda alive: seen.set())
    far.show_alive("test/settled")
    assert seen.wait(patience())


def test_a_request_is_answered(ends: Ends) -> None:
    near, far = ends
    far.answer("test/ask", lambda request, reply: reply({"got": request}))
    _settle(near, far)
    assert near.ask("test/ask", [1, b"two"], timeout=patience()) == {"got": [1, b"two"]}


def test_both_ends_may_ask(ends: Ends) -> None:
    near, far = ends
    near.answer("test/ask", lambda request, reply: reply(request + 1))
    _settle(far, near)
    assert far.ask("test/ask", 1, timeout=patience()) == 2


@pytest.mark.parametrize(
    "error",
    [
        BridgeError("no such thing", FailureReason.NOT_FOUND),
        BridgeTimeoutError("too slow"),
        MessageError("of another shape"),
        PluginError("not installed"),
    ],
)
def test_an_error_keeps_kind_text_and_reason(ends: Ends, error: UoarmError) -> None:
    def take(request: Any, reply: Reply) -> None:
        raise error

    near, far = ends
    far.answer("test/ask", take)
    _settle(near, far)
    with pytest.raises(type(error), match=f"^{error}$") as caught:
        near.ask("test/ask", None, timeout=patience())
    assert type(caught.value) is type(error)
    assert getattr(caught.value, "reason", None) == getattr(error, "reason", None)


def test_a_foreign_error_is_answered_by_name(ends: Ends) -> None:
    near, far = ends
    far.answer("test/ask", lambda request, reply: reply(1 // request))
    _settle(near, far)
    with pytest.raises(BridgeError, match="ZeroDivisionError"):
        near.ask("test/ask", 0, timeout=patience())


def test_an_answer_that_cannot_be_written_is_an_error(ends: Ends) -> None:
    near, far = ends
    far.answer("test/ask", lambda request, reply: reply(object()))
    _settle(near, far)
    with pytest.raises(MessageError, match="cannot carry a object"):
        near.ask("test/ask", 0, timeout=patience())


def test_no_host_there_is_unavailable(ends: Ends) -> None:
    with pytest.raises(BridgeError, match="there is no answer") as caught:
        ends[0].ask("test/nothing", None, timeout=patience())
    assert caught.value.reason is FailureReason.UNAVAILABLE


def test_no_answer_in_time_is_a_timeout(ends: Ends) -> None:
    near, far = ends
    kept: list[Reply] = []
    far.answer("test/ask", lambda request, reply: kept.append(reply))
    _settle(near, far)
    with pytest.raises(BridgeTimeoutError):
        near.ask("test/ask", None, timeout=0.3)


def test_an_answer_may_come_from_another_thread(ends: Ends) -> None:
    near, far = ends
    far.answer(
        "test/ask", lambda request, reply: threading.Thread(target=reply, args=(request,)).start()
    )
    _settle(near, far)
    assert near.ask("test/ask", "later", timeout=patience()) == "later"


def test_a_token_comes_and_goes(ends: Ends) -> None:
    near, far = ends
    seen: list[bool] = []
    changed = threading.Event()

    def note(alive: bool) -> None:
        seen.append(alive)
        changed.set()

    far.show_alive("test/alive")
    near.watch_alive("test/alive", note)
    assert changed.wait(patience())
    changed.clear()
    far.close()
    assert changed.wait(patience())
    assert seen == [True, False]


def test_frames_are_taken_until_the_subscription_ends(ends: Ends) -> None:
    near, far = ends
    got: SimpleQueue[tuple[bytes, bytes]] = SimpleQueue()
    end = near.subscribe(
        "test/frames", 4, lambda payload, header: got.put((bytes(payload), header)), "test"
    )
    _settle(far, near)
    far.publish("test/frames", b"one", b"1")
    assert got.get(timeout=patience()) == (b"one", b"1")
    end()
    reports: SimpleQueue[bytes] = SimpleQueue()
    near.subscribe("test/others", 4, lambda _, header: reports.put(header), "test")
    near.show_alive("test/again")
    seen = threading.Event()
    far.watch_alive("test/again", lambda alive: seen.set())
    assert seen.wait(patience())
    far.publish("test/frames", b"two", b"2")
    far.publish("test/others", b"", b"3")
    assert reports.get(timeout=patience()) == b"3"
    assert got.empty()


def test_who_takes_one_flow_holds_up_no_other_and_no_request(ends: Ends) -> None:
    near, far = ends
    gate, taken = threading.Event(), SimpleQueue[bytes]()
    held: list[bytes] = []

    def hang(_: object, header: bytes) -> None:
        gate.wait(patience())
        held.append(header)

    near.subscribe("test/hangs", 8, hang, "test")
    near.subscribe("test/goes_on", 8, lambda _, header: taken.put(header), "test")
    near.answer("test/ask", lambda request, reply: reply(request))
    _settle(far, near)
    for number in (b"1", b"2", b"3"):
        far.publish("test/hangs", b"", number)
    far.publish("test/goes_on", b"", b"other")
    assert far.ask("test/ask", "still", timeout=patience()) == "still"
    assert taken.get(timeout=patience()) == b"other"
    assert held == []
    gate.set()
    wait(lambda: len(held) == 3)
    assert held == [b"1", b"2", b"3"]


def test_requests_and_notices_go_ahead_of_messages_that_wait_for_a_full_link() -> None:
    place, blocking = f"tcp/127.0.0.1:{free_port()}", "transport/link/tx/queue/congestion_control/"
    patient = {f"{blocking}block/wait_before_close": int(4 * patience() * 1e6)}
    near = ZenohTransport(place, listen=True, more=patient)
    far = ZenohTransport(place, listen=False, more=patient)
    order: list[str] = []
    is_full, go_on = threading.Event(), threading.Event()

    def hold_up(_: bytes) -> None:
        is_full.set()
        go_on.wait(3 * patience())

    def answer(_: Any, reply: Reply) -> None:
        order.append("request")
        reply(None)

    def ask() -> None:
        near.notify("notice", b"h")
        near.ask_later("request", print, timeout=patience())

    sending: list[Background[None]] = []
    try:
        far.listen("first", hold_up)
        far.listen("message", lambda _: order.append("message"))
        far.listen("notice", lambda _: order.append("notice"))
        far.answer("request", answer)
        _settle(near, far)
        near.notify("first", b"h")
        assert is_full.wait(patience())  # from now on nothing is read there
        long = bytes(32 * 2**20)
        publish = partial(near.publish, "message", long, b"h", must_arrive=True)
        sending += [Background(publish) for _ in range(4)]
        Background(ask).result(patience())
        go_on.set()
        wait(lambda: len(order) == 6)
    finally:
        go_on.set()
        for sent in sending:
            sent.result(patience())
        far.close()
        near.close()
    assert order.index("request") <= 2, order


def test_an_error_of_the_engine_does_not_show_where_that_was_built() -> None:
    with pytest.raises(BridgeError, match="opening the link") as caught:
        ZenohTransport("tcp/127.0.0.1:1", listen=False, timeout=0.1)
    assert ".rs" not in str(caught.value)


def test_an_end_that_tries_to_reach_a_mute_peer_again_still_closes_soon() -> None:
    port = free_port()
    place = f"tcp/127.0.0.1:{port}"
    near = ZenohTransport(place, listen=True)
    reached: list[ZenohTransport] = []

    def reach() -> list[ZenohTransport]:
        """Connect in less time than Zenoh gives a close; a machine that is busy may take more."""
        with suppress(BridgeError):
            reached.append(ZenohTransport(place, listen=False, timeout=2.0))
        return reached

    wait(reach)
    (far,) = reached
    near.close()

    def close() -> None:
        with suppress(BridgeError):  # on a slow machine a try lasts longer than Zenoh closes
            far.close()

    with socket.create_server(("127.0.0.1", port)) as mute:
        mute.settimeout(patience())
        with mute.accept()[0]:
            closing = threading.Thread(target=close)
            closing.start()
            closing.join(patience())
            assert not closing.is_alive()
