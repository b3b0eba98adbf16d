"""Serves the browser application on loopback, and with it the project's JavaScript client."""

from __future__ import annotations

import re
import signal
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path

__all__ = ["PageHandler"]

_CLIENT = re.compile(r"uoarm[a-z-]*\.js")


class PageHandler(SimpleHTTPRequestHandler):
    """Files of one folder, and the client's from the package."""

    def translate_path(self, path: str) -> str:
        """Return the file of an address."""
        name = path.partition("?")[0].lstrip("/")
        if _CLIENT.fullmatch(name):
            return str(files("uoarm.server") / "static" / name)
        return super().translate_path(path)

    def log_message(self, *_: object) -> None:
        """Say nothing of what works."""

    def end_headers(self) -> None:
        """Let no browser keep a page that may have changed."""
        self.send_header("Cache-Control", "no-cache")
        super().end_headers()


def main() -> None:
    """Serve `FOLDER PORT` until a signal ends it."""
    folder, port = Path(sys.argv[1]), int(sys.argv[2])
    server = ThreadingHTTPServer(("127.0.0.1", port), partial(PageHandler, directory=str(folder)))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=server.shutdown).start())
    with server:
        server.serve_forever()


if __name__ == "__main__":
    main()
