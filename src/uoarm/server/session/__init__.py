"""One client: its connection, the native protocol, and sessions that outlive a drop."""

from uoarm.server.session._client import ConnectedClient, Session
from uoarm.server.session._connection import Sockets, TurnConnection, address_of, host_of
from uoarm.server.session._incoming import DEFLATE, FrameDecoder
from uoarm.server.session._native import NativeSession, Shared
from uoarm.server.session._session_store import SessionStore

__all__ = [
    "DEFLATE",
    "ConnectedClient",
    "FrameDecoder",
    "NativeSession",
    "Session",
    "SessionStore",
    "Shared",
    "Sockets",
    "TurnConnection",
    "address_of",
    "host_of",
]
