"""What clients send into inputs: read, checked and handed over in order, outside the loop."""

from __future__ import annotations

import itertools
import logging
import math
from collections import deque
from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

from attrs import define

from uoarm._control import Connection
from uoarm._raised import LimitedLog, foreign
from uoarm._wire import Form
from uoarm.bridge import boot_seconds, message_check
from uoarm.errors import CommandRefusedError, ConnectionClosedError, MessageError, UsageError
from uoarm.model import LeaseHolder, Message, MessageStructure
from uoarm.server._failures import BusyError
from uoarm.server.streams._memory import Account, Charge, MemoryUse
from uoarm.server.streams._workers import Workers

_log = logging.getLogger("uoarm.server")
_BATCH = 256
_BATCH_OCTETS = 1_048_576
_FLUSH_SECONDS = 2.0
_DRIFT = 1e-3  # seconds in a second by which two clocks may differ; far more than any do
_numbers = itertools.count(1)
Done: TypeAlias = Callable[[BaseException | None], None]
Read: TypeAlias = Callable[[MessageStructure, Message], Message]


class CommandAges:
    """Says how old a client's messages are, of one connection, by when it says it sent them.

    The clocks of both need not agree: the quickest message so far is taken to have come at once.
    So an age is never more than the true one, and less by what that quickest one took.

    It knows no clock: times are seconds of one clock here, and of one there.
    """

    def __init__(self) -> None:
        self._quickest, self._at = math.inf, 0.0  # the least difference of both clocks, and when

    def age(self, sent: object, now: float) -> float:
        """Return the age of a message that has come now; 0 where its client does not say.

        Args:
            sent: when, by the client's clock, as it says.
            now: the time here.
        """
        if not isinstance(sent, int | float) or not math.isfinite(sent):
            return 0.0
        difference = now - sent
        # What it was grows, or a clock that is slow there would make everything old in the end.
        quickest = self._quickest + (now - self._at) * _DRIFT
        self._quickest, self._at = min(quickest, difference), now
        return difference - self._quickest


@define
class _QueuedMessage:
    message: Message
    port: str | None
    done: Done
    charge: Charge
    take_over: bool
    sent: float
    ends_motion: bool
    is_stopped: bool = False


class InputSender:
    """One client's messages into one connection; all methods in the loop's thread.

    Every message is checked against the input's structure: what comes over the network is not
    trusted, whatever the connection was opened with.

    Args:
        read: makes the logical value of a message by the input's structure, in a worker.
        workers: where they are handed over, many in one go.
        account: of the client, charged until a message is handed over.
        limit: messages that may wait, and stops.
        holder: as whom it commands inputs that have a lease; None: as itself.
    """

    def __init__(
        self,
        connection: Connection,
        read: Read,
        workers: Workers,
        account: Account,
        *,
        limit: int,
        holder: LeaseHolder | None = None,
    ) -> None:
        self._records = LimitedLog(_log)
        self._connection = connection
        self._read = read
        self._workers = workers
        self._account = account
        self._limit = limit
        self._holder = holder or LeaseHolder(f"client {next(_numbers)} of {connection.id}")
        # What a worker has now; the loop may still mark it as stopped.
        self._handing: list[_QueuedMessage] = []
        # Before all that waits, and before the next batch; several inputs may be stopped.
        self._stops: deque[tuple[str | None, Done]] = deque()
        self._is_stopping_beside = False
        self._waiting: deque[_QueuedMessage] = deque()
        # Whether a worker or a stop is under way: one at a time, so that messages stay in order.
        self._running = False
        # Read by the worker without a lock: a message that it has begun with is handed over still.
        self._closed = False
        # One flush at a time: what is asked for meanwhile waits for the end of the same one.
        self._flushing = False
        self._after: list[Callable[[], None]] = []

    def send(
        self,
        message: Message,
        port: str | None,
        done: Done,
        octets: int,
        *,
        take_over: bool = False,
        age: float = 0.0,
        ends_motion: bool = False,
    ) -> None:
        """Hand one message over, after those before it; `done` is called with how it went.

        Args:
            message: as it came.
            port: name of the input; None for the only one.
            done: called once.
            octets: of memory that the message holds.
            take_over: whether to take the lease of the input, as `Connection.send` has it.
            age: seconds since it left its sender, as far as that is known.
            ends_motion: whether it cancels what moves: it has a thread, and room, whatever else
                waits. The caller bounds how many there are.

        Raises:
            BusyError: too many wait already, or every worker is taken; or the server is closing.
            LimitError: the client has too much memory held.
        """
        if ends_motion:
            charge = self._account.hold(MemoryUse.SENDING)
            charge.resize(octets)
        elif len(self._waiting) >= self._limit:
            raise BusyError(f"{self._limit} messages to {self._connection.id} wait already")
        else:
            # Charged before it is kept: a refusal leaves nothing behind.
            charge = self._account.charge(MemoryUse.SENDING, octets)
        sent = boot_seconds() - age
        queued = _QueuedMessage(message, port, done, charge, take_over, sent, ends_motion)
        self._waiting.append(queued)
        if not self._running:
            try:
                self._run()
            except BusyError:
                # The last is this very one: nothing ran, so that nothing else was added meanwhile.
                self._waiting.pop().charge.release()
                raise

    def stop(self, port: str | None, done: Done) -> None:
        """Stop an input, as `Connection.stop` does, beside whatever hangs; `done` as with `send`.

        What was sent before and is not handed over yet fails. What is sent afterwards waits.

        Raises:
            BusyError: too many wait already.
        """
        if len(self._stops) >= self._limit:
            raise BusyError(f"{self._limit} stops of {self._connection.id} wait already")
        # Those of the batch in the worker too: the worker looks at the mark of each before it hands
        # it over, so that a stop overtakes what is not with the component yet.
        for queued in (*self._handing, *self._waiting):
            queued.is_stopped = queued.is_stopped or queued.port == port
        self._stops.append((port, done))
        if not self._running:
            self._run()
        elif not self._is_stopping_beside:
            # At once, and in its turn again: a message that is being handed over may come between.
            self._is_stopping_beside = True
            stopping = self._workers.stop(lambda: self._halt(port))
            stopping.add_done_callback(lambda _: self._stopped_beside())

    def after(self, action: Callable[[], None]) -> None:
        """Do something once the component has taken all that was sent until now.

        A component that hangs is waited for two seconds only. Whatever else is to be done after it
        waits for the same flush.
        """
        # No flush is begun while messages are handed over: `_go_on` begins it after the last.
        self._after.append(action)
        if not self._running:
            self._flush()

    def close(self) -> None:
        """Hand over nothing more; what waits fails with that, and is released. Idempotent."""
        if self._closed:
            return
        # First: the worker looks at it before each message, and hands over nothing more.
        self._closed = True
        while self._stops:
            self._conclude(self._stops.popleft()[1], self._has_ended())
        if self._has_lease():
            self._workers.leave(lambda: self._connection.leave(self._holder))
        while self._waiting:
            queued = self._waiting.popleft()
            queued.charge.release()
            self._conclude(queued.done, self._has_ended())

    def structure(self, port: str | None) -> MessageStructure:
        """Return the structure of an input; None stands for the only one.

        Raises:
            UsageError: there is no such input for the application.
        """
        step = self._connection.plan.provider
        names = [input_.name for input_ in step.component.inputs if input_.source is None]
        name = names[0] if port is None and len(names) == 1 else port or "default"
        if name not in names:
            has = ", ".join(names) or "none"
            raise UsageError(f"{step.component.function!r} takes no {name!r}; its inputs: {has}")
        return step.structures[f"input.{name}"]

    def _flush(self) -> None:
        if self._flushing:
            return
        self._flushing = True
        flushed = self._workers.free(lambda: self._connection.flush(_FLUSH_SECONDS))
        flushed.add_done_callback(lambda _: self._flushed())

    def _flushed(self) -> None:
        # Before the actions, which may ask for another flush.
        self._flushing = False
        actions, self._after = self._after, []
        for action in actions:
            foreign(action)

    def _run(self) -> None:
        if self._stops:
            port, done = self._stops.popleft()
            self._running = True
            stopping = self._workers.stop(lambda: self._halt(port))
            stopping.add_done_callback(lambda ended: self._stopped(done, ended.result()))
            return
        batch = self._next_batch()

        def hand_over() -> list[BaseException | None]:
            return [self._hand_over(queued) for queued in batch]

        if any(queued.ends_motion for queued in batch):
            future = self._workers.stop(hand_over)
        else:
            # May refuse when nothing runs: then nothing was taken from the queue yet, and `send`
            # takes back what it added. What goes on is never refused.
            future = self._workers.start(hand_over, always=self._running)
        self._running = True
        self._handing = batch
        for _ in batch:
            self._waiting.popleft()
        future.add_done_callback(lambda done: self._handed(batch, done.result()))

    def _next_batch(self) -> list[_QueuedMessage]:
        """Return what waits, oldest first, up to a count and an amount of memory."""
        batch: list[_QueuedMessage] = []
        octets = 0
        for queued in self._waiting:
            octets += queued.charge.octets
            # The first goes whatever its size. More would keep a stop, and others, waiting.
            if batch and (octets > _BATCH_OCTETS or len(batch) == _BATCH):
                break
            batch.append(queued)
        return batch

    def _conclude(self, done: Done, outcome: BaseException | None) -> None:
        """Say how it went; one of a front end that raises holds up nothing that comes after it."""
        try:
            foreign(done, outcome)
        except Exception as error:  # noqa: BLE001 - it may raise anything
            text = "what a front end does after a message was sent failed"
            self._records.write(logging.ERROR, text, error)

    def _stopped(self, done: Done, outcome: BaseException | None) -> None:
        self._conclude(done, outcome)
        self._go_on()

    def _stopped_beside(self) -> None:
        self._is_stopping_beside = False

    def _halt(self, port: str | None) -> BaseException | None:
        """Return what went wrong with a stop, in a thread beside the loop's."""
        try:
            self._connection.stop(port, sender=self._holder)
        except Exception as error:  # noqa: BLE001 - reported to the one who asked
            return error
        return None

    def _has_lease(self) -> bool:
        ports = self._connection.plan.provider.component.inputs
        policies = (port.endpoint.command for port in ports if port.source is None)
        return any(policy is not None and policy.lease is not None for policy in policies)

    def _handed(self, batch: list[_QueuedMessage], outcomes: list[BaseException | None]) -> None:
        # Before the callbacks, which may send or stop again.
        self._handing = []
        for queued, outcome in zip(batch, outcomes, strict=True):
            queued.charge.release()
            self._conclude(queued.done, outcome)
        self._go_on()

    def _go_on(self) -> None:
        if self._waiting or self._stops:
            self._run()
            return
        self._running = False
        if self._after:
            self._flush()

    def _has_ended(self) -> ConnectionClosedError:
        cause = self._connection.cause or "kill"
        return ConnectionClosedError(f"connection {self._connection.id} has ended: {cause}")

    def _hand_over(self, queued: _QueuedMessage) -> BaseException | None:
        """Return what went wrong with one message, in a worker."""
        try:
            # Looked at here, and not when the batch was made: the loop may have set both since.
            if self._closed:
                return self._has_ended()
            if queued.is_stopped:
                text = f"{self._connection.id}: the input was stopped while the command waited"
                return CommandRefusedError(text, "stopped")
            structure = self.structure(queued.port)
            place = f"{self._connection.plan.provider.component.name}.{queued.port or 'input'}"
            message = check_message(structure, queued.message, self._read, place)
            self._connection._send(  # noqa: SLF001 - the server is within the house
                message, queued.port, self._holder, take_over=queued.take_over, sent=queued.sent
            )
        except Exception as error:  # noqa: BLE001 - reported to the one who sent it
            return error
        return None


def check_message(structure: MessageStructure, message: Message, read: Read, place: str) -> Message:
    """Return the logical value of a message as it came, which matches its structure.

    Takes time in proportion to the message: a long one is checked in a worker.

    Args:
        structure: what it must match.
        message: as it came.
        read: makes its logical value.
        place: where it goes, for the error's text.

    Raises:
        MessageError: it does not match; the text has the place, the field, and what is wrong.
    """
    try:
        value = read(structure, message)
    except MessageError as error:
        raise MessageError(f"{place}: {error}") from error
    message_check(structure, place)(value)
    return value


def read_message(form: Form, structure: MessageStructure, message: Message) -> Message:
    """Return the logical value of a message as it came in a form.

    Raises:
        MessageError: a text is not what its place may carry.
    """
    reader = _reader(form, structure)
    return message if reader is None else reader(message)


@lru_cache(maxsize=512)
def _reader(form: Form, structure: MessageStructure) -> Callable[[Message], Message] | None:
    return form.reader(structure.schema)
