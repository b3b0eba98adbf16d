"""Where a client is, for limits and for logs."""

from __future__ import annotations

from websockets.asyncio.server import ServerConnection

__all__ = ["address_of", "host_of"]

_UNKNOWN = "unknown"


def host_of(connection: ServerConnection) -> str:
    """Return the host alone."""
    name = connection.remote_address
    return str(name[0]) if isinstance(name, tuple) else _UNKNOWN


def address_of(connection: ServerConnection) -> str:
    """Return `host:port`."""
    name = connection.remote_address
    return ":".join(str(part) for part in name[:2]) if isinstance(name, tuple) else _UNKNOWN
