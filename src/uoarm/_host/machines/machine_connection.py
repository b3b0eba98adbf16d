"""One bridge on another machine, from the time its host takes it up until it is let go or lost."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from uoarm._host.process.settings import HostSettings
from uoarm._host.transport import keys
from uoarm._host.transport.liveness import Heartbeat, LivenessMonitor
from uoarm._host.transport.shared_counters import SharedCounters
from uoarm._host.transport.transport import Transport
from uoarm.bridge import CONTRACT_VERSION
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import BridgeSpec

if TYPE_CHECKING:
    from uoarm._host.machines.registry import MachineRegistry

__all__ = ["MachineConnection"]

_JOIN_SECONDS = 2.0


class MachineConnection:
    """Has a host on another machine take up a bridge, and returns when it has.

    The host was started there and stays there: nothing here starts, kills or restarts it. What it
    is told to do with `close` is to let the bridge go.

    Args:
        registry: knows which hosts are there.
        machine: its name.
        spec: the bridge.
        settings: of the host; `silence` and `start` count.
        on_answer: called with what every answer to a heartbeat holds.
        on_doubt: called when it does not answer, or does again, and the cause.
        on_death: called once with why it was lost; `dead` is set already.

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
    ) -> None:
        self._subject = f"machine {machine!r}"
        self._liveness = LivenessMonitor(spec.name, on_doubt, on_death)
        self._heartbeat: Heartbeat | None = None
        self.counters: SharedCounters | None = None  # no memory is shared with another machine
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
        self.transport: Transport = registry.part(prefix)
        self.transport.ahead = lambda: registry.offset(machine).nanoseconds
        try:
            self.transport.show_alive(keys.MANAGED)
            self.transport.watch_alive(keys.ALIVE, self._seen)
            orders = {
                "protocol": keys.PROTOCOL_VERSION,
                "contract": CONTRACT_VERSION,
                "prefix": prefix,
                "name": spec.name,
                "plugin": spec.plugin,
                "options": dict(spec.options),
            }
            registry.attach(machine, host, orders, settings.start)
            self._liveness.await_token(deadline)
            self.greeting = self._liveness.greet(self.transport, deadline)
        except BaseException:
            self.close(None)
            raise
        self._heartbeat = Heartbeat(
            spec.name,
            self.transport,
            silence=settings.silence,
            on_answer=on_answer,
            on_doubt=self._liveness.doubt,
            on_silence=self._give_up,
        )
        self._heartbeat.start()

    @property
    def dead(self) -> str:
        """Why the host was lost, "" while it is there."""
        return self._liveness.dead

    @property
    def process(self) -> int:
        """Refuse: the process belongs to the other machine.

        Raises:
            BridgeError: always.
        """
        text = f"the host is a process of {self._subject}: it is not started or killed from here"
        raise BridgeError(text, FailureReason.UNSUPPORTED)

    def ask(self, operation: str, values: Mapping[str, Any]) -> Any:
        """Ask the host for one operation of the contract; waits two minutes at most.

        Raises:
            UoarmError: what the bridge raised.
            BridgeError: UNAVAILABLE when the host is lost; the text says why.
        """
        return self._liveness.ask(self.transport, operation, values)

    def close(self, say_close: Callable[[], object] | None) -> None:
        """Let the bridge go: the host closes it, and waits for the next manager.

        Raises:
            UoarmError: the bridge failed while closing; it was let go all the same.
        """
        self._liveness.expect_end()
        if self._heartbeat is not None:
            self._heartbeat.stop()
        try:
            if say_close is not None and not self.dead:
                say_close()
        finally:
            if self._heartbeat is not None:
                self._heartbeat.join(_JOIN_SECONDS)
            self.transport.close()
            self._registry.let_go(self)

    def _seen(self, present: bool) -> None:  # noqa: FBT001 - a callback
        self._liveness.seen(present)
        if not present:
            self._liveness.die(f"{self._subject} has left, or the link to it is cut")

    def _give_up(self, silent: float) -> None:
        self._liveness.die(f"{self._subject} has not answered for {silent:.1f} s")
