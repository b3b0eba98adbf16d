"""One client: its connection, the native protocol, and sessions that outlive a drop."""

from uoarm.server.session._client import Client, Session
from uoarm.server.session._connection import Sockets, TurnConnection, address_of, host_of
from uoarm.server.session._incoming import DEFLATE
from uoarm.server.session._intake import Decoder
from uoarm.server.session._native import NativeSession, Shared
from uoarm.server.session._session_store import SessionStore

__all__ = [
    "DEFLATE",
    "Client",
    "Decoder",
    "NativeSession",
    "Session",
    "SessionStore",
    "Shared",
    "Sockets",
    "TurnConnection",
    "address_of",
    "host_of",
]
