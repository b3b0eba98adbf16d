"""`uoarm fleet`: what runs on each manager that a configuration imports from.

With `--browse` which managers are announced on the network. Anything there can announce anything:
what is read is checked for its form, bounded and escaped, shown, and used for nothing.
"""

from __future__ import annotations

import argparse
import asyncio
import ipaddress
import math
import re
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent import futures
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from attrs import frozen
from typing_extensions import Self

from uoarm.bridge import Registry, install_command, reason_of
from uoarm.config import load
from uoarm.errors import BridgeError, FailureReason, PluginError
from uoarm.model import BridgeSpec, format_status, to_json, write_json
from uoarm.plugins import Command, CommandParser, hookimpl, printable
from uoarm_remote._link import CONNECTING_ERRORS, server_address, why_unreachable
from uoarm_remote._options import ManagerOptions

if TYPE_CHECKING:
    from zeroconf import ServiceStateChange
    from zeroconf.asyncio import AsyncServiceInfo

_FAILED = 4
_INDENT = "  "
_LEAST_WIDTH = 40
_USUAL_SECONDS, _MOST_SECONDS = 3.0, 60.0
_CLAIMED = (
    "# Anything on the network can announce this: give a token only to a robot that is known."
)
SERVICE = "_uoarm._tcp.local."
MOST = 100
"""Managers that are listed."""
_MOST_ADDRESSES = 8
_SHOWN = 64
_LOOK_MILLISECONDS = 3000.0
_END_SECONDS = 5.0


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
        return _browse(given.seconds or _USUAL_SECONDS, as_json=given.json)
    if given.seconds is not None:
        parser.error("without --browse there is no use for --seconds")
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
        print(printable(found) or f"{path} imports from no other manager")  # noqa: T201 - as above
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
        text = printable(announced_text(managers))
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
        cause = why_unreachable(error, options.url)
        return ManagerReport(name, options.url, cause, None, "UOA-402")
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
        help=f"how long --browse listens, up to 60; {_USUAL_SECONDS:g} by default",
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


@frozen
class AnnouncedManager:
    """One that was announced, as it says.

    Attributes:
        name: under which; printable, 64 characters at most.
        urls: of its server, 8 at most; empty: it cannot be read.
        identity: of the manager, 32 hexadecimal digits.
        tls: whether it speaks TLS.
        protocol: version of the protocol.
        cause: why it cannot be read; "": it was.
    """

    name: str
    urls: tuple[str, ...] = ()
    identity: str = ""
    tls: bool = False
    protocol: str = ""
    cause: str = ""


class Browser:
    """Collects what is announced, from entering to leaving it as a context. For one thread.

    Args:
        interfaces: addresses of interfaces to listen on; None: all that have one of IPv4.

    Attributes:
        is_full: whether more were announced than are listed.

    Raises:
        PluginError: the extra `zeroconf` is not installed.
        BridgeError: the network cannot be listened to.
    """

    def __init__(self, interfaces: Sequence[str] | None = None) -> None:
        try:
            from zeroconf import (  # noqa: PLC0415 - an extra
                InterfaceChoice,
                ServiceBrowser,
                Zeroconf,
            )
        except ImportError as error:
            command = install_command("uoarm", "zeroconf")
            raise PluginError(
                f"--browse needs: {command} ({error})", error_code="UOA-302"
            ) from error
        self._lock = threading.Lock()
        self._names: dict[str, None] = {}
        self._looking: set[str] = set()
        self._tasks: set[asyncio.Task[None]] = set()  # of the network's loop, and for it alone
        self.is_full = False
        try:
            self._network = Zeroconf(
                interfaces=InterfaceChoice.All if interfaces is None else list(interfaces)
            )
        except (OSError, RuntimeError) as error:
            raise BridgeError(
                f"the network cannot be listened to for managers: {reason_of(error)}",
                FailureReason.UNAVAILABLE,
            ) from error
        self._browser = ServiceBrowser(self._network, SERVICE, handlers=[self._changed])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._browser.cancel()
        loop = self._network.loop
        if loop is not None:
            with suppress(TimeoutError, futures.TimeoutError):
                asyncio.run_coroutine_threadsafe(self._end_looks(), loop).result(_END_SECONDS)
        self._network.close()

    def found(self) -> list[AnnouncedManager]:
        """Return what is known now, by name; ask once more for what is not. Does not block."""
        with self._lock:
            names = sorted(self._names)
        return [self._read(name) for name in names]

    def _read(self, name: str) -> AnnouncedManager:
        shown = _shown(name[: -len(SERVICE) - 1])
        try:
            info = _info(name)
            if info.load_from_cache(self._network):
                return _manager(shown, info)
            self._start_look(name)  # an answer may have been lost
            return AnnouncedManager(shown, cause=_SILENT)
        except ValueError as error:
            return AnnouncedManager(shown, cause=str(error))
        except Exception as error:  # noqa: BLE001 - a library reads what the network sent
            return AnnouncedManager(shown, cause=f"malformed: {_shown(str(error))}")

    def _changed(
        self,
        *,
        name: str,
        state_change: ServiceStateChange,
        **_: object,
    ) -> None:
        """Note what came or went; called in the browser's thread, which nothing may end."""
        with self._lock:
            if state_change.name == "Removed":
                self._names.pop(name, None)
                return
            if name not in self._names and len(self._names) >= MOST:
                self.is_full = True
                return
            self._names[name] = None
        self._start_look(name)

    def _start_look(self, name: str) -> None:
        """Have a name looked up, unless that is under way or too many are."""
        loop = self._network.loop
        with self._lock:
            if name in self._looking or len(self._looking) >= MOST or loop is None:
                return
            self._looking.add(name)
        asyncio.run_coroutine_threadsafe(self._look(name), loop)

    async def _look(self, name: str) -> None:
        """Ask for the address, port and properties, which the network then has in its cache."""
        task = asyncio.current_task()
        assert task is not None, "it runs in a task"
        self._tasks.add(task)
        try:
            await _info(name).async_request(self._network, _LOOK_MILLISECONDS)
        finally:
            self._tasks.discard(task)
            with self._lock:
                self._looking.discard(name)

    async def _end_looks(self) -> None:
        """Cancel what is asked: each has begun, as the loop begins tasks in their order."""
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


_SILENT = "it does not say an address and a port"


def _info(name: str) -> AsyncServiceInfo:
    from zeroconf.asyncio import AsyncServiceInfo  # noqa: PLC0415 - an extra

    return AsyncServiceInfo(SERVICE, name)


def _manager(shown: str, info: AsyncServiceInfo) -> AnnouncedManager:
    """Return what an announcement says.

    Raises:
        ValueError: it is not of the form; says which part.
    """
    identity = _property(info, "id", r"[0-9a-f]{32}", "32 hexadecimal digits")
    tls = _property(info, "tls", "[01]", "0 or 1") == "1"
    protocol = _property(info, "protocol", r"v[0-9]{1,4}", "a version such as v1")
    if not info.port:
        raise ValueError(_SILENT)
    places = (_place(text) for text in info.parsed_addresses()[:_MOST_ADDRESSES])
    scheme = "wss" if tls else "ws"
    urls = tuple(f"{scheme}://{place}:{info.port}/" for place in places if place)
    if not urls:
        raise ValueError("it says no address that can be reached from another machine")
    return AnnouncedManager(shown, urls, identity, tls, protocol)


def _property(info: AsyncServiceInfo, key: str, form: str, expected: str) -> str:
    given = (info.properties.get(key.encode()) or b"").decode("utf-8", "replace")
    if not re.fullmatch(form, given, re.ASCII):
        raise ValueError(f"{key}: expected {expected}, got '{_shown(given)}'")
    return given


def _place(text: str) -> str:
    """Return an address as it stands in a URL; "" for one that is of no other machine."""
    address = ipaddress.ip_address(text.partition("%")[0])
    if address.is_loopback or address.is_multicast or address.is_unspecified:
        return ""
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    # An address that holds on one link only cannot stand in a URL, and one of IPv4 in IPv6
    # could hide what is refused above.
    return "" if address.is_link_local or address.ipv4_mapped is not None else f"[{address}]"


def _shown(text: str) -> str:
    """Return foreign text for a terminal: in one line, escaped, of 64 characters at most."""
    characters = (c if c.isprintable() else f"\\u{{{ord(c):x}}}" for c in text[: _SHOWN + 1])
    shown = "".join(characters)
    return shown if len(shown) <= _SHOWN else f"{shown[: _SHOWN - 3]}..."
