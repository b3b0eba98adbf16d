"""What happens before a session: listening, handshakes, pages, metrics, front ends."""

from uoarm.server.http._certificate import ShownCertificate, fingerprint_of, own_certificate
from uoarm.server.http._handshake import FrontEnds, HandshakeHandler
from uoarm.server.http._listener import (
    BACKLOG,
    ListeningSocket,
    NoRoomError,
    connections_possible,
    listen,
)
from uoarm.server.http._metrics import Metrics, Totals

__all__ = [
    "BACKLOG",
    "FrontEnds",
    "HandshakeHandler",
    "ListeningSocket",
    "Metrics",
    "NoRoomError",
    "ShownCertificate",
    "Totals",
    "connections_possible",
    "fingerprint_of",
    "listen",
    "own_certificate",
]
