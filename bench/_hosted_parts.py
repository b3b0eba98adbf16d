"""Components and children that the bench of hosts runs in other processes."""

from __future__ import annotations

import ctypes
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, TypedDict

from uoarm.local import Octets

__all__ = ["echo", "hang", "slowly", "subscribe", "zenoh_echo"]


class Packet(TypedDict):
    """What the round trips carry."""

    data: Octets


def echo(message: Packet) -> Packet:
    """Give back what came."""
    return message


def slowly() -> Iterator[int]:
    """Emit a number every millisecond."""
    number = 0
    while True:
        yield number
        number += 1
        time.sleep(0.001)


def hang(value: int) -> int:
    """Sleep without letting go of the interpreter lock."""
    ctypes.PyDLL(None).sleep(value)
    return value


def subscribe(session: Any, key: str, take: Callable[[Any], object]) -> None:
    """Have samples handed to `take` in a thread of its own."""
    import zenoh  # noqa: PLC0415 - the host's other components need none

    subscriber = session.declare_subscriber(key, zenoh.handlers.RingChannel(128))

    def receive() -> None:
        with suppress(zenoh.ZError):  # the session is closed
            while True:
                take(subscriber.recv())

    threading.Thread(target=receive, daemon=True).start()


def zenoh_echo(place: str) -> None:
    """Give back frames over Zenoh and nothing else, until killed."""
    import zenoh  # noqa: PLC0415 - the host's other components need none

    from uoarm._host.transport.zenoh_transport import configuration  # noqa: PLC0415 - the same settings

    session = zenoh.open(configuration(place, listen=False, timeout=10, lease=10))

    def back(sample: Any) -> None:
        session.put("bench/back", sample.payload, attachment=sample.attachment)

    subscribe(session, "bench/there", back)
    session.liveliness().declare_token("bench/alive")
    signal.pause()


if __name__ == "__main__":
    zenoh_echo(sys.argv[1])
