"""One bridge on another machine, from the time its host takes it up until it is let go or lost."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping
from typing import Any

from uoarm._host import _keys
from uoarm._host._desk import MachineDesk
from uoarm._host._lifeline import Lifeline
from uoarm._host._link import Link
from uoarm._host._pulse import Pulse
from uoarm._host._settings import HostSettings
from uoarm._host._tally import Tally
from uoarm.bridge import CONTRACT_VERSION
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import BridgeSpec

__all__ = ["MachineConnection"]

_JOIN_SECONDS = 2.0


class MachineConnection:
    """Has a host on another machine take up a bridge, and returns when it has.

    The host was started there and stays there: nothing here starts, kills or restarts it. What it
    is told to do with `close` is to let the bridge go.

    Args:
        desk: knows which hosts are there.
        machine: its name.
        spec: the bridge.
        settings: of the host; `silence` and `start` count.
        heard: told what every answer of its pulse holds.
        doubted: told that it does not answer, or does again, and the cause.
        died: told once why it was lost; `dead` is set already.

    Raises:
        UoarmError: what making the bridge there raised.
        BridgeError: no such host has joined, or one with another version.
        BridgeTimeoutError: the bridge was not ready in time.
    """

    def __init__(
        self,
        desk: MachineDesk,
        machine: str,
        spec: BridgeSpec,
        settings: HostSettings,
        *,
        heard: Callable[[Any], None],
        doubted: Callable[[bool, str], None],
        died: Callable[[str], None],
    ) -> None:
        self._place = f"machine {machine!r}"
        self._life = Lifeline(spec.name, doubted, died)
        self._pulse: Pulse | None = None
        self.tally: Tally | None = None  # no memory is shared with another machine
        host = desk.find(machine, spec.name, settings.start)
        if host is None:
            text = f"no host of {self._place} is there for bridge {spec.name!r}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        try:
            desk.meet(machine, host, min(settings.silence, settings.start))
        except BridgeError as error:
            text = f"the host of {self._place} does not answer"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error
        deadline = time.monotonic() + settings.start
        prefix = _keys.talk(machine, spec.name, uuid.uuid4().hex[:12])
        self.link: Link = desk.part(prefix)
        self.link.ahead = lambda: desk.offset(machine).nanoseconds
        try:
            self.link.show_alive(_keys.MANAGED)
            self.link.watch_alive(_keys.ALIVE, self._seen)
            orders = {
                "link": _keys.LINK_VERSION,
                "contract": CONTRACT_VERSION,
                "prefix": prefix,
                "name": spec.name,
                "plugin": spec.plugin,
                "options": dict(spec.options),
            }
            desk.attach(machine, host, orders, settings.start)
            self._life.await_token(deadline)
            self.greeting = self._life.greet(self.link, deadline)
        except BaseException:
            self.close(None)
            raise
        self._pulse = Pulse(
            spec.name,
            self.link,
            silence=settings.silence,
            heard=heard,
            doubted=self._life.doubt,
            given_up=self._give_up,
        )
        self._pulse.start()

    @property
    def dead(self) -> str:
        """Why the host was lost, "" while it is there."""
        return self._life.dead

    @property
    def process(self) -> int:
        """Refuse: the process belongs to the other machine.

        Raises:
            BridgeError: always.
        """
        text = f"the host is a process of {self._place}: it is not started or killed from here"
        raise BridgeError(text, FailureReason.UNSUPPORTED)

    def ask(self, operation: str, values: Mapping[str, Any]) -> Any:
        """Ask the host for one operation of the contract; waits two minutes at most.

        Raises:
            UoarmError: what the bridge raised.
            BridgeError: UNAVAILABLE when the host is lost; the text says why.
        """
        return self._life.ask(self.link, operation, values)

    def close(self, say_close: Callable[[], object] | None) -> None:
        """Let the bridge go: the host closes it, and waits for the next manager.

        Raises:
            UoarmError: the bridge failed while closing; it was let go all the same.
        """
        self._life.give_back()
        if self._pulse is not None:
            self._pulse.stop()
        try:
            if say_close is not None and not self.dead:
                say_close()
        finally:
            if self._pulse is not None:
                self._pulse.join(_JOIN_SECONDS)
            self.link.close()

    def _seen(self, present: bool) -> None:  # noqa: FBT001 - told, not asked
        self._life.seen(present)
        if not present:
            self._life.die(f"{self._place} has left, or the link to it is cut")

    def _give_up(self, silent: float) -> None:
        self._life.die(f"{self._place} has not answered for {silent:.1f} s")
