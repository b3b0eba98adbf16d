"""The thread of a line never turns without work: what ends its wait is read, or it rests."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ClassVar

import pytest
from lines import LIMIT, PseudoTerminal, listening
from rigs import bridged, endpoint, served
from uoarm_rocos._line import DeviceLine
from uoarm_rocos._options import LineOptions
from uoarm_rocos._transport import LineTransport, TcpTransport, transport_for
from uoarm_rocos.simulate import SimulatedRobot

from uoarm.bridge import Backoff
from uoarm.testing import wait

FEW = 2
"""Turns for nothing that one cause may cost."""


class User:
    """Counts the octets that come, the ticks, and how often the line was lost."""

    def __init__(self) -> None:
        self.is_connected = threading.Event()
        self.octets = self.ticks = self.losses = 0

    def connected(self) -> None:
        self.is_connected.set()

    def received(self, data: bytes) -> None:
        self.octets += len(data)

    def wait_for(self, octets: int) -> None:
        wait(lambda: self.octets == octets)

    def tick(self, now: float) -> None:
        del now
        self.ticks += 1

    def lost(self, cause: str) -> None:
        del cause
        self.losses += 1


@contextmanager
def line(
    make: Callable[[], LineTransport], *, is_shared: bool
) -> Iterator[tuple[DeviceLine, User]]:
    user = User()
    made = DeviceLine("loop", make, user, Backoff(first=0.05, most=0.1), is_shared=is_shared)
    made.start()
    try:
        assert user.is_connected.wait(LIMIT)
        yield made, user
    finally:
        made.close(LIMIT)


@pytest.mark.parametrize("is_shared", [True, False])
def test_octets_and_quiet_over_tcp_cost_no_turn(*, is_shared: bool) -> None:
    with (
        listening() as (server, port),
        line(lambda: TcpTransport("127.0.0.1", port), is_shared=is_shared) as (made, user),
    ):
        device = server.accept()[0]
        with device:
            for number in range(1, 51):
                device.sendall(b"x" * 100)
                user.wait_for(100 * number)
            ticks = user.ticks
            wait(lambda: user.ticks > ticks + 5)
        wait(lambda: user.losses > 0)
        assert made.empty_turns == 0


@pytest.mark.parametrize("is_shared", [True, False])
def test_octets_and_a_cut_of_a_tty_cost_no_turn(*, is_shared: bool) -> None:
    with (
        PseudoTerminal() as device,
        line(transport_for(device.path, LineOptions()), is_shared=is_shared) as (made, user),
    ):
        for number in range(1, 51):
            device.write(b"x" * 100)
            user.wait_for(100 * number)
        device.cut()
        wait(lambda: user.losses > 1)
        assert made.empty_turns <= FEW


class Hasty(TcpTransport):
    """A part of another make, whose `read` does not wait."""

    def read(self) -> bytes:
        assert self._reader is not None
        self._reader.setblocking(False)
        try:
            return super().read()
        except Exception as error:
            if isinstance(error.__cause__, BlockingIOError):
                return b""
            raise

    def descriptor(self) -> int | None:
        return None


def test_a_part_whose_reading_does_not_wait_makes_the_thread_rest() -> None:
    with (
        listening() as (server, port),
        line(lambda: Hasty("127.0.0.1", port), is_shared=True) as (made, user),
    ):
        device = server.accept()[0]
        with device:
            began, before = time.monotonic(), made.empty_turns
            wait(lambda: made.empty_turns > before + 20)
            empty, seconds = made.empty_turns - before, time.monotonic() - began
            assert empty <= 10 + seconds / 0.02
            device.sendall(b"x")
            wait(lambda: user.octets == 1)


def test_calls_in_their_callers_thread_cost_no_turn() -> None:
    with served(SimulatedRobot()) as url, bridged(robot={"url": url}) as (bridge, _):
        echo = endpoint("robot", "echo", "service")
        bridge.describe(echo)
        for number in range(200):
            text = str(number)
            assert bridge.call(echo, {"text": text}, timeout=LIMIT) == {"text": text}
        empty = bridge.facts()["empty_turns"]
        assert isinstance(empty, int)
        assert empty <= FEW


class Odd(TcpTransport):
    """A part of another make, which raises what is no `Exception`, or as it is closed."""

    raises: ClassVar[list[str]] = []

    def read(self) -> bytes:
        if "read" in self.raises:
            self.raises.remove("read")
            raise SystemExit("of a part")
        return super().read()

    def close(self) -> None:
        super().close()
        if "close" in self.raises:
            self.raises.remove("close")
            raise RuntimeError("of a part")


@pytest.mark.parametrize("where", ["read", "close"])
def test_whatever_a_part_raises_the_line_is_opened_again(
    monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    monkeypatch.setattr(Odd, "raises", [])
    with (
        listening() as (server, port),
        line(lambda: Odd("127.0.0.1", port), is_shared=False) as (_, user),
    ):
        with server.accept()[0]:
            Odd.raises.append(where)
            if where == "read":
                wait(lambda: user.losses)
        with server.accept()[0] as device:
            device.sendall(b"again")
            user.wait_for(5)
        assert user.losses
