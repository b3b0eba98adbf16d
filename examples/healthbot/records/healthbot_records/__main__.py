"""Start the service: python -m healthbot_records --port 8088 --database records.db."""

from __future__ import annotations

import argparse
import socket

import uvicorn

from healthbot_records.api import make_app
from healthbot_records.store import Store

_HOST = "127.0.0.1"


def main() -> None:
    """Serve until Ctrl-C or SIGTERM; on loopback only."""
    parser = argparse.ArgumentParser(prog="healthbot_records")
    parser.add_argument("--port", type=int, default=8088, help="0 takes a free one")
    parser.add_argument(
        "--database", default="records.db", help="a file for SQLite, or a database URL"
    )
    given = parser.parse_args()
    url = given.database if "://" in given.database else f"sqlite:///{given.database}"
    app = make_app(Store(url))
    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((_HOST, given.port))
        listening.listen()
        port = listening.getsockname()[1]
        print(f"records at http://{_HOST}:{port}/fhir", flush=True)
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning"))
        server.run(sockets=[listening])


if __name__ == "__main__":
    main()
