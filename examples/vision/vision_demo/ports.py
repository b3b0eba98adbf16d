"""Ports of this machine."""

from __future__ import annotations

import socket

__all__ = ["listens"]


def listens(port: int) -> bool:
    """Return whether somebody listens on a port of this machine's loopback address."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
