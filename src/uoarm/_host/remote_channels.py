"""The manager's side of the channels that are open in a host."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uoarm._host.transport.flow import FlowReceiver, FlowSender
from uoarm._host.transport.keys import COMMAND
from uoarm._host.transport.shared_counters import SharedCounter
from uoarm.bridge import Channel, Outcomes, Sink, Source
from uoarm.errors import UoarmError
from uoarm.model import CommandStatus, Endpoint, Message, from_json

__all__ = ["AskChannel", "RemoteChannel", "RemoteSink", "RemoteSource"]

AskChannel = Callable[..., object]
"""Asks the host: an operation, then named values."""


class RemoteChannel(Channel):
    """A channel in a host through which no message of ours passes: a service, a native link.

    Args:
        endpoint: where it is open.
        number: its number in the host.
        ask: asks the host.
        when_closed: what else ends with it.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        number: int,
        ask: AskChannel,
        when_closed: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(endpoint)
        self.number = number
        self._ask = ask
        self._finally = when_closed
        self.host_facts: Mapping[str, object] = {}
        self._taken: int | None = None  # by its source in the host, once that is closed

    def facts(self) -> Mapping[str, object]:
        """Return what the host's framework knew of the link a second ago at most."""
        return self.host_facts

    def _close(self) -> None:
        try:
            taken = self._ask("close_channel", flow=self.number, sent=self._sent())
            self._taken = taken if isinstance(taken, int) else None
        finally:
            self._finally()

    def _sent(self) -> int:
        return 0

    def _lost_in_host(self) -> int:
        """Return what the bridge in the host says to have lost between it and its framework."""
        lost = self.host_facts.get("lost_on_link", 0)
        return lost if isinstance(lost, int) else 0


class RemoteSource(RemoteChannel, Source):
    """An output in a host; its messages arrive in a thread of their own.

    Attributes:
        counter: of the messages that the host took from its component; None: not known.
        given: how many were handed on.
    """

    incoming: FlowReceiver
    counter: SharedCounter | None = None
    given: int = 0

    def facts(self) -> Mapping[str, object]:
        """Return the host's facts, and what was lost on the link; latency in seconds."""
        given, lost = self.given, self.incoming.lost
        # Of one on another machine that is known at its end only.
        taken = self._taken or 0 if self.counter is None else self.counter.read()
        ours = {
            "under_way": max(0, taken - given - lost),
            "lost_on_link": lost + self._lost_in_host(),
            "link_latency": self.incoming.latency,
        }
        return {**self.host_facts, **ours}

    def drain(self, timeout: float) -> bool:
        """Wait until every message that the host has sent by now is delivered."""
        try:
            sent = self._ask("sent", flow=self.number, timeout=timeout)
        except UoarmError:
            return False
        return not isinstance(sent, int) or self.incoming.drain(sent, timeout)

    def _close(self) -> None:
        self.incoming.close()
        super()._close()


class RemoteSink(RemoteChannel, Sink):
    """An input in a host.

    `send` waits for room for 10 s at most where the host's own sink may block, else for 0.2 s.

    Attributes:
        counter: of the messages that the component in the host took; None: not known at once.
    """

    outgoing: FlowSender
    counter: SharedCounter | None = None

    def facts(self) -> Mapping[str, object]:
        """Return the host's facts, and what became of the messages sent."""
        outgoing = self.outgoing
        under_way = outgoing.unconfirmed
        if self.counter is not None:
            under_way = max(0, outgoing.sent - outgoing.lost - self.counter.read())
        ours = {
            "under_way": under_way,
            "lost_on_link": outgoing.lost + self._lost_in_host(),
            "failed_in_host": outgoing.failed,
            "last_error_in_host": outgoing.last_error,
        }
        return {**{k: v for k, v in self.host_facts.items() if k != COMMAND}, **ours}

    def watch(self, report: Outcomes) -> bool:
        """Have reported what the host says became of messages."""
        self.outgoing.watch(report)
        return True

    def hold(self, timeout: float) -> CommandStatus | None:
        """Have the host stop it; raises what becomes of asking it.

        Raises:
            BridgeError: the host did not answer: it may move until its lifetime is over.
        """
        held = self._ask("hold", flow=self.number, timeout=timeout)
        return None if held is None else from_json(held, CommandStatus)

    def halt(self, timeout: float) -> CommandStatus | None:
        """Have the host stop it, behind the commands that were sent by now, too.

        Raises:
            BridgeError: the host did not answer: it may move until its lifetime is over.
        """
        sent = self.outgoing.sent
        halted = self._ask("halt", flow=self.number, sent=sent, timeout=timeout)
        return None if halted is None else from_json(halted, CommandStatus)

    def release(self) -> None:
        """Have the host let commands through again."""
        self._ask("release", flow=self.number)

    def command_status(self) -> CommandStatus | None:
        """Return what the host said of it with its last heartbeat."""
        report = self.host_facts.get(COMMAND)
        return None if report is None else from_json(report, CommandStatus)

    def drain(self, timeout: float) -> bool:
        """Wait until the component has taken every message that was sent by now."""
        try:
            sent = self.outgoing.sent
            return bool(self._ask("drain", flow=self.number, sent=sent, timeout=timeout))
        except UoarmError:
            return False

    def _close(self) -> None:
        try:
            super()._close()
        finally:
            self.outgoing.close()

    def _send(self, message: Message) -> None:
        """Send one message to the host, where it is handed to the component."""
        self.outgoing.send(message)

    def _sent(self) -> int:
        return self.outgoing.sent
