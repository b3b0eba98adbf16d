"""Ports of this machine, and domains of ROS 2, which are ports too."""

from __future__ import annotations

import random
import socket

from uoarm.testing import free_port

__all__ = ["free_domain", "free_ports", "listens"]

# Domains whose UDP ports lie below Linux's range of short-lived ones.
_DOMAINS = range(1, 101)
_FIRST_PORT, _PORTS_OF_A_DOMAIN, _UNICAST = 7400, 250, 10


def listens(port: int) -> bool:
    """Return whether a process listens on a port of this machine's loopback address."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def free_ports(count: int) -> list[int]:
    """Return free ports of the loopback address."""
    ports: set[int] = set()
    while len(ports) < count:
        ports.add(free_port())
    return list(ports)


def free_domain() -> int:
    """Return a ROS 2 domain in which no process of this machine seems to be."""
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        first = _FIRST_PORT + _PORTS_OF_A_DOMAIN * domain
        if _is_free(first) and _is_free(first + _UNICAST):
            return domain
    return random.choice(_DOMAINS)  # noqa: S311 - no secret; all are taken, so one is shared


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", port))
        except OSError:
            return False
    return True
