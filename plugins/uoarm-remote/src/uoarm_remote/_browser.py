"""Which managers say on the network that they are there: `uoarm fleet --browse`.

Anything on the network can announce anything. What is read here is checked for its form, bounded
and escaped, shown, and used for nothing: no manager is connected to.
"""

from __future__ import annotations

import asyncio
import ipaddress
import re
import threading
from collections.abc import Sequence
from concurrent import futures
from contextlib import suppress
from typing import TYPE_CHECKING

from attrs import frozen
from typing_extensions import Self

from uoarm.errors import BridgeError, FailureReason, PluginError

if TYPE_CHECKING:
    from zeroconf import ServiceStateChange
    from zeroconf.asyncio import AsyncServiceInfo

__all__ = ["MOST", "SERVICE", "AnnouncedManager", "Browser"]

SERVICE = "_uoarm._tcp.local."
MOST = 100
"""Managers that are listed."""
_MOST_ADDRESSES = 8
_SHOWN = 64
_LOOK_MILLISECONDS = 3000.0
_END_SECONDS = 5.0


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
            raise PluginError(
                f"--browse needs: pip install 'uoarm[zeroconf]' ({error})", error_code="UOA-302"
            ) from error
        self._lock = threading.Lock()
        self._names: dict[str, None] = {}
        self._looking: set[str] = set()
        self._tasks: set[asyncio.Task[None]] = set()  # of the network's loop, and for it alone
        self._is_full = False
        try:
            self._network = Zeroconf(
                interfaces=InterfaceChoice.All if interfaces is None else list(interfaces)
            )
        except (OSError, RuntimeError) as error:
            raise BridgeError(
                f"the network cannot be listened to for managers: {error}",
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

    @property
    def is_full(self) -> bool:
        """Whether more were announced than are listed."""
        return self._is_full

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
                self._is_full = True
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
