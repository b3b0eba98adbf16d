"""Ports for servers of tests."""

from __future__ import annotations

import socket
from contextlib import suppress
from pathlib import Path
from random import SystemRandom

from uoarm._arguments import arguments

__all__ = ["free_port"]

_GIVEN = Path("/proc/sys/net/ipv4/ip_local_port_range")
_LOWEST = 10_000
_TRIES = 100


@arguments()
def free_port(address: str = "127.0.0.1") -> int:
    """Return a TCP port that is free, and that the system gives to nobody who does not ask for it.

    One that the system chose itself may be given to the next connection of any process before a
    server listens on it, or while one is restarted.

    Args:
        address: interface on which it is free.

    Raises:
        OSError: none of a hundred ports is free.
    """
    first_given = 32768
    with suppress(OSError):
        first_given = int(_GIVEN.read_text().split()[0])
    for port in SystemRandom().sample(range(_LOWEST, max(first_given, 2 * _LOWEST)), _TRIES):
        with socket.socket() as one, suppress(OSError):
            one.bind((address, port))
            return port
    raise OSError(f"none of {_TRIES} ports of {address} is free")
