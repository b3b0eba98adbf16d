"""`uoarm rtm`: a naming service, and a look at components, without any other installation."""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterable
from concurrent.futures import wait
from pathlib import Path
from typing import Any

from uoarm.bridge import WorkerExecutor, wait_step
from uoarm.cli import main as run_command
from uoarm.errors import BridgeError, CommandLineError, FailureReason, ListenError
from uoarm.plugins import Command, CommandParser, hookimpl, printable

__all__ = ["main", "uoarm_commands"]

_STEP_SECONDS = 1.0
_LAST_PORT = 65_535
_ACTIONS = ("activate", "deactivate", "reset")


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status.

    Raises:
        UoarmError: it failed, or its words are wrong.
    """
    parser = _parser()
    given, rest = parser.parse_known_args(arguments)
    if rest and (given.command != "configure" or any(name[0] == "-" for name in rest)):
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    if rest:  # values after an option: argparse leaves them
        given.values += rest
    if given.command == "nameserver":
        return _nameserver(given.port, given.address, given.folder)
    return _ask(given)


@hookimpl
def uoarm_commands() -> list[Command]:
    """Return `uoarm rtm`."""
    return [Command("rtm", main, contract=1)]


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(prog="uoarm rtm", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    nameserver = commands.add_parser("nameserver", help="run omniNames until it is interrupted")
    nameserver.add_argument("--port", type=_port, default=2809, help="0 for any that is free")
    nameserver.add_argument("--address", default="127.0.0.1", help="interface to listen on")
    nameserver.add_argument("--folder", type=Path, help="where names survive; default: nowhere")
    asking = CommandParser(add_help=False)
    asking.add_argument(
        "--nameserver",
        action="append",
        metavar="HOST:PORT",
        help="naming service, several times for several; default: that of the environment "
        "variable UOARM_RTM_NAMESERVER, or localhost:2809",
    )
    asking.add_argument("--timeout", type=_seconds, default=2.0, help="seconds of each call")
    asking.add_argument("--json", action="store_true", help="print JSON")
    commands.add_parser("list", parents=[asking], help="list components, states and ports")
    cat = commands.add_parser("cat", parents=[asking], help="show all of one component")
    cat.add_argument("component")
    connections = commands.add_parser("connections", parents=[asking], help="list connections")
    connections.add_argument("--mine", action="store_true", help="only those uoarm made from here")
    connections.add_argument(
        "--remove", action="store_true", help="end those whose process runs no more"
    )
    for action in _ACTIONS:
        command = commands.add_parser(action, parents=[asking], help=f"{action} components")
        command.add_argument("component", nargs="+")
    configure = commands.add_parser("configure", parents=[asking], help="read and write parameters")
    configure.add_argument("component")
    configure.add_argument("values", nargs="*", metavar="NAME=VALUE")
    configure.add_argument("--set", help="configuration set; default: the active one")
    configure.add_argument("--activate", action="store_true", help="put the set in force")
    configure.add_argument("--create", action="store_true", help="make the set where there is none")
    return parser


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > _LAST_PORT:
        raise argparse.ArgumentTypeError(f"expected 0 to {_LAST_PORT}, got {text}")
    return int(text)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0 < seconds <= 60:  # noqa: PLR2004 - as for the bridge's calls
        raise argparse.ArgumentTypeError(f"expected seconds above 0, up to 60, got {text}")
    return seconds


def _ask(given: argparse.Namespace) -> int:
    if given.command == "connections" and given.remove and not given.mine:
        raise CommandLineError("--remove ends connections of ours only: say --mine, too")
    from uoarm_rtm._commands import session  # noqa: PLC0415 - imports the middleware

    usual = os.environ.get("UOARM_RTM_NAMESERVER") or "localhost:2809"

    def ask() -> tuple[Any, Any]:
        with session(given.nameserver or [usual], given.timeout) as now:
            if given.command == "list":
                return now.components(), _component_lines
            if given.command == "cat":
                return now.component(given.component), _whole_component_lines
            if given.command == "connections":
                found = now.connections(mine=given.mine, remove=given.remove)
                return found, _connection_lines
            if given.command in _ACTIONS:
                return now.change(given.component, given.command), _component_lines
            return now.configure(given.component, _request(given)), _set_lines

    # In a thread: no signal is handled while a call of CORBA waits.
    asked = WorkerExecutor("uoarm-rtm-ask").submit(ask)
    while not wait((asked,), wait_step()).done:
        pass
    return _print(given, *asked.result())


def _request(given: argparse.Namespace) -> dict[str, object]:
    values = {}
    for item in given.values:
        name, sign, value = item.partition("=")
        if not name or not sign:
            raise CommandLineError(f"expected NAME=VALUE, got {item!r}")
        values[name] = value
    request: dict[str, object] = {"activate": given.activate, "create": given.create}
    return {
        **request,
        **({"values": values} if values else {}),
        **({"set": given.set} if given.set else {}),
    }


def _print(given: argparse.Namespace, found: Any, lines: Any) -> int:
    text = json.dumps(found, indent=2) if given.json else printable("\n".join(lines(found)))
    sys.stdout.write(text + "\n" if text else "")
    sys.stdout.flush()
    return 0


def _component_lines(rows: list[Any]) -> Iterable[str]:
    for row in rows:
        yield f"{row['component']}  {row['state']}  {row.get('type', '')}".rstrip()
        for port in row.get("ports", ()):
            yield f"  {port['port']:<16} {port['kind']:<12} {port['type']}"


def _whole_component_lines(row: Any) -> Iterable[str]:
    yield from _component_lines([{**row, "ports": ()}])
    for port in row["ports"]:
        yield from list(_component_lines([{"component": "", "state": "", "ports": [port]}]))[1:]
        for line in _connection_lines(port["connections"]):
            yield f"    {line}"
    yield from _set_lines(row["configuration"])


def _connection_lines(rows: list[Any]) -> Iterable[str]:
    for row in rows:
        runs = {"yes": "runs", "no": "runs no more", "unknown": "may run"}.get(row["runs"], "")
        made = f"  by {row['maker']} ({row['process']}, {runs})" if runs else ""
        yield f"{row['id']}  {' - '.join(row['ports'])}  {row['subscription']}{made}".rstrip()


def _set_lines(found: Any) -> Iterable[str]:
    for name, values in found["sets"].items():
        yield f"set {name}{' (active)' if name == found['active'] else ''}"
        for parameter, value in values.items():
            report = (found.get(about, {}).get(parameter) for about in ("types", "constraints"))
            widget = found.get("widgets", {}).get(parameter, "")
            said = "; ".join(item for item in (*report, widget) if item)
            yield f"  {parameter:<20} {value}" + (f"  [{said}]" if said else "")


def _nameserver(port: int, address: str, folder: Path | None) -> int:
    from uoarm_rtm.nameserver import NameServer  # noqa: PLC0415 - imports the middleware

    try:  # omniNames does not say why it cannot
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((address, port))
    except OSError as error:
        raise ListenError(f"{address}:{port}", port, error) from error
    is_over, was_asked = threading.Event(), threading.Event()

    def end() -> None:
        was_asked.set()
        is_over.set()

    # In a thread: a handler must neither raise in what is half done nor take a lock that it holds.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=end).start())
    with NameServer(port, address, folder) as server:
        sys.stdout.write(f"naming service {server.address}\n")
        sys.stdout.flush()
        threading.Thread(target=_see_end, args=(server.process, is_over), daemon=True).start()
        while not is_over.wait(_STEP_SECONDS):  # a signal may have come as the wait began
            pass
        if was_asked.is_set():
            return 0
        text = f"omniNames ended with {server.process.wait()}"
        raise BridgeError(text, FailureReason.UNAVAILABLE)


def _see_end(process: subprocess.Popen[bytes], is_over: threading.Event) -> None:
    process.wait()
    is_over.set()


if __name__ == "__main__":
    run_command(["rtm", *sys.argv[1:]])
