"""One client: its connection, the native protocol, and sessions that outlive a drop."""

from uoarm.server.session._client import ConnectedClient, Session, StatelessClient, StatelessClients
from uoarm.server.session._connection import Sockets, TurnConnection, address_of, host_of
from uoarm.server.session._discoveries import Discoveries
from uoarm.server.session._incoming import DEFLATE, FrameDecoder
from uoarm.server.session._native import NativeSession, Shared
from uoarm.server.session._recordings import make_folder
from uoarm.server.session._session_store import SessionStore
from uoarm.server.session._views import show_approval, show_plan, show_stop, visible_status

__all__ = [
    "DEFLATE",
    "ConnectedClient",
    "Discoveries",
    "FrameDecoder",
    "NativeSession",
    "Session",
    "SessionStore",
    "Shared",
    "Sockets",
    "StatelessClient",
    "StatelessClients",
    "TurnConnection",
    "address_of",
    "host_of",
    "make_folder",
    "show_approval",
    "show_plan",
    "show_stop",
    "visible_status",
]
