"""A server that only redirects, as a proxy does for a path without its last slash."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer


@contextmanager
def redirecting(location: str) -> Iterator[str]:
    """Give the address of a server that redirects to another."""

    class Redirect(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"  # as WebSocket clients ask for

        def do_GET(self) -> None:
            self.send_response(301)
            self.send_header("Location", location)
            self.send_header("Content-Length", "0")
            self.send_header("Connection", "close")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Say nothing of what was asked."""

    with HTTPServer(("127.0.0.1", 0), Redirect) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.server_port}/ros"
        finally:
            server.shutdown()
            thread.join()
