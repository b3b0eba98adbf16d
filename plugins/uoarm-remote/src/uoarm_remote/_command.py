"""`uoarm fleet`: what runs on each manager that a configuration imports from.

With `--browse` which managers are announced on the network.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import shutil
import sys
import textwrap
import time
from collections.abc import Mapping, Sequence
from typing import Any

from attrs import frozen

from uoarm.bridge import Registry
from uoarm.config import load
from uoarm.model import BridgeSpec, format_status, to_json, write_json
from uoarm.plugins import Command, CommandParser, hookimpl
from uoarm_remote._browser import MOST, AnnouncedManager, Browser
from uoarm_remote._link import CONNECTING_ERRORS, server_address, why_unreachable
from uoarm_remote._options import ManagerOptions

__all__ = ["ManagerReport", "announced_text", "main", "uoarm_commands"]

_FAILED = 4
_INDENT = "  "
_LEAST_WIDTH = 40
_MOST_SECONDS = 60.0
_CLAIMED = (
    "# Anything on the network can announce this: give a token only to a robot that is known."
)


@frozen
class ManagerReport:
    """What is known of one manager.

    Attributes:
        bridge: that reaches it.
        url: of its server.
        cause: why it could not be asked; "": it was.
        status: its live status, as the token's role sees it; None: it could not be asked.
        error_code: of the cause.
    """

    bridge: str
    url: str
    cause: str
    status: Mapping[str, Any] | None
    error_code: str = ""

    def text(self, width: int | None) -> str:
        """Return it for people, with lines of at most so many characters; None: of any length."""
        if self.status is None:
            return f"{self.bridge}  {self.url}  not reached: {self.cause}"
        tables = format_status(self.status, width and max(_LEAST_WIDTH, width - len(_INDENT)))
        return f"{self.bridge}  {self.url}\n{textwrap.indent(tables, _INDENT)}"


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status.

    Raises:
        UoarmError: the configuration has mistakes, or the words are wrong.
    """
    parser = _parser()
    given = parser.parse_args(arguments)
    if given.browse:
        named = parser.named_configuration(given)
        if named is not None:
            parser.error(f"--browse reads no configuration: leave {named} out")
        return _browse(given.seconds, as_json=given.json)
    path = parser.configuration(given)
    registry = Registry()
    robot = load(path, registry.types)
    managers = {
        bridge: registry.types["remote"].value_of(bridge.options, bridge.folder)
        for bridge in robot.bridges.values()
        if bridge.plugin == "remote"
    }
    reports = asyncio.run(_reports(managers))
    if given.json:
        print(write_json(to_json(reports), indent=2))  # noqa: T201 - it is what was asked for
    else:
        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
        found = "\n".join(report.text(width) for report in reports)
        print(found or f"{path} imports from no other manager")  # noqa: T201 - as above
    return _FAILED if any(report.cause for report in reports) else 0


@hookimpl
def uoarm_commands() -> list[Command]:
    """Return `uoarm fleet`."""
    return [Command("fleet", main, contract=1)]


def _browse(seconds: float, *, as_json: bool) -> int:
    """List what is announced within so many seconds."""
    with Browser() as browser:
        time.sleep(seconds)
        managers, is_full = browser.found(), browser.is_full
    if as_json:
        print(write_json(to_json(managers), indent=2))  # noqa: T201 - it is what was asked for
    else:
        text = announced_text(managers)
        print(text or f"no manager was announced within {seconds:g} s")  # noqa: T201 - as above
    if is_full:
        sys.stderr.write(f"more than {MOST} are announced: the others are not listed\n")
    return 0


def announced_text(managers: Sequence[AnnouncedManager]) -> str:
    """Return a list of announced managers for people, and the lines that import from them.

    What stands in those lines is made here, but for addresses and ports.
    """
    listed: list[str] = []
    bridges: list[str] = []
    for manager in managers:
        if manager.cause:
            listed.append(f"-  {manager.name}  cannot be read: {manager.cause}")
            continue
        bridge = f"manager{len(bridges) + 1}"
        tls = "TLS" if manager.tls else "no TLS"
        facts = f"identity {manager.identity}  {tls}  protocol {manager.protocol}"
        listed.append(f"{bridge}  {manager.name}  {' '.join(manager.urls)}  {facts}")
        options = f'{{url: "{manager.urls[0]}", token_file: {bridge}.token}}'
        bridges.append(f"  {bridge}: {{plugin: remote, options: {options}}}")
    if bridges:
        listed += [_CLAIMED, "bridges:", *bridges]
    return "\n".join(listed)


async def _reports(managers: Mapping[BridgeSpec, ManagerOptions]) -> list[ManagerReport]:
    """Ask all at once; each has the `timeout` of its options."""
    asking = [_report(bridge.name, options) for bridge, options in managers.items()]
    return await asyncio.gather(*asking)


async def _report(name: str, options: ManagerOptions) -> ManagerReport:
    try:
        status = await asyncio.wait_for(_status(name, options), options.timeout)
    except asyncio.TimeoutError:
        cause = f"it did not answer within {options.timeout:g} s"
        return ManagerReport(name, options.url, cause, None, "UOA-408")
    except CONNECTING_ERRORS as error:
        return ManagerReport(name, options.url, why_unreachable(error), None, "UOA-402")
    return ManagerReport(name, options.url, "", status)


async def _status(name: str, options: ManagerOptions) -> Mapping[str, Any]:
    server = await server_address(name, options)
    async with server.robot().running(resume=False) as robot:
        return await robot.status()


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="uoarm fleet",
        description="Show the live status of each manager that a configuration imports from. Opens "
        "nothing. Exit code 0 when all were reached, 3 for a mistake in the file, 4 otherwise.",
    )
    parser.add_configuration()
    parser.add_argument(
        "--browse",
        action="store_true",
        help="list managers that are announced on the network (uoarm serve --announce) and connect "
        "to none",
    )
    parser.add_argument(
        "--seconds",
        type=_seconds,
        default=3.0,
        help="how long --browse listens, up to 60; 3 by default",
    )
    parser.add_argument("--json", action="store_true", help="print a list as JSON")
    return parser


def _seconds(given: str) -> float:
    try:
        seconds = float(given)
    except ValueError:
        seconds = math.nan
    if not 0 < seconds <= _MOST_SECONDS:
        raise argparse.ArgumentTypeError(f"expected more than 0 and up to 60, got {given}")
    return seconds
