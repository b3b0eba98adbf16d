"""Components that a test drives: those of a `MemoryBridge`, and scripts for the `python` bridge.

Producers and consumers of a `MemoryBridge` have native forms with nothing in common. `ROWS`, of
producers: a record is a tuple of its values in the order of the field names, an integer its decimal
digits. `PAIRS`, of consumers: a record is a tuple of (name, value), last name first, an integer its
bytes in two's complement, big end first.

A codec is made from a structure once. It refuses what does not fit that structure, so that a
manager that confuses the structures of two ports is found out by the first message.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import GenericAlias
from typing import Any, ClassVar

from attrs import frozen

from uoarm._arguments import arguments
from uoarm.bridge import Channel, Handler
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Message, MessageStructure, Role, Schema
from uoarm.testing._faults import Hang
from uoarm.testing._waiting import Collector

_ABSENT = "<absent>"
_MAX_DEPTH = 64
_SCALARS: Mapping[str, tuple[type, ...]] = {
    "boolean": (bool,),
    "null": (type(None),),
    "number": (int, float),
    "string": (str,),
}


@frozen
class NativeCodec:
    """How the messages of one structure are written in a native form and read back."""

    write: Callable[[Message], Any]
    read: Callable[[Any], Message]


@frozen
class NativeDialect:
    """How one native form writes integers and records."""

    write_integer: Callable[[int], object]
    read_integer: Callable[[Any], int]
    write_record: Callable[[Mapping[str, object], Sequence[str]], tuple[object, ...]]
    read_record: Callable[[Any, Sequence[str]], dict[str, Any]]


def _to_bytes(number: int) -> bytes:
    return number.to_bytes((number.bit_length() + 8) // 8, "big", signed=True)


def _from_bytes(digits: bytes) -> int:
    return int.from_bytes(digits, "big", signed=True)


def _to_row(fields: Mapping[str, object], names: Sequence[str]) -> tuple[object, ...]:
    return tuple(fields.get(name, _ABSENT) for name in names)


def _from_row(row: Any, names: Sequence[str]) -> dict[str, Any]:
    if len(row) != len(names):
        raise ValueError(f"a row of {len(row)} values for {len(names)} fields")
    return {name: item for name, item in zip(names, row, strict=True) if item is not _ABSENT}


def _to_pairs(fields: Mapping[str, object], names: Sequence[str]) -> tuple[object, ...]:
    return tuple((name, fields[name]) for name in reversed(names) if name in fields)


def _from_pairs(pairs: Any, names: Sequence[str]) -> dict[str, Any]:
    found = {str(name): item for name, item in pairs}
    unknown = found.keys() - set(names)
    if unknown:
        raise ValueError(f"unknown fields {sorted(unknown)}")
    return found


ROWS = NativeDialect(str, int, _to_row, _from_row)
PAIRS = NativeDialect(_to_bytes, _from_bytes, _to_pairs, _from_pairs)


_UNFIT = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)


def codec(schema: Schema, dialect: NativeDialect) -> NativeCodec:
    """Return the codec of a structure; what its schema leaves open carries tags.

    Writing raises MessageError when something does not fit, reading BridgeError with BAD_MESSAGE.
    """
    inner = _codec(schema, dialect)

    def write(value: Any) -> Any:
        try:
            return inner.write(value)
        except _UNFIT as error:
            raise MessageError(f"writing a message failed: {error}") from error

    def read(native: Any) -> Any:
        try:
            return inner.read(native)
        except _UNFIT as error:
            raise BridgeError(f"reading failed: {error}", FailureReason.BAD_MESSAGE) from error

    return NativeCodec(write, read)


def _codec(schema: Any, dialect: NativeDialect) -> NativeCodec:
    kind = schema.get("type") if isinstance(schema, Mapping) else None
    if kind == "integer":
        return _integer(dialect)
    if isinstance(kind, str) and kind in _SCALARS:
        return _scalar(kind)
    if kind == "array" and schema.get("x-octets"):
        return NativeCodec(bytes, bytes)
    if kind == "array":
        return _array(schema, dialect)
    if kind == "object" and schema.get("additionalProperties") is False:
        return _record(schema, dialect)
    return _tagged(dialect)


def _integer(dialect: NativeDialect) -> NativeCodec:
    def write(value: Any) -> object:
        if isinstance(value, bool) or value != int(value):
            raise TypeError(f"{value!r} is no integer")
        return dialect.write_integer(int(value))

    return NativeCodec(write, dialect.read_integer)


def _scalar(kind: str) -> NativeCodec:
    types = _SCALARS[kind]

    def check(value: Any) -> Any:
        if not isinstance(value, types) or (isinstance(value, bool) and kind != "boolean"):
            raise TypeError(f"{value!r} is no {kind}")
        return value

    return NativeCodec(check, check)


def _array(schema: Mapping[str, Any], dialect: NativeDialect) -> NativeCodec:
    first = [_codec(prefix_item, dialect) for prefix_item in schema.get("prefixItems", ())]
    rest = _codec(schema.get("items", True), dialect)
    closed = schema.get("items") is False

    def each(items: Iterable[Any], convert: Callable[[NativeCodec, Any], Any]) -> list[Any]:
        if isinstance(items, (str, bytes, Mapping)):
            raise TypeError(f"{items!r:.40} is no array")
        found = [
            convert(first[index] if index < len(first) else rest, element)
            for index, element in enumerate(items)
        ]
        if len(found) < len(first) or (closed and len(found) > len(first)):
            raise ValueError(f"{len(found)} items instead of {len(first)}")
        return found

    return NativeCodec(
        lambda items: tuple(each(items, lambda one, item: one.write(item))),
        lambda items: each(items, lambda one, item: one.read(item)),
    )


def _record(schema: Mapping[str, Any], dialect: NativeDialect) -> NativeCodec:
    fields = {
        name: _codec(item, dialect) for name, item in sorted(schema.get("properties", {}).items())
    }
    names, required = tuple(fields), frozenset(schema.get("required", ()))

    def known(message: Mapping[str, Any]) -> Mapping[str, Any]:
        missing, unknown = required - message.keys(), message.keys() - fields.keys()
        if missing or unknown:
            raise ValueError(f"missing fields {sorted(missing)}, unknown {sorted(unknown)}")
        return message

    def write(message: Mapping[str, Any]) -> tuple[object, ...]:
        native = {name: fields[name].write(value) for name, value in known(message).items()}
        return dialect.write_record(native, names)

    def read(native: Any) -> dict[str, Any]:
        found = known(dialect.read_record(native, names))
        return {name: fields[name].read(value) for name, value in found.items()}

    return NativeCodec(write, read)


def _tagged(dialect: NativeDialect) -> NativeCodec:
    """Return the codec of values whose kind stands beside them, since no schema says it."""

    def write(value: Any, depth: int = 0) -> tuple[str, Any]:
        if depth > _MAX_DEPTH:
            raise ValueError(f"nested deeper than {_MAX_DEPTH}")
        if isinstance(value, Mapping):
            return "map", tuple((str(key), write(item, depth + 1)) for key, item in value.items())
        if isinstance(value, int) and not isinstance(value, bool):
            return "integer", dialect.write_integer(value)
        if isinstance(value, (bytes, bytearray, memoryview)):
            return "octets", bytes(value)
        if value is None or isinstance(value, (bool, float, str)):
            return "plain", value
        return "array", tuple(write(item, depth + 1) for item in value)

    def read(native: Any) -> Any:
        tag, value = native
        if tag == "map":
            return {key: read(item) for key, item in value}
        if tag == "array":
            return [read(item) for item in value]
        return dialect.read_integer(value) if tag == "integer" else value

    return NativeCodec(write, read)


CLEARED = object()
"""What an output emits for a writer of which nothing stands any more."""


class _Port:
    """What is open at a component."""

    def __init__(self, structure: MessageStructure) -> None:
        self.structure = structure
        self._open: dict[Channel, Callable[..., None] | None] = {}
        self._lock = threading.Lock()

    def channels(self) -> tuple[Channel, ...]:
        with self._lock:
            return tuple(self._open)

    def join(self, channel: Channel, take: Callable[..., None] | None) -> None:
        """Open a channel; `take` gets the native messages when it is an output's, and whose."""
        with self._lock:
            self._open[channel] = take

    def leave(self, channel: Channel) -> None:
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
        """Answer one request, through both native forms.

        Raises:
            MessageError: the request does not fit.
            BridgeError: with BAD_MESSAGE: the reply does not.
        """
        request = self._ask.read(self._ask.write(message))
        reply = self._handler(request)
        try:
            native = self._reply.write(reply)
        except MessageError as error:  # the service's fault, and not of who calls
            raise BridgeError(str(error), FailureReason.BAD_MESSAGE) from error
        return self._reply.read(native)


class Script:
    """What a source of the `python` bridge emits, put there by the test while the robot runs.

    What is put waits for the newest source of the script that opens, and for no other. A source
    takes from the moment in which it opens, before its connection is reported as running: not only
    once its thread has begun. One that is closed takes nothing, though its thread may be
    waiting still, and neither does one after which another opened.

    ``numbers = script.source(Number)`` in a module of tests makes the component that a
    configuration names as ``module:numbers``. May be used from any thread.

    Attributes:
        END: put, it ends the source as one that has no more messages.
        started: how often a source of it has opened since the last `reset`.
    """

    END: ClassVar[object] = object()

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._items: deque[object] = deque()
        self._newest: _Run | None = None
        self.started = 0

    def put(self, *items: object) -> None:
        """Have these emitted, in order; an exception is raised by the source instead."""
        with self._changed:
            self._items.extend(items)
            self._changed.notify_all()

    def reset(self) -> None:
        """Forget what was put, and end what still plays. Twice is once."""
        with self._changed:
            self._items.clear()
            self._newest = None
            self.started = 0
            self._changed.notify_all()

    def source(self, hint: Any) -> type:
        """Return a component that emits what is put, with messages of the hinted structure."""
        script = self

        class Source:
            def __init__(self) -> None:
                self._run: _Run | None = None

            def __iter__(self) -> Iterator[Any]:
                self._run = script._begin()  # in the thread that opens, unlike a generator's body
                return self._run

            def close(self) -> None:
                if self._run is not None:
                    script._end(self._run)

        Source.__iter__.__annotations__["return"] = GenericAlias(Iterator, (hint,))
        return Source

    def _begin(self) -> _Run:
        with self._changed:
            self._newest = _Run(self._take)
            self.started += 1
            self._changed.notify_all()
            return self._newest

    def _end(self, run: _Run) -> None:
        with self._changed:
            if self._newest is run:
                self._newest = None
                self._changed.notify_all()

    def _take(self, run: _Run) -> object:
        """Wait for the next item of a run; `END` once it is not the newest."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not run or self._items)
            return self._items.popleft() if self._newest is run else self.END


class _Run(Iterator[Any]):
    """One source from its opening to its end."""

    def __init__(self, take: Callable[[_Run], object]) -> None:
        self._take = take

    def __next__(self) -> Any:
        item = self._take(self)
        if item is Script.END:
            raise StopIteration
        if isinstance(item, Exception):
            raise item
        return item
