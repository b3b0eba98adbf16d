"""`uoarm rtm nameserver`: a naming service without any other installation."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from uoarm.errors import BridgeError
from uoarm.plugins import Command, hookimpl
from uoarm_rtm._nameserver import NameServer

__all__ = ["main", "uoarm_commands"]


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    parser = argparse.ArgumentParser(prog="uoarm rtm", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    nameserver = commands.add_parser("nameserver", help="run omniNames until it is interrupted")
    nameserver.add_argument("--port", type=int, default=2809, help="0 for any that is free")
    nameserver.add_argument("--address", default="127.0.0.1", help="interface to listen on")
    nameserver.add_argument("--folder", type=Path, help="where names survive; default: nowhere")
    given = parser.parse_args(arguments)
    return _nameserver(given.port, given.address, given.folder)


@hookimpl
def uoarm_commands() -> list[Command]:
    """Return `uoarm rtm`."""
    return [Command("rtm", main, contract=1)]


def _nameserver(port: int, address: str, folder: Path | None) -> int:
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with NameServer(port, address, folder) as server:
            sys.stdout.write(f"naming service {server.address}\n")
            sys.stdout.flush()
            try:
                return server.process.wait()
            except KeyboardInterrupt:
                return 0
    except BridgeError as error:
        sys.stderr.write(f"{error}\n")
        return 1


if __name__ == "__main__":
    sys.exit(main())
