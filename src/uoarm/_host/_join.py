"""A host that joins by itself: the bridges of one machine, for a manager on another one."""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Collection, Mapping
from pathlib import Path
from threading import Event
from typing import Any

from uoarm._host import _keys
from uoarm._host._link import Link, Reply
from uoarm._host._security import Identity
from uoarm._host._served import Served
from uoarm._host._workers import Workers
from uoarm._version import __version__
from uoarm.bridge import CONTRACT_VERSION, Registry
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import BridgeSpec

__all__ = ["JoinedHost"]

_TRY_SECONDS = 2.0
_AGAIN_SECONDS = 0.3
_UNASKED_SECONDS = 10.0
_log = logging.getLogger("uoarm")

Orders = Mapping[str, Any]


class JoinedHost:
    """Makes the bridges that the manager asks for, until it is closed.

    Each is made when the manager takes it up and closed when the manager lets it go, dies, or can
    no longer be reached; then the host waits for it to come back.

    Args:
        place: where the manager listens.
        machine: the name of this machine, as its certificate and the configuration have it.
        identity: its certificate; None without TLS.
        bridges: names of the bridges to serve; empty: every one of this machine.
        modules: folder of the components of `python` bridges that name no other.
        silence: seconds without a sign of life after which the link counts as cut.
        registry: the plugins.
    """

    def __init__(
        self,
        place: str,
        machine: str,
        *,
        identity: Identity | None,
        bridges: Collection[str] = (),
        modules: str = ".",
        silence: float = 3.0,
        registry: Registry | None = None,
    ) -> None:
        self._place = place
        self._machine = machine
        self._more = {} if identity is None else identity.settings(listen=False)
        self._bridges = tuple(bridges) or (_keys.ANY_BRIDGE,)
        self._modules = str(Path(modules).resolve())
        self._silence = silence
        self._registry = registry or Registry()
        self._name = uuid.uuid4().hex[:12]
        self._workers = Workers("uoarm-attach")
        self._lock = threading.Lock()
        self._served: list[Served] = []
        self._asked = Event()
        self._closed = Event()

    def run(self) -> None:
        """Join, and serve until `close` is called from another thread or a signal's handler."""
        whole = self._connect()
        if whole is None:
            return
        _log.info("the manager at %s is reached", self._place)
        link = self._link = whole.part(_keys.MACHINES)
        try:
            link.answer(_keys.attach(self._machine, self._name), self._take)
            link.answer(_keys.clock(self._machine, self._name), self._tell_time)
            for bridge in self._bridges:
                link.show_alive(_keys.here(self._machine, bridge, self._name))
            if not self._asked.wait(_UNASKED_SECONDS) and not self._closed.is_set():
                _log.warning(
                    "%s is reached, but does not ask: does its configuration know the machine %r, "
                    "and is this the name in the certificate?",
                    self._place,
                    self._machine,
                )
            self._closed.wait()
        finally:
            with self._lock:
                served = list(self._served)
            for one in served:
                one.let_go()  # all at once, since each may take its time
            for one in served:
                one.end()
            self._workers.close()
            whole.close()

    def close(self) -> None:
        """Have `run` close every bridge and return. From any thread; once is enough."""
        self._closed.set()
        self._asked.set()

    def _connect(self) -> Link | None:
        """Try until the manager is there; what is in the way is told once, not at each try."""
        told = ""
        while not self._closed.is_set():
            try:
                return Link(
                    self._place,
                    listen=False,
                    timeout=_TRY_SECONDS,
                    lease=self._silence,
                    more=self._more,
                )
            except BridgeError as error:
                if str(error) != told:
                    told = str(error)
                    _log.warning(
                        "waiting for the manager at %s: it is not there, or the two do not "
                        "believe each other's certificates (%s)",
                        self._place,
                        told,
                    )
                self._closed.wait(_AGAIN_SECONDS)
        return None

    def _tell_time(self, _: Any, reply: Reply) -> None:
        reply(time.time_ns())
        self._asked.set()

    def _take(self, orders: Orders, reply: Reply) -> None:
        self._workers.answer(reply, lambda: self._attach(orders))

    def _attach(self, orders: Orders) -> None:
        """Make a bridge, after older ones of this name that are on their way out."""
        _require_same_version(orders)
        name: str = orders["name"]
        if not {name, _keys.ANY_BRIDGE} & set(self._bridges):
            raise BridgeError(f"this host does not serve {name!r}", FailureReason.NOT_FOUND)
        options = dict(orders["options"])
        if orders["plugin"] == "python":
            options.setdefault("path", [self._modules])
        with self._lock:
            leaving = [one for one in self._served if one.name == name and one.is_leaving]
        for one in leaving:
            one.end()
        served = Served(
            self._registry, BridgeSpec(name, orders["plugin"], options), self._part(orders)
        )
        with self._lock:
            self._served = [one for one in self._served if not one.has_left]
            self._served.append(served)
        if self._closed.is_set():
            served.end()

    def _part(self, orders: Orders) -> Link:
        prefix: str = orders["prefix"]
        expected = _keys.talk(self._machine, orders["name"], "")
        if not prefix.startswith(expected):
            raise BridgeError(f"orders behind {prefix!r}, expected {expected}...")
        return self._link.part(prefix)


def _require_same_version(orders: Orders) -> None:
    ours = {"link": _keys.LINK_VERSION, "contract": CONTRACT_VERSION}
    for what, version in ours.items():
        if orders.get(what) != version:
            text = (
                f"the host has uoarm {__version__} with {what} version {version}, the manager has "
                f"{orders.get(what)}: install the same uoarm on both machines"
            )
            raise BridgeError(text, FailureReason.UNSUPPORTED)
