"""A WebSocket server that only redirects, as a proxy does for a path without its last slash."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import Mock

from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve


@contextmanager
def redirecting(location: str) -> Iterator[str]:
    """Give the address of a server that redirects to another."""

    def respond(connection: ServerConnection, _: Request) -> Response:
        response = connection.respond(301, "")
        response.headers["Location"] = location
        return response

    with serve(Mock(), "127.0.0.1", 0, process_request=respond) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}/ros"
        finally:
            server.shutdown()
            thread.join()
