"""Components and children that the bench of hosts runs in other processes."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Iterator
from typing import Any, TypedDict

from uoarm.local import Octets

__all__ = ["count", "echo", "hang", "leave", "slowly", "zenoh_echo"]


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


def zenoh_echo(place: str) -> None:
    """Give back frames over Zenoh and nothing else, until killed."""
    import zenoh  # noqa: PLC0415 - the host's other components need none

    from uoarm._host.transport.zenoh_transport import configuration  # noqa: PLC0415 - the same settings

    session = zenoh.open(
        configuration(place, listen=False, timeout=10, lease=10, shared_memory=False)
    )

    def back(sample: Any) -> None:
        session.put("bench/back", sample.payload, attachment=sample.attachment)

    session.declare_subscriber("bench/there", zenoh.handlers.Callback(back, indirect=False))
    session.liveliness().declare_token("bench/alive")
    signal.pause()


if __name__ == "__main__":
    zenoh_echo(sys.argv[1])
