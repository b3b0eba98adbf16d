"""Domains of ROS 2 that no other tests of this machine use, as tiers run beside each other."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

# Those of the examples begin at 64, and the ports of a domain above 101 are given to any program.
_DOMAINS = range(20, 64, 2)
_FIRST_PORT, _PORTS_OF_A_DOMAIN = 7400, 250
_NO_PEER = "127.0.0.9"


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Have a domain that, with the next one, no other process of tests on this machine uses.

    It is held by a name for other tests, and by the first port of both domains for examples that
    look whether one is in use: participants share that port, and none sends to this address.

    Raises:
        RuntimeError: other tests have them all.
    """
    first = os.getpid() % len(_DOMAINS)
    with ExitStack() as held:
        name = held.enter_context(socket.socket(socket.AF_UNIX))
        for domain in (*_DOMAINS[first:], *_DOMAINS[:first]):
            with suppress(OSError):
                name.bind(f"\0uoarm-tests-domain-{domain}")
                break
        else:
            raise RuntimeError("all ROS domains are taken by other tests")
        for number in (domain, domain + 1):
            port = held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            port.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            port.bind((_NO_PEER, _FIRST_PORT + _PORTS_OF_A_DOMAIN * number))
        yield domain
