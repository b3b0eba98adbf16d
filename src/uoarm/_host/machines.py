"""Hosts on other machines: the registry of those that joined, and the connection to one bridge."""

from __future__ import annotations

import threading
import time
import uuid
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any

from attrs import evolve

from uoarm._host.process_connection import HostSettings
from uoarm._host.transport import keys
from uoarm._host.transport.liveness import HostConnection, LivenessMonitor
from uoarm._host.transport.transport import Reply
from uoarm._host.transport.zenoh_transport import (
    MANAGER,
    Identity,
    ZenohTransport,
    access_list,
    certified,
)
from uoarm._raised import on_failure
from uoarm.bridge import CONTRACT_VERSION
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import BridgeSpec, Listening

_JOIN_SECONDS = 2.0


class MachineConnection(HostConnection):
    """Has a host on another machine take up a bridge, and returns when it has.

    The host was started there and stays there: nothing here starts, kills or restarts it. With
    `close` it is asked to let the bridge go.

    Args:
        registry: knows which hosts are there.
        settings: of the host; `silence` and `start` count.
        on_answer: called with what every answer to a heartbeat holds.
        on_doubt: called when it does not answer, or does again, and the cause.
        on_death: called once with why it was lost; `dead` is set already.
        on_health: takes what the bridge reports, from before it is ready on.

    Raises:
        UoarmError: what making the bridge there raised.
        BridgeError: no such host has joined, or one with another version.
        BridgeTimeoutError: the bridge was not ready in time.
    """

    def __init__(
        self,
        registry: MachineRegistry,
        machine: str,
        spec: BridgeSpec,
        settings: HostSettings,
        *,
        on_answer: Callable[[Any], None],
        on_doubt: Callable[[bool, str], None],
        on_death: Callable[[str], None],
        on_health: Callable[[Mapping[str, Any], Reply], None],
    ) -> None:
        self._subject = f"machine {machine!r}"
        super().__init__(LivenessMonitor(spec.name, on_doubt, on_death))
        host = registry.find(machine, spec.name, settings.start)
        if host is None:
            text = f"no host of {self._subject} is there for bridge {spec.name!r}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        try:
            registry.measure_clock(machine, host, min(settings.silence, settings.start))
        except BridgeError as error:
            text = f"the host of {self._subject} does not answer"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error
        self._registry = registry
        registry.hold(self)
        deadline = time.monotonic() + settings.start
        prefix = keys.bridge_prefix(machine, spec.name, uuid.uuid4().hex[:12])
        self.transport = registry.part(prefix)
        self.transport.ahead = lambda: registry.offset(machine).nanoseconds
        with on_failure(self.close, None):
            self.transport.show_alive(keys.MANAGED)
            self.transport.watch_alive(keys.ALIVE, self._seen)
            self.transport.answer(keys.HEALTH, on_health)
            orders = {
                "protocol": keys.PROTOCOL_VERSION,
                "contract": CONTRACT_VERSION,
                "prefix": prefix,
                "bridge": evolve(spec, folder="").to_host(),  # a folder of this machine
            }
            registry.attach(machine, host, orders, settings.start)
            self._liveness.await_token(deadline)
            self.greeting = self._liveness.greet(self.transport, deadline)
            self._begin_heartbeat(
                spec.name, silence=settings.silence, on_answer=on_answer, on_silence=self._give_up
            )

    @property
    def process(self) -> int:
        """Refuse: the process belongs to the other machine.

        Raises:
            BridgeError: always.
        """
        text = f"the host is a process of {self._subject}: it is not started or killed from here"
        raise BridgeError(text, FailureReason.UNSUPPORTED)

    def close(self, say_close: Callable[[], object] | None) -> None:
        """Let the bridge go: the host closes it, and waits for the next manager.

        Raises:
            UoarmError: the bridge failed while closing; it was let go all the same.
        """
        try:
            super().close(say_close)
        finally:
            self._registry.let_go(self)

    def _seen(self, present: bool) -> None:  # noqa: FBT001 - a callback
        self._liveness.seen(present)
        if not present:
            self._liveness.die(f"{self._subject} has left, or the link to it is cut")

    def _give_up(self, silent: float) -> None:
        self._liveness.die(f"{self._subject} has not answered for {silent:.1f} s")


_CLOCK_SECONDS = 1.0
_ANSWER_SECONDS = 0.5
_MOST_HOSTS = 64
_MOST_BRIDGES = 1024
_END_OF_TIME = 2**63  # in nanoseconds, in the year 2262
_SET_NANOSECONDS = 50_000_000
_KEPT = 16


class MachineRegistry:
    """Waits for hosts on other machines at one address, from its making until it is closed.

    The link itself keeps out clients without a certificate, and each machine from the keys of
    others. It knows the machines that are watched at first, and those that had a certificate in
    the folder then: only these can be watched later.

    Args:
        listening: the address, and the folder of the manager's certificate.
        machines: the names that may join, see `watch`.
        changed: called in the transport's thread when a host of a machine has come or gone: with
            the machine's name, and the bridge that it serves, None for every one. Must not block.

    Attributes:
        closed: set once it is closed.

    Raises:
        BridgeError: the address cannot be had, or the certificate not be used.
    """

    def __init__(
        self,
        listening: Listening,
        machines: Iterable[str],
        changed: Callable[[str, str | None], None],
    ) -> None:
        names = frozenset(machines)
        self._admitted: frozenset[str] | None = None
        if listening.certificates is None:
            more = dict(access_list(None))
        else:
            self._admitted = names | certified(listening.certificates)
            identity = Identity.find(listening.certificates, MANAGER)
            more = {**access_list(self._admitted), **identity.settings(listen=True)}
        self._changed = changed
        self._news = threading.Condition()
        self._watching = threading.Lock()
        self._watched: dict[str, Callable[[], None]] = {}
        self._hosts: dict[str, list[tuple[str, str]]] = {}
        self._came: dict[str, set[str]] = {}
        self._since: dict[str, float] = {}
        self._offsets: defaultdict[str, ClockOffset] = defaultdict(ClockOffset)
        self._users: set[object] = set()
        self._is_retired = False
        self._stopped = threading.Event()
        self.closed = threading.Event()
        self._whole = ZenohTransport(
            listening.place, listen=True, lease=listening.silence, more=more
        )
        self._whole.clock = time.time_ns
        self._transport = self._whole.part(keys.MACHINES)
        self.watch(names)
        self._asking = threading.Thread(
            target=self._ask_for_times, name="uoarm-clocks", daemon=True
        )
        self._asking.start()

    def can_watch(self, machines: Iterable[str]) -> bool:
        """Say whether the link would let these machines join."""
        return self._admitted is None or self._admitted.issuperset(machines)

    def watch(self, machines: Iterable[str]) -> None:
        """Let these machines join and no others: what others say is not read.

        Raises:
            BridgeError: the link is closed.
        """
        with self._watching:
            names = set(machines)
            for name in set(self._watched) - names:
                self._watched.pop(name)()
                with self._news:
                    self._hosts.pop(name, None)
            for name in names - set(self._watched):
                with self._news:
                    self._hosts[name], self._came[name] = [], set()
                    self._since[name] = time.monotonic()
                tokens = keys.here(name, "*", "*")
                self._watched[name] = self._transport.watch_tokens(tokens, self._seen)

    def hold(self, user: object) -> None:
        """Have a user, for whom it stays open after `retire`, until `let_go`."""
        with self._news:
            self._users.add(user)

    def let_go(self, user: object) -> None:
        """Have a user less; the last one closes what is retired. Idempotent."""
        with self._news:
            self._users.discard(user)
            is_over = self._is_retired and not self._users
        if is_over:
            self.close()

    def retire(self) -> None:
        """Take no more hosts, and close with the last user. Idempotent."""
        with self._news:
            self._is_retired = True
            is_over = not self._users
        if is_over:
            self.close()

    def find(self, machine: str, bridge: str, patience: float) -> str | None:
        """Return the name of the host that serves a bridge, None when none comes in time.

        Waits for the first one until hosts of this machine could join for `patience` seconds. Who
        has not joined by then, or has left again, is not waited for.
        """
        with self._news:
            deadline = self._since.get(machine, 0.0) + patience
            self._news.wait_for(
                lambda: (
                    self._stopped.is_set()
                    or not self._came.get(machine, set()).isdisjoint({bridge, keys.ANY_BRIDGE})
                ),
                max(0.0, deadline - time.monotonic()),
            )
            return self._serving(machine, bridge)

    def here(self, machine: str, bridge: str) -> bool:
        """Say whether a host that serves this bridge is there now."""
        with self._news:
            return self._serving(machine, bridge) is not None

    def part(self, prefix: str) -> ZenohTransport:
        """Return a transport to what lies behind a prefix of the keys of machines."""
        return self._transport.part(prefix)

    def measure_clock(self, machine: str, host: str, timeout: float) -> None:
        """Ask a host for its time, to which one that hangs does not answer.

        Raises:
            BridgeError: UNAVAILABLE when the host has gone.
            BridgeTimeoutError: no answer in time.
        """
        asked, began = time.time_ns(), time.monotonic_ns()
        theirs = self._transport.ask(keys.clock(machine, host), None, timeout=timeout)
        if type(theirs) is int and 0 <= theirs < _END_OF_TIME:
            self._offsets[machine].add(asked, theirs, time.time_ns(), time.monotonic_ns() - began)

    def attach(self, machine: str, host: str, orders: object, timeout: float) -> None:
        """Have a host make a bridge.

        Raises:
            UoarmError: what making it raised.
            BridgeError: UNAVAILABLE when the host has gone.
        """
        self._transport.ask(keys.attach(machine, host), orders, timeout=timeout)

    def offset(self, machine: str) -> ClockOffset:
        """Return what is known of a machine's clock; it goes on learning."""
        return self._offsets[machine]

    def close(self) -> None:
        """Let every machine go. Idempotent."""
        self._stopped.set()
        with self._news:
            self._news.notify_all()
        if threading.current_thread() is not self._asking:
            self._asking.join(_JOIN_SECONDS)
        try:
            self._whole.close()
        finally:
            self.closed.set()

    def _serving(self, machine: str, bridge: str) -> str | None:
        """Return the newest host that serves just this bridge, else the newest that serves all."""
        newest = self._hosts.get(machine, [])[::-1]
        just = (host for served, host in newest if served == bridge)
        every = (host for served, host in newest if served == keys.ANY_BRIDGE)
        return next(just, next(every, None))

    def _seen(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback
        machine, _, bridge, host = key.split("/")
        with self._news:
            hosts = self._hosts.get(machine)
            if hosts is None:
                return
            if (bridge, host) in hosts:
                hosts.remove((bridge, host))
            if present and len(hosts) < _MOST_HOSTS and not self._is_retired:
                hosts.append((bridge, host))
                if len(self._came[machine]) < _MOST_BRIDGES:
                    self._came[machine].add(bridge)
            if not hosts:
                self._offsets[machine].clear()
            self._news.notify_all()
        self._changed(machine, None if bridge == keys.ANY_BRIDGE else bridge)

    def _ask_for_times(self) -> None:
        while not self._stopped.wait(_CLOCK_SECONDS):
            with self._news:
                present = {name: value[-1][1] for name, value in self._hosts.items() if value}
            for machine, host in present.items():
                with suppress(
                    UoarmError
                ):  # the connections to the machine notice that it is silent
                    self.measure_clock(machine, host, _ANSWER_SECONDS)


class ClockOffset:
    """Keeps the last answers to "what time is it", and trusts the one that was quickest.

    The true offset is within half of that answer's round trip. Clocks drift, so old answers go.
    """

    def __init__(self) -> None:
        self._answers: tuple[tuple[int, int], ...] = ()

    def add(self, asked: int, theirs: int, answered: int, took: int | None = None) -> None:
        """Take one answer: our times of question and answer and theirs between, nanoseconds.

        With `took`, the same time by a clock that cannot be set, an answer during which our clock
        was set is thrown away, and so are those before it, which knew the clock as it was.
        """
        if took is not None and abs(answered - asked - took) > _SET_NANOSECONDS:
            self.clear()
            return
        answer = max(0, answered - asked), theirs - (asked + answered) // 2
        self._answers = (*self._answers[1 - _KEPT :], answer)

    def clear(self) -> None:
        """Forget everything: the machine may come back with another clock."""
        self._answers = ()

    @property
    def known(self) -> bool:
        """Whether there was an answer."""
        return bool(self._answers)

    @property
    def nanoseconds(self) -> int:
        """By how much their clock is ahead of ours; 0 while nothing is known."""
        return min(self._answers, default=(0, 0))[1]

    @property
    def round_trip(self) -> int:
        """The quickest round trip, nanoseconds; the offset is right to half of it."""
        return min(self._answers, default=(0, 0))[0]
