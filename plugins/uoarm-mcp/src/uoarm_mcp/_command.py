"""`uoarm mcp`: a robot for one agent on standard input and output, or for several over HTTP."""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from uoarm import RobotManager
from uoarm.errors import CommandLineError
from uoarm.plugins import Command, CommandParser, hookimpl
from uoarm.server import Server, ServerOptions, run
from uoarm.server.front_end import RefusedError
from uoarm_mcp._stdio import own_wire, serve_stdio

__all__ = ["main", "uoarm_commands"]

_REFUSED, _USED = 1, 5
_LAST_PORT = 65_535


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status.

    Raises:
        UoarmError: it cannot be served, or the words are wrong.
    """
    parser = _parser()
    given = parser.parse_args(arguments)
    path = parser.configuration(given)
    try:
        options = ServerOptions(
            host=given.host,
            port=given.port,
            access=given.access,
            certificate=given.certificate,
            key=given.key,
            client_authority=given.client_authority,
            own_certificate=given.tls is not None,
            audit=given.audit,
            front_end_ports={} if given.http is None else {"mcp": given.http},
        )
        served: AbstractContextManager[tuple[int, int] | None] = nullcontext()
        if given.http is None:
            served = own_wire()
        with served as wire, RobotManager.from_file(path) as robot:
            robot.offer(timeout=0)
            if wire is None:
                run(robot, options, lambda server: _say(server, options))
            else:
                token = os.environ.get("UOARM_TOKEN", "")
                asyncio.run(
                    serve_stdio(wire, robot, options, token, lambda server: _say(server, options))
                )
    except RefusedError as error:
        raise CommandLineError(
            str(error), exit_code=_REFUSED, error_code=error.error_code
        ) from error
    except OSError as error:
        text = error.strerror or str(error)
        raise CommandLineError(text, exit_code=_USED, error_code="UOA-709") from error
    return 0


@hookimpl
def uoarm_commands() -> list[Command]:
    """Return `uoarm mcp`."""
    return [Command("mcp", main, contract=1)]


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="uoarm mcp",
        description=f"{__doc__} The token of the agent is UOARM_TOKEN. Approvals are given over "
        "WebSocket, with `uoarm approve`.",
    )
    parser.add_configuration()
    parser.add_argument(
        "--http", type=_port, metavar="PORT", help="serve agents over HTTP at /mcp; 0: a free port"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on")
    parser.add_argument(
        "--port", type=_port, default=9080, help="of the WebSocket server; 0: a free one"
    )
    parser.add_argument("--access", type=Path, help="access file with roles and tokens")
    parser.add_argument("--audit", type=Path, help="file that the audit log is appended to")
    parser.add_argument("--tls", choices=["auto"], help="speak TLS with a certificate made here")
    parser.add_argument("--certificate", type=Path, help="PEM file of the certificate, for TLS")
    parser.add_argument("--key", type=Path, help="PEM file of its key")
    parser.add_argument(
        "--client-authority", type=Path, help="PEM file that client certificates rest on"
    )
    return parser


def _port(given: str) -> int:
    number = int(given) if given.isdecimal() else -1
    if not 0 <= number <= _LAST_PORT:
        raise argparse.ArgumentTypeError(f"expected 0 to {_LAST_PORT}, got {given}")
    return number


def _say(server: Server, options: ServerOptions) -> None:
    s = "s" if options.secured else ""
    places = [options.place_from_here(port) for port in server.ports]
    sys.stderr.write(f"serving ws{s}://{places[0]}/\n")
    for place in places[1:]:
        sys.stderr.write(f"serving http{s}://{place}/mcp for agents\n")
    if options.access is None:
        sys.stderr.write("without an access file nothing that moves can be approved\n")
    sys.stderr.flush()
