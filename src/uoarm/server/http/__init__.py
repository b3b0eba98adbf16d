"""What happens before a session: listening, handshakes, pages, metrics, front ends."""

from uoarm.server.http._front_ends import FrontEnds
from uoarm.server.http._handshake import OWN_PATHS, HandshakeHandler
from uoarm.server.http._listener import BACKLOG, NoRoomError, connections_possible, listen
from uoarm.server.http._metrics import Metrics, Totals
from uoarm.server.http._own_certificate import fingerprint_of, own_certificate, state_folder

__all__ = [
    "BACKLOG",
    "OWN_PATHS",
    "FrontEnds",
    "HandshakeHandler",
    "Metrics",
    "NoRoomError",
    "Totals",
    "connections_possible",
    "fingerprint_of",
    "listen",
    "own_certificate",
    "state_folder",
]
