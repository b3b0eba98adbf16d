"""Components and children that the bench of hosts runs in other processes."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, TypedDict

from uoarm.local import Octets

__all__ = ["count", "echo", "hang", "leave", "slowly", "subscribe", "zenoh_echo"]


class Packet(TypedDict):
    """What the round trips carry."""

    data: Octets


def echo(message: Packet) -> Packet:
    """Give back what came."""
    return message


def count() -> Iterator[int]:
    """Emit as fast as it can."""
    yield from range(1_000_000)


def slowly() -> Iterator[int]:
    """Emit a number every millisecond."""
    number = 0
    while True:
        yield number
        number += 1
        time.sleep(0.001)


def leave(value: int) -> int:
    """End the process."""
    os._exit(value)


def hang(value: int) -> int:
    """Sleep without letting go of the interpreter lock."""
    ctypes.PyDLL(None).sleep(value)
    return value


def subscribe(session: Any, key: str, take: Callable[[Any], object], receivers: str) -> None:
    """Have samples handed to `take`: in Zenoh's thread (`callbacks`), or in one of its own."""
    import zenoh  # noqa: PLC0415 - the host's other components need none

    if receivers == "callbacks":
        session.declare_subscriber(key, zenoh.handlers.Callback(take, indirect=False))
        return
    subscriber = session.declare_subscriber(key, zenoh.handlers.RingChannel(128))

    def receive() -> None:
        with suppress(zenoh.ZError):  # the session is closed
            while True:
                take(subscriber.recv())

    threading.Thread(target=receive, daemon=True).start()


def zenoh_echo(place: str, receivers: str) -> None:
    """Give back frames over Zenoh and nothing else, until killed."""
    import zenoh  # noqa: PLC0415 - the host's other components need none

    from uoarm._host.transport.zenoh_transport import configuration  # noqa: PLC0415 - the same settings

    session = zenoh.open(configuration(place, listen=False, timeout=10, lease=10))

    def back(sample: Any) -> None:
        session.put("bench/back", sample.payload, attachment=sample.attachment)

    subscribe(session, "bench/there", back, receivers)
    session.liveliness().declare_token("bench/alive")
    signal.pause()


if __name__ == "__main__":
    zenoh_echo(*sys.argv[1:])
