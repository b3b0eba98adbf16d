"""The components of a `MemoryBridge`: a test emits from them, reads them and makes them fail."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ClassVar

from uoarm._arguments import arguments
from uoarm.bridge import Channel, Handler
from uoarm.model import Message, MessageStructure, Role
from uoarm.testing._collector import Collector
from uoarm.testing._faults import Hang
from uoarm.testing._native import PAIRS, ROWS, codec

__all__ = ["CLEARED", "Emitter", "Loop", "MemoryService", "Taker"]

CLEARED = object()
"""What an output emits for a writer of which nothing stands any more."""


class _Port:
    """What is open at a component."""

    def __init__(self, structure: MessageStructure) -> None:
        self.structure = structure
        self._open: dict[Channel, Callable[..., None] | None] = {}
        self._lock = threading.Lock()

    def channels(self) -> tuple[Channel, ...]:
        """Return the channels open now."""
        with self._lock:
            return tuple(self._open)

    def join(self, channel: Channel, take: Callable[..., None] | None) -> None:
        """Open a channel; `take` gets the native messages when it is an output's, and whose."""
        with self._lock:
            self._open[channel] = take

    def leave(self, channel: Channel) -> None:
        """Forget a channel."""
        with self._lock:
            self._open.pop(channel, None)

    def emit_native(self, row: object, writer: str = "") -> None:
        """Emit something as it is, also what no structure allows."""
        with self._lock:
            takers = [take for take in self._open.values() if take is not None]
        for take in takers:
            take(row, writer)


class Emitter(_Port):
    """A producer: what it emits arrives in the thread that emits."""

    roles: ClassVar[tuple[Role, ...]] = (Role.OUTPUT,)

    @arguments()
    def __init__(self, structure: MessageStructure, *, latched: bool = False) -> None:
        super().__init__(structure)
        self.latched = latched
        self._last: dict[str, object] = {}
        self._write = codec(structure.schema, ROWS).write
        self._garbles = False

    def join(self, channel: Channel, take: Callable[..., None] | None) -> None:
        """Open a channel; where the output is latched it gets the last of each writer first."""
        super().join(channel, take)
        if take is not None:
            for writer, row in tuple(self._last.items()):
                take(row, writer)

    def emit(self, message: Message, writer: str = "") -> None:
        """Emit a message of the component's own structure.

        Args:
            message: the message.
            writer: whose it is, where several write beside one another into a latched output.

        Raises:
            BridgeError: it does not fit that structure.
        """
        row = self._write(message)
        self.emit_native((row, row, "garbled") if self._garbles else row, writer)

    def clear(self, writer: str = "") -> None:
        """Let what a writer emitted last stand no more."""
        self._last.pop(writer, None)
        super().emit_native(CLEARED, writer)

    def emit_native(self, row: object, writer: str = "") -> None:
        """Emit something as it is, and keep it where the output is latched."""
        if self.latched:
            self._last[writer] = row
        super().emit_native(row, writer)

    @contextmanager
    def garbled(self) -> Iterator[None]:
        """Emit what no consumer can read, as a broken link does."""
        self._garbles = True
        try:
            yield
        finally:
            self._garbles = False


class Taker(_Port):
    """A consumer: it reads what arrives and keeps it.

    Attributes:
        taken: the messages so far, and ways to wait for them.
        blocking: what its sinks declare.
    """

    roles: ClassVar[tuple[Role, ...]] = (Role.INPUT,)

    @arguments()
    def __init__(self, structure: MessageStructure, *, blocking: bool) -> None:
        super().__init__(structure)
        self.taken = Collector()
        self.blocking = blocking
        self._read = codec(structure.schema, PAIRS).read
        self._hang: Hang | None = None

    def take(self, pairs: object) -> None:
        """Read one native message and keep it."""
        if self._hang is not None:
            self._hang.wait()
        self.taken.deliver(self._read(pairs))

    @contextmanager
    def stalled(self) -> Iterator[Hang]:
        """Take nothing until released or the end of the block: every `send` hangs."""
        self._hang = hang = Hang()
        try:
            yield hang
        finally:
            self._hang = None
            hang.release()


class Loop(_Port):
    """A component that emits what it takes, from its consumer's form to its producer's."""

    roles: ClassVar[tuple[Role, ...]] = (Role.INPUT, Role.OUTPUT)
    blocking = True
    latched = False

    def __init__(self, structure: MessageStructure) -> None:
        super().__init__(structure)
        self._read = codec(structure.schema, PAIRS).read
        self._write = codec(structure.schema, ROWS).write

    def take(self, pairs: object) -> None:
        """Emit again what was taken, in the thread that sent it."""
        self.emit_native(self._write(self._read(pairs)))


class MemoryService:
    """A service: requests come as pairs, replies go as rows."""

    roles: ClassVar[tuple[Role, ...]] = (Role.SERVICE,)

    @arguments()
    def __init__(
        self, request: MessageStructure, reply: MessageStructure, handler: Handler
    ) -> None:
        self.request, self.reply = request, reply
        self._handler = handler
        self._ask = codec(request.schema, PAIRS)
        self._reply = codec(reply.schema, ROWS)

    def answer(self, message: Message) -> Message:
        """Answer one request, through both native forms."""
        request = self._ask.read(self._ask.write(message))
        return self._reply.read(self._reply.write(self._handler(request)))
