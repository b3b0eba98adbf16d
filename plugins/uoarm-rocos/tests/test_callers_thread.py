"""Calls over the profile's own lines stay in the caller's thread, and end in their time there."""

from __future__ import annotations

import signal
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress

import pytest
from lines import LIMIT, listening
from rigs import QUICK, Events, bridged, endpoint, served
from test_faults import Scripted
from uoarm_rocos import LengthFramer, LineParts, TcpTransport, XmlCodec
from uoarm_rocos._bridge import RocosBridge
from uoarm_rocos._catalogue import CallMessage, CloseMessage, ResultMessage, WireMessage
from uoarm_rocos._options import RocosOptions
from uoarm_rocos.simulate import SimulatedRobot

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm.model import MessageStructure
from uoarm.testing import slowness, wait

ECHO = endpoint("robot", "echo", "service")
ODOMETRY = endpoint("robot", "odometry")
ANY = MessageStructure({})


class NotingCodec(XmlCodec):
    """Notes in which threads calls are written and results are read."""

    def __init__(self) -> None:
        super().__init__()
        self.threads: set[tuple[str, threading.Thread]] = set()

    def write(self, message: WireMessage) -> bytes:
        if isinstance(message, CallMessage):
            self.threads.add(("call", threading.current_thread()))
        return super().write(message)

    def read(self, data: bytes) -> WireMessage:
        message = super().read(data)
        if isinstance(message, ResultMessage):
            self.threads.add(("result", threading.current_thread()))
        return message


class Sipping(TcpTransport):
    """Takes ten octets at once; the rest when the test says so."""

    def __init__(self, port: int) -> None:
        super().__init__("127.0.0.1", port)
        self.may_go_on = threading.Event()

    def write_now(self, data: bytes) -> int:
        return super().write_now(data[:10])

    def write(self, data: bytes) -> None:
        assert self.may_go_on.wait(LIMIT)
        super().write(data)


@contextmanager
def made(wire: LineParts) -> Iterator[Bridge]:
    options = {"devices": {"robot": {**QUICK, "url": "tcp://of.the.wire:1"}}}
    bridge = RocosBridge("rocos", RocosOptions.of(options), lambda _: wire)
    try:
        yield bridge
    finally:
        bridge.close()


@pytest.mark.parametrize("is_prompt", [True, False])
def test_a_prompt_line_is_written_and_read_by_who_calls(is_prompt: bool) -> None:
    codec, here = NotingCodec(), threading.current_thread()
    with served(SimulatedRobot()) as url:
        port = int(url.rpartition(":")[2])
        wire = LineParts(
            lambda: TcpTransport("127.0.0.1", port), LengthFramer, codec, prompt=is_prompt
        )
        with made(wire) as bridge:
            bridge.describe(ECHO)
            for _ in range(50):  # some are read by the line's own thread, if that is quicker
                assert bridge.call(ECHO, {"text": "a"}, timeout=LIMIT) == {"text": "a"}
    assert (("call", here) in codec.threads) is is_prompt
    assert (("result", here) in codec.threads) is is_prompt
    if is_prompt:
        assert {thread for what, thread in codec.threads if what == "call"} == {here}


@pytest.mark.parametrize("kind", ["tcp", "pty"])
def test_many_callers_and_a_flow_on_one_line_get_what_is_theirs(kind: str) -> None:
    got = Events()
    with served(SimulatedRobot(), kind) as url, bridged(robot={"url": url}) as (bridge, _):
        bridge.describe(ECHO)
        source = bridge.open_source(ODOMETRY, ANY, got)

        def calls(caller: int) -> None:
            for n in range(40):
                text = f"{caller} says {n}"
                assert bridge.call(ECHO, {"text": text}, timeout=LIMIT) == {"text": text}

        with ThreadPoolExecutor(6) as pool:
            for done in [pool.submit(calls, caller) for caller in range(6)]:
                done.result(LIMIT)
        got.get()
    assert source.unreadable == 0


def test_a_call_ends_in_its_time_though_the_line_takes_nothing() -> None:
    with listening() as (listener, port):
        transport = Sipping(port)
        transport.may_go_on.set()
        wire = LineParts(lambda: transport, LengthFramer, XmlCodec(), prompt=True)
        with made(wire) as bridge, ThreadPoolExecutor(1) as pool:
            described = pool.submit(bridge.describe, ECHO, timeout=LIMIT)
            device = Scripted(listener.accept()[0])
            device.begin()
            described.result(LIMIT)
            transport.may_go_on.clear()
            for text in ("half is on the line", "not begun"):
                with pytest.raises(BridgeTimeoutError, match="robot"):
                    bridge.call(ECHO, {"text": text}, timeout=slowness() / 2)
            transport.may_go_on.set()
            first, close = device.receive(CallMessage), device.receive(CloseMessage)
            assert isinstance(first, CallMessage)
            assert isinstance(close, CloseMessage)
            assert (first.values["text"], close.id) == ("half is on the line", first.id)
            asked = pool.submit(bridge.call, ECHO, {"text": "whole"}, timeout=LIMIT)
            again = device.receive(CallMessage)
            assert isinstance(again, CallMessage)
            device.say(lambda seq: ResultMessage(seq, again.id, again.values))
            assert asked.result(LIMIT) == {"text": "whole"}
            device.connection.close()


@contextmanager
def serving(answer: Callable[[Scripted, CallMessage], None]) -> Iterator[str]:
    """A device that takes any number of connections, one after the other."""
    over = threading.Event()

    def serve(listener: socket.socket) -> None:
        while not over.is_set():
            connection = listener.accept()[0]
            device = Scripted(connection)
            with connection, suppress(OSError, AssertionError):  # the host has gone
                device.begin()
                while True:
                    asked = device.receive(CallMessage)
                    assert isinstance(asked, CallMessage)
                    answer(device, asked)

    with listening() as (listener, port), ThreadPoolExecutor(1) as pool:
        served = pool.submit(serve, listener)
        try:
            yield f"tcp://127.0.0.1:{port}"
        finally:
            over.set()
            socket.create_connection(("127.0.0.1", port)).close()
        served.result(LIMIT)


def echo(device: Scripted, asked: CallMessage) -> None:
    device.say(lambda seq: ResultMessage(seq, asked.id, asked.values))


class Interrupted(BaseException):
    """What a signal's handler raises, as that of SIGINT does."""


@pytest.fixture
def interrupting() -> Iterator[None]:
    def interrupt(*_: object) -> None:
        raise Interrupted

    before = signal.signal(signal.SIGUSR1, interrupt)
    yield
    signal.signal(signal.SIGUSR1, before)


@pytest.mark.usefixtures("interrupting")
def test_a_caller_that_is_interrupted_leaves_nothing_behind() -> None:
    caller = threading.main_thread().ident
    assert caller == threading.get_ident()

    def answer(device: Scripted, asked: CallMessage) -> None:
        if asked.values["text"] == "interrupt me":
            signal.pthread_kill(caller, signal.SIGUSR1)
        else:
            echo(device, asked)

    with serving(answer) as url, bridged(robot={"url": url}) as (bridge, _):
        bridge.describe(ECHO)
        with pytest.raises(Interrupted):
            bridge.call(ECHO, {"text": "interrupt me"}, timeout=LIMIT)
        assert isinstance(bridge, RocosBridge)
        device = bridge._devices["robot"]
        assert device._answers._waiting == {}  # type: ignore[attr-defined]

        def is_answered() -> bool:
            with suppress(BridgeError):  # where the line is made anew just now
                return bool(bridge.call(ECHO, {"text": "on"}, timeout=LIMIT))
            return False

        wait(is_answered)
