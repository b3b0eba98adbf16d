"""`uoarm ros2`: a look at the graph, at its types and at what is installed; wheels of types."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from uoarm.errors import ConfigurationError, UoarmError
from uoarm.plugins import Command, hookimpl
from uoarm_ros2 import import_with_middleware
from uoarm_ros2._settings import HIGHEST_DOMAIN
from uoarm_ros2._types import type_mistake

__all__ = ["main", "uoarm_commands"]

_REFUSED, _USAGE, _BRIDGE, _INTERRUPTED = 1, 2, 4, 130


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status.

    That is 1 for definitions that cannot be built, 2 for wrong words, 4 where ROS 2 has it not.
    """
    given = _parser().parse_args(arguments)
    mistake = type_mistake(given.type) if getattr(given, "type", "") else ""
    if mistake:
        return _fail(mistake, _USAGE)
    try:
        return _build(given) if given.command == "build-interfaces" else _show(given)
    except ConfigurationError as error:
        return _fail(str(error), _REFUSED)
    except UoarmError as error:
        return _fail(str(error), _BRIDGE)
    except KeyboardInterrupt:
        return _fail("interrupted", _INTERRUPTED)


@hookimpl
def uoarm_commands() -> list[Command]:
    """Return `uoarm ros2`."""
    return [Command("ros2", main, contract=1)]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="uoarm ros2", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    printing = argparse.ArgumentParser(add_help=False)
    printing.add_argument("--json", action="store_true", help="print JSON")
    asking = argparse.ArgumentParser(add_help=False, parents=[printing])
    asking.add_argument("--domain", type=_domain, help="default: ROS_DOMAIN_ID, else 0")
    commands.add_parser("list", parents=[asking], help="list nodes with what they offer and take")
    commands.add_parser("types", parents=[asking], help="list the types that nodes talk")
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
    number = int(text)
    if not 0 <= number <= HIGHEST_DOMAIN:
        raise argparse.ArgumentTypeError(f"expected 0 to {HIGHEST_DOMAIN}, got {text}")
    return number


def _build(given: argparse.Namespace) -> int:
    from uoarm_ros2._interfaces import build_wheels  # noqa: PLC0415 - other commands do not need it

    def tell(step: str) -> None:
        sys.stderr.write(f"{step}\n")
        sys.stderr.flush()

    built = build_wheels(given.folder, given.output, tell)
    return _print(given, [str(path) for path in built], lambda paths: paths)


def _show(given: argparse.Namespace) -> int:
    commands = import_with_middleware("uoarm_ros2._commands")
    if given.command == "interfaces":
        return _print(given, commands.installed(), lambda names: names)
    options = {} if given.domain is None else {"domain_id": given.domain}
    with commands.seen(options) as bridge:
        if given.command == "list":
            return _print(given, commands.graph(bridge), _node_lines)
        if given.command == "types":
            return _print(given, commands.types(bridge), _type_lines)
        found = commands.structure(bridge, given.name, given.type)
        return _print(given, found, lambda item: [json.dumps(item, indent=2)])


def _print(given: argparse.Namespace, found: Any, lines: Any) -> int:
    text = json.dumps(found, indent=2) if given.json else "\n".join(lines(found))
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


def _fail(text: str, status: int) -> int:
    sys.stderr.write(f"{text}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
