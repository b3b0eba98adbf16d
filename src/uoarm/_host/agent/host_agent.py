"""A host that joins by itself: the bridges of one machine, for a manager on another one."""

from __future__ import annotations

import os
import threading
import time
import uuid
from collections.abc import Collection, Mapping
from threading import Event
from typing import Any

from attrs import evolve

from uoarm._host.agent.dispatcher import RequestDispatcher
from uoarm._host.transport import keys
from uoarm._host.transport.transport import Reply, RequestWorkers
from uoarm._host.transport.zenoh_transport import Identity, ZenohTransport
from uoarm._raised import Log, on_failure
from uoarm._version import __version__
from uoarm.bridge import CONTRACT_VERSION, Registry
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import BridgeSpec

_TRY_SECONDS = 2.0
_AGAIN_SECONDS = 0.3
_UNASKED_SECONDS = 5.0  # several times as long as a manager takes to ask; half of `start`
_log = Log("uoarm")

Orders = Mapping[str, Any]
_CLOSE_SECONDS = 5.0


class HostAgent:
    """Makes the bridges that the manager asks for, until it is closed.

    Each is made when the manager takes it up and closed when the manager lets it go, dies, or can
    no longer be reached; then the host waits for it to come back.

    Args:
        address: where the manager listens.
        machine: the name of this machine, as its certificate and the configuration have it.
        identity: its certificate; None without TLS.
        bridges: names of the bridges to serve; empty: every one of this machine.
        modules: folder of the components of `python` bridges that name no other.
        silence: seconds without a sign of life after which the link counts as cut.
    """

    def __init__(
        self,
        address: str,
        machine: str,
        *,
        identity: Identity | None,
        bridges: Collection[str] = (),
        modules: str = ".",
        silence: float = 3.0,
        registry: Registry | None = None,
    ) -> None:
        self._address = address
        self._machine = machine
        self._more = {} if identity is None else identity.settings(listen=False)
        self._bridges = tuple(bridges) or (keys.ANY_BRIDGE,)
        self._modules = os.path.realpath(modules)
        self._silence = silence
        self._registry = registry or Registry()
        self._name = uuid.uuid4().hex[:12]
        self._workers = RequestWorkers("uoarm-attach")
        self._lock = threading.Lock()
        self._hosted: list[HostedBridge] = []
        self._asked = Event()
        self._closed = Event()
        self._warned = False

    def run(self) -> None:
        """Join, and serve until `close` is called from another thread or a signal's handler."""
        while (whole := self._connect()) is not None:
            try:
                if self._is_asked(whole):
                    self._closed.wait()
                    return
                # Where the manager listened anew while the link was made, it may never see the
                # token of this host.
            finally:
                with self._lock:
                    hosted = list(self._hosted)
                for hosted_bridge in hosted:
                    hosted_bridge.let_go()  # all at once, since each may take its time
                for hosted_bridge in hosted:
                    hosted_bridge.end()
                if self._closed.is_set():
                    self._workers.close()
                whole.close()

    def close(self) -> None:
        """Have `run` close every bridge and return. From any thread; idempotent."""
        self._closed.set()
        self._asked.set()

    def _is_asked(self, whole: ZenohTransport) -> bool:
        """Show over a link which bridges are here; False if the manager asks for none in time."""
        _log.info("the manager at %s is reached", self._address)
        transport = self._transport = whole.part(keys.MACHINES)
        transport.answer(keys.attach(self._machine, self._name), self._take)
        transport.answer(keys.clock(self._machine, self._name), self._answer_time)
        for bridge in self._bridges:
            transport.show_alive(keys.here(self._machine, bridge, self._name))
        is_asked = self._asked.wait(_UNASKED_SECONDS)
        if not is_asked and not self._warned:
            self._warned = True
            _log.warning(
                "%s is reached, but does not ask: does its configuration know the machine %r, "
                "and is this the name in the certificate?",
                self._address,
                self._machine,
            )
        return is_asked

    def _connect(self) -> ZenohTransport | None:
        """Try until the manager is there; what is in the way is logged once, not at each try."""
        text = ""
        while not self._closed.is_set():
            try:
                whole = ZenohTransport(
                    self._address,
                    listen=False,
                    timeout=_TRY_SECONDS,
                    lease=self._silence,
                    more=self._more,
                )
            except BridgeError as error:
                if str(error) != text:
                    text = str(error)
                    _log.warning(
                        "waiting for the manager at %s: it is not there, or the two do not "
                        "believe each other's certificates (%s)",
                        self._address,
                        text,
                    )
                self._closed.wait(_AGAIN_SECONDS)
            else:
                whole.clock = time.time_ns
                return whole
        return None

    def _answer_time(self, _: Any, reply: Reply) -> None:
        reply(time.time_ns())
        self._asked.set()

    def _take(self, orders: Orders, reply: Reply) -> None:
        self._workers.answer(reply, lambda: self._attach(orders))

    def _attach(self, orders: Orders) -> None:
        """Make a bridge, after older ones of this name that are on their way out."""
        _require_same_version(orders)
        # A folder of the manager's machine says nothing here.
        spec = evolve(BridgeSpec.in_host(orders["bridge"]), folder="")
        name = spec.name
        if not {name, keys.ANY_BRIDGE} & set(self._bridges):
            raise BridgeError(f"this host does not serve {name!r}", FailureReason.NOT_FOUND)
        if spec.plugin == "python":
            spec = evolve(spec, options={"path": [self._modules], **spec.options})
        with self._lock:
            ending = [
                hosted_bridge
                for hosted_bridge in self._hosted
                if hosted_bridge.name == name and hosted_bridge.is_ending
            ]
        for hosted_bridge in ending:
            hosted_bridge.end()
        hosted = HostedBridge(self._registry, spec, self._part(name, orders["prefix"]))
        with self._lock:
            self._hosted = [
                hosted_bridge for hosted_bridge in self._hosted if not hosted_bridge.is_closed
            ]
            self._hosted.append(hosted)
        if self._closed.is_set():
            hosted.end()

    def _part(self, name: str, prefix: str) -> ZenohTransport:
        expected = keys.bridge_prefix(self._machine, name, "")
        if not prefix.startswith(expected):
            raise BridgeError(f"orders behind {prefix!r}, expected {expected}...")
        return self._transport.part(prefix)


def _require_same_version(orders: Orders) -> None:
    ours = {"protocol": keys.PROTOCOL_VERSION, "contract": CONTRACT_VERSION}
    for what, version in ours.items():
        if orders.get(what) != version:
            text = (
                f"the host has uoarm {__version__} with {what} version {version}, the manager has "
                f"{orders.get(what)}: install the same uoarm on both machines"
            )
            raise BridgeError(text, FailureReason.UNSUPPORTED)


class HostedBridge:
    """One bridge while one manager uses it; closed when the manager says so, or its token goes.

    Args:
        transport: to the manager, for this bridge alone; closed with it.

    Raises:
        UoarmError: the bridge could not be made.
    """

    def __init__(self, registry: Registry, spec: BridgeSpec, transport: ZenohTransport) -> None:
        self.name = spec.name
        self._transport = transport
        self._ended = Event()
        with on_failure(transport.close):
            transport.watch_alive(keys.MANAGED, self._managed)
            self._bridge = registry.create(spec)
        self._serving = RequestDispatcher(self._bridge, transport, self._ended.set)
        self._thread = threading.Thread(
            target=self._wait, name=f"uoarm-served-{spec.name}", daemon=True
        )
        # The manager may go meanwhile, or the system give no more threads.
        with on_failure(self._wait), on_failure(self._ended.set):
            self._serving.begin()
            self._thread.start()
        _log.info("bridge %s is taken up", self.name)

    @property
    def is_ending(self) -> bool:
        """Whether its manager has gone, or let it go."""
        return self._ended.is_set()

    @property
    def is_closed(self) -> bool:
        return not self._thread.is_alive()

    def let_go(self) -> None:
        """Begin to close the bridge; returns at once."""
        self._ended.set()

    def end(self) -> None:
        """Close the bridge and wait until that is done, five seconds at most."""
        self.let_go()
        self._thread.join(_CLOSE_SECONDS)

    def _managed(self, present: bool) -> None:  # noqa: FBT001 - a callback
        if not present:
            self._ended.set()

    def _wait(self) -> None:
        self._ended.wait()
        try:
            self._bridge.close()
        except UoarmError as error:
            _log.warning("%s", error)
        self._serving.end()
        self._transport.close()
        _log.info("bridge %s is let go", self.name)
