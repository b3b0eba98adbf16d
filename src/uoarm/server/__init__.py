"""The WebSocket front end: every function of every framework, for any language and any browser.

Needs the packages of the extra `server`.
"""

from uoarm._origin import requiring

with requiring("server", "uoarm.server"):
    from uoarm.server._limits import Limits
    from uoarm.server._options import ServerOptions
    from uoarm.server._running import run, serve_in_thread
    from uoarm.server._server import Server
    from uoarm.server.access import hash_token, make_token
    from uoarm.server.http import fingerprint_of

__all__ = [
    "Limits",
    "Server",
    "ServerOptions",
    "fingerprint_of",
    "hash_token",
    "make_token",
    "run",
    "serve_in_thread",
]
