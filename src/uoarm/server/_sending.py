"""What clients send into inputs: read, checked and handed over in order, outside the loop."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import lru_cache
from itertools import islice
from typing import TypeAlias

from attrs import define

from uoarm.errors import UsageError
from uoarm.flow import make_check
from uoarm.manager import Connection
from uoarm.model import Message, MessageStructure, ValidationMode
from uoarm.server._workers import BusyError, Workers
from uoarm.wire import Form

__all__ = ["Sending", "read_message"]

_BATCH = 256
_FLUSH_SECONDS = 2.0
Done: TypeAlias = Callable[[BaseException | None], None]


@define
class _Letter:
    message: Message
    port: str | None
    done: Done


class Sending:
    """One client's messages into one connection; all methods in the loop's thread.

    Every message is checked against the input's structure: what comes over the network is not
    trusted, whatever the connection was opened with.

    Args:
        connection: open.
        form: in which the messages come.
        workers: where they are handed over, many in one go.
        limit: messages that may wait.
    """

    def __init__(self, connection: Connection, form: Form, workers: Workers, *, limit: int) -> None:
        self._connection = connection
        self._form = form
        self._workers = workers
        self._limit = limit
        self._waiting: deque[_Letter] = deque()
        self._running = False
        self._after: list[Callable[[], None]] = []

    def send(self, message: Message, port: str | None, done: Done) -> None:
        """Hand one message over, after those before it; `done` hears how it went.

        Raises:
            BusyError: too many wait already, or every worker is taken.
        """
        if len(self._waiting) >= self._limit:
            raise BusyError(f"{self._limit} messages to {self._connection.id} wait already")
        self._waiting.append(_Letter(message, port, done))
        if not self._running:
            try:
                self._run()
            except BusyError:
                self._waiting.pop()
                raise

    def after(self, action: Callable[[], None]) -> None:
        """Do something once the component has taken all that was sent until now.

        A component that hangs is waited for two seconds only.
        """
        if self._running:
            self._after.append(action)
        else:
            self._flush([action])

    def structure(self, port: str | None) -> MessageStructure:
        """Return the structure of an input; None stands for the only one.

        Raises:
            UsageError: there is no such input for the application.
        """
        step = self._connection.plan.provider
        names = [one.name for one in step.component.inputs if one.source is None]
        name = names[0] if port is None and len(names) == 1 else port or "default"
        if name not in names:
            has = ", ".join(names) or "none"
            raise UsageError(f"{step.component.function!r} takes no {name!r}; its inputs: {has}")
        return step.structures[f"input.{name}"]

    def _flush(self, actions: list[Callable[[], None]]) -> None:
        flushed = self._workers.start(lambda: self._connection.flush(_FLUSH_SECONDS), always=True)
        flushed.add_done_callback(lambda _: [action() for action in actions])

    def _run(self) -> None:
        batch = list(islice(self._waiting, _BATCH))
        future = self._workers.start(
            lambda: [self._hand_over(letter) for letter in batch], always=self._running
        )
        self._running = True
        for _ in batch:
            self._waiting.popleft()
        future.add_done_callback(lambda done: self._handed(batch, done.result()))

    def _handed(self, batch: list[_Letter], outcomes: list[BaseException | None]) -> None:
        for letter, outcome in zip(batch, outcomes, strict=True):
            letter.done(outcome)
        if self._waiting:
            self._run()
            return
        self._running = False
        if self._after:
            after, self._after = self._after, []
            self._flush(after)

    def _hand_over(self, letter: _Letter) -> BaseException | None:
        """Return what went wrong with one message, in a worker."""
        try:
            structure = self.structure(letter.port)
            place = f"{self._connection.plan.provider.component.name}.{letter.port or 'input'}"
            message = read_message(self._form, structure, letter.message)
            check = make_check(structure, ValidationMode.ALWAYS, place)
            if check is not None:
                check(message)
            self._connection.send(message, letter.port)
        except Exception as error:  # noqa: BLE001 - told to the one who sent it
            return error
        return None


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
