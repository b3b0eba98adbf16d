"""Where a manager listens for bridge hosts on other machines."""

from __future__ import annotations

import ipaddress
import re

from attrs import frozen

__all__ = ["Listening", "is_loopback", "place_problem"]

_PLACE = re.compile(r"(tls|tcp)/(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9.-]+):([0-9]{1,5})")
_LAST_PORT = 65535


@frozen
class Listening:
    """Where a manager waits for other machines.

    Attributes:
        place: `tls/ADDRESS:PORT`; `tcp/...` on loopback only.
        certificates: the folder of its certificate; None where there is no TLS.
        silence: seconds without a sign of life after which a link to a machine counts as cut.
    """

    place: str
    certificates: str | None = None
    silence: float = 3.0


def place_problem(place: str) -> str:
    """Say why machines cannot meet at this place, "" when they can."""
    found = _PLACE.fullmatch(place)
    if found is None or not 0 < int(found[3]) <= _LAST_PORT:
        return "expected tls/ADDRESS:PORT"
    if found[1] == "tcp" and not is_loopback(found[2].strip("[]")):
        return "without TLS only on loopback, such as tcp/127.0.0.1:7447"
    return ""


def is_loopback(host: str) -> bool:
    """Say whether a host name or address is this machine's loopback."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
