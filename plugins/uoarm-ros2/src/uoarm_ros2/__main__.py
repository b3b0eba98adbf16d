"""`uoarm ros2`: a look at the graph, at its types and at what is installed; wheels of types."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from uoarm.bridge import Bridge, Description, Registry
from uoarm.cli import main as run_command
from uoarm.errors import CommandLineError
from uoarm.model import BridgeSpec, Endpoint, Options, Role
from uoarm.plugins import Command, CommandParser, hookimpl, printable
from uoarm_ros2._options import HIGHEST_DOMAIN
from uoarm_ros2._types import import_type, installed, kind_of, type_mistake

__all__ = ["main", "uoarm_commands"]


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status.

    Raises:
        ConfigurationError: definitions cannot be built.
        UoarmError: ROS 2 has it not, or the words are wrong.
    """
    given = _parser().parse_args(arguments)
    mistake = type_mistake(given.type) if getattr(given, "type", "") else ""
    if mistake:
        raise CommandLineError(mistake)
    return _build(given) if given.command == "build-interfaces" else _show(given)


@hookimpl
def uoarm_commands() -> list[Command]:
    """Return `uoarm ros2`."""
    return [Command("ros2", main, contract=1)]


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(prog="uoarm ros2", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    printing = CommandParser(add_help=False)
    printing.add_argument("--json", action="store_true", help="print JSON")
    asking = CommandParser(add_help=False, parents=[printing])
    asking.add_argument("--domain", type=_domain, help="default: ROS_DOMAIN_ID, else 0")
    commands.add_parser("list", parents=[asking], help="list nodes with what they offer and take")
    commands.add_parser("types", parents=[asking], help="list the types that nodes use")
    commands.add_parser("interfaces", parents=[printing], help="list the types that are installed")
    echo = commands.add_parser(
        "echo-structure",
        parents=[asking],
        help="print the structure of the messages of a topic, a service or an action",
    )
    echo.add_argument("name")
    echo.add_argument("type", nargs="?", default="", help="package/msg/Name; default: the graph's")
    build = commands.add_parser(
        "build-interfaces",
        parents=[printing],
        help="build wheels of .msg, .srv and .action files; needs a C and a C++ compiler",
    )
    build.add_argument("folder", type=Path, help="below it: package/msg/Name.msg and alike")
    build.add_argument("--output", type=Path, default=Path(), help="where wheels go; default: .")
    return parser


def _domain(text: str) -> int:
    number = int(text) if text.isdecimal() else -1
    if not 0 <= number <= HIGHEST_DOMAIN:
        raise argparse.ArgumentTypeError(f"expected 0 to {HIGHEST_DOMAIN}, got {text}")
    return number


def _build(given: argparse.Namespace) -> int:
    from uoarm_ros2._interface_wheels import build_wheels  # noqa: PLC0415 - of one command

    def report(step: str) -> None:
        sys.stderr.write(f"{step}\n")
        sys.stderr.flush()

    built = build_wheels(given.folder, given.output, report)
    return _print(given, [str(path) for path in built], list)


def _show(given: argparse.Namespace) -> int:
    if given.command == "interfaces":
        return _print(given, installed(), list)
    options = {} if given.domain is None else {"domain_id": given.domain}
    with _bridge(options) as bridge:
        if given.command == "list":
            return _print(given, _node_rows(bridge), _node_lines)
        if given.command == "types":
            return _print(given, _type_rows(bridge), _type_lines)
        found = _structure_rows(bridge, given.name, given.type)
        return _print(given, found, lambda item: [json.dumps(item, indent=2)])


def _print(given: argparse.Namespace, found: Any, lines: Any) -> int:
    text = json.dumps(found, indent=2) if given.json else printable("\n".join(lines(found)))
    sys.stdout.write(text + "\n" if text else "")
    sys.stdout.flush()
    return 0


def _node_lines(rows: list[Any]) -> Iterable[str]:
    reports: dict[str, str] = {}
    for row in rows:
        yield row["node"]
        for endpoint in row["endpoints"]:
            unknown = "" if endpoint["known"] else "  (structure unknown)"
            yield f"  {endpoint['role']:8}{endpoint['name']}  {endpoint['type']}{unknown}"
        if "missing" in row:
            first = reports.setdefault(row["missing"], row["node"])
            yield f"  {row['missing'] if first == row['node'] else f'the same as {first}'}"


def _type_lines(rows: list[Any]) -> Iterable[str]:
    for row in rows:
        yield f"{row['type']}  {row['known'] or 'not known'}  {', '.join(row['nodes'])}"


Row = dict[str, Any]


@contextmanager
def _bridge(options: Options) -> Iterator[Bridge]:
    """Have a bridge for one command.

    Raises:
        BridgeError: it cannot be made.
    """
    bridge = Registry().create(BridgeSpec("ros2_command", "ros2", options))
    try:
        yield bridge
    finally:
        bridge.close()


def _node_rows(bridge: Bridge) -> list[Row]:
    """Return every node with its topics, services and actions."""
    return [
        {
            "node": component.name,
            "endpoints": [
                {
                    "role": at.role.value,
                    "name": at.address[0],
                    "type": at.address[1],
                    "known": report != Description(),
                }
                for at, report in component.endpoints
            ],
            **({"missing": component.detail} if component.detail else {}),
        }
        for component in bridge.discover()
    ]


def _type_rows(bridge: Bridge) -> list[Row]:
    """Return every type on the graph: whether it is installed, or known from a node."""
    found: dict[str, Row] = {}
    for component in bridge.discover():
        for at, report in component.endpoints:
            name = at.address[1]
            row = found.setdefault(name, {"type": name, "known": "", "nodes": []})
            if component.name not in row["nodes"]:
                row["nodes"].append(component.name)
            if not row["known"] and report != Description():
                row["known"] = "installed" if _is_installed(name) else "described by its node"
    return [found[name] for name in sorted(found)]


def _is_installed(name: str) -> bool:
    try:
        import_type(name)
    except Exception:  # noqa: BLE001 - the answer, whatever the reason
        return False
    return True


def _structure_rows(bridge: Bridge, name: str, type_name: str) -> Row:
    """Return the structures of a topic, a service or an action, with the type if it is given.

    Raises:
        BridgeError: it is not there, or its type is not known.
    """
    address = (name, type_name) if type_name else (name,)
    is_message = kind_of(type_name) == "msg" if type_name else _is_topic(bridge, name)
    options: Options = {"peer": "optional"} if type_name else {}
    role = Role.OUTPUT if is_message else Role.SERVICE
    at = Endpoint(bridge.name, name, role, address, options=options)
    report = bridge.describe(at)
    parts = {"message": report.message, "request": report.request, "reply": report.reply}
    return {
        part: {"type": value.native_type, "structure": value.schema}
        for part, value in parts.items()
        if value is not None
    }


def _is_topic(bridge: Bridge, name: str) -> bool:
    """Whether the graph has a topic of this name; a name that it does not have counts as one."""
    everything = [at for component in bridge.discover() for at, _ in component.endpoints]
    kinds = {at.role for at in everything if at.address[0].strip("/") == name.strip("/")}
    return kinds != {Role.SERVICE}


if __name__ == "__main__":
    run_command(["ros2", *sys.argv[1:]])
