"""The channels that a host has open for its manager, by number, and their flows."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from attrs import astuple, define, field

from uoarm._host import _keys
from uoarm._host._codec import pack
from uoarm._host._flow import Ending, Incoming, Outgoing
from uoarm._host._link import Link
from uoarm._host._tally import Counter, Tally
from uoarm.bridge import Channel, Sink
from uoarm.errors import BridgeError, UoarmError
from uoarm.model import Endpoint, Message

__all__ = ["Leaving", "OpenFlows"]

_PATIENCE_SECONDS = 1.0
_log = logging.getLogger("uoarm")


class Leaving:
    """The messages of one source on their way to the manager.

    Args:
        endpoint: of the source.
        outgoing: the flow.
        counter: where how many messages the source has delivered is written down.

    Attributes:
        channel: the source, from when it is open.
    """

    def __init__(self, endpoint: Endpoint, outgoing: Outgoing, counter: Counter | None) -> None:
        self.endpoint = endpoint
        self._counter = counter
        self._taken = 0
        self.channel: Channel | None = None
        self._outgoing = outgoing
        self._closed = False
        self._last_error = ""

    @property
    def sent(self) -> int:
        """How many messages were sent."""
        return self._outgoing.sent

    def deliver(self, message: Message) -> None:
        """Send one message. Never raises: what cannot be sent is counted as lost."""
        if self._counter is not None:
            self._taken += 1
            self._counter.set(self._taken)
        try:
            self._outgoing.send(message)
        except UoarmError as error:
            self._outgoing.skip()
            if not self._closed and str(error) != self._last_error:
                self._last_error = str(error)
                _log.warning("%s: a message is lost: %s", self.endpoint, error)

    def finish(self, ending: Ending) -> None:
        """Have the manager told, behind the last message, that the source has ended."""
        try:
            self._outgoing.finish(ending)
        except BridgeError as error:
            _log.warning("%s: its end was not told: %s", self.endpoint, error)

    def close(self) -> None:
        """Send nothing more."""
        self._closed = True
        self._outgoing.close()


@define
class _Open:
    channel: Channel
    leaving: Leaving | None = None
    arriving: Incoming | None = None
    facts: Mapping[str, object] = field(factory=dict)


class OpenFlows:
    """Opens, lists and closes flows. All methods may be called from any thread."""

    def __init__(self, link: Link, tally: Tally | None) -> None:
        self._link = link
        self._tally = tally
        self._lock = threading.Lock()
        self._open: dict[int, _Open] = {}
        self._opening: list[Leaving] = []

    @contextmanager
    def leaving(self, number: int, slot: int | None, endpoint: Endpoint) -> Iterator[Leaving]:
        """Make the flow of a source, which the caller opens meanwhile and sets `channel` to."""
        outgoing = Outgoing(self._link, _keys.flow(number), _PATIENCE_SECONDS)
        leaving = Leaving(endpoint, outgoing, self._counter(slot))
        with self._lock:
            self._opening.append(leaving)
        try:
            yield leaving
        except BaseException:
            leaving.close()
            raise
        finally:
            with self._lock:
                self._opening.remove(leaving)
                if leaving.channel is not None:
                    self._open[number] = _Open(leaving.channel, leaving=leaving)

    def arriving(self, number: int, slot: int | None, sink: Sink) -> None:
        """Feed a sink with the messages of a flow from now on."""
        incoming = Incoming(
            self._link,
            _keys.flow(number),
            name=f"manager-{number}",
            take=sink.send,
            ended=lambda _: None,
            counter=self._counter(slot),
        )
        with self._lock:
            self._open[number] = _Open(sink, arriving=incoming)

    def plain(self, number: int, channel: Channel) -> None:
        """Keep a channel that has no flow."""
        with self._lock:
            self._open[number] = _Open(channel)

    def sent(self, number: int) -> int:
        """Return how many messages of a source were sent."""
        found = self._open.get(number)
        return 0 if found is None or found.leaving is None else found.leaving.sent

    def drain(self, number: int, sent: int, timeout: float) -> bool:
        """Wait until a sink has handled the messages up to the number `sent`."""
        found = self._open.get(number)
        return found is None or found.arriving is None or found.arriving.drain(sent, timeout)

    def number_of(self, channel: Channel) -> int | None:
        """Return the number of an open channel, None for one that is not listed."""
        with self._lock:
            return next((n for n, one in self._open.items() if one.channel is channel), None)

    def leaving_of(self, channel: Channel) -> Leaving | None:
        """Return the flow of a source, also of one whose opening has not returned yet."""
        with self._lock:
            for one in self._open.values():
                if one.channel is channel:
                    return one.leaving
            return next((one for one in self._opening if one.endpoint == channel.endpoint), None)

    def pulse(self) -> list[tuple[int, tuple[int, int, str, int] | None, Mapping[str, object]]]:
        """Return for every channel its number, how far a sink is, and the facts last looked at."""
        with self._lock:
            found = list(self._open.items())
        return [
            (n, None if one.arriving is None else astuple(one.arriving.handled()), one.facts)
            for n, one in found
        ]

    def look_at_facts(self) -> None:
        """Ask every channel for its facts; what one raises stands in their place."""
        with self._lock:
            found = list(self._open.values())
        for one in found:
            try:
                facts = dict(one.channel.facts())
                pack(facts)
            except Exception as error:  # noqa: BLE001 - a framework may raise anything
                facts = {"facts": f"{type(error).__name__}: {error}"}
            one.facts = facts

    def close(self, number: int, sent: int, timeout: float) -> None:
        """Close a channel and end its flow. Once is enough.

        A sink is given a second to handle the messages up to the number `sent`.

        Raises:
            BridgeError: the framework failed while closing; the flow has ended all the same.
        """
        with self._lock:
            found = self._open.pop(number, None)
        if found is None:
            return
        if found.arriving is not None:
            found.arriving.drain(sent, min(_PATIENCE_SECONDS, timeout / 2))
            found.arriving.close()
        try:
            found.channel.close(timeout=timeout)
        finally:
            if found.leaving is not None:
                found.leaving.close()

    def _counter(self, slot: int | None) -> Counter | None:
        return None if slot is None or self._tally is None else Counter(self._tally, slot)
