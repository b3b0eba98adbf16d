"""Instances: one running Python component, shared by all its open ports."""

from __future__ import annotations

import inspect
import threading
from collections.abc import AsyncIterator, Callable, Hashable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any, TypeAlias

from attrs import define, field

from uoarm._hints.convert import plain
from uoarm._raised import foreign
from uoarm._support.workers import WorkerPool
from uoarm.errors import BridgeError, FailureReason
from uoarm.local._loop import Coroutines
from uoarm.local._port import TargetPort
from uoarm.local._target import Emit, Target
from uoarm.model import Deliver, Endpoint, Message, Options

Finished = Callable[[Exception | None], None]
Write: TypeAlias = Callable[[Any], Message] | None
Receivers: TypeAlias = Mapping[str, tuple[tuple[Hashable, Deliver], ...]]


@define(eq=False)
class IteratedSource:
    """Iterates in a worker thread from the first listener's coming to the last one's leaving.

    May be used from any thread.

    Args:
        iterate: makes the iterator; called in the listener's thread, so that it may refuse.
        emitter: returns what takes the next message; called in the source's thread before it is
            known whether there is a subscriber still, so that no message is lost between.
        name: of the thread meanwhile.
        workers: give the thread.

    Attributes:
        failure: what the iteration raised; it is not begun again.
    """

    _iterate: Callable[[], Iterator[Any]]
    _emitter: Callable[[], Callable[[Any], None]]
    _name: str
    _workers: WorkerPool
    _changing: threading.Lock = field(factory=threading.Lock, init=False)
    _listeners: dict[Hashable, Finished] = field(factory=dict, init=False)
    _run: _Run | None = field(default=None, init=False)
    failure: Exception | None = field(default=None, init=False)

    def add_listener(self, key: Hashable, finished: Finished) -> None:
        """Start iterating unless it does already.

        `finished` is called at the end, with the exception if there was one, unless `key` was
        removed before.

        Raises:
            BridgeError: the workers were closed.
        """
        with self._changing:
            failure = self.failure
            if self._run is None and failure is None:
                run = _Run(self._iterate(), self._emitter, self._ended, self._name)
                if not self._workers.submit(run.work):
                    raise BridgeError(f"{self._name} is closed", FailureReason.CLOSED)
                self._run = run
            self._listeners[key] = finished
        if failure is not None:
            finished(failure)

    def remove_listener(self, key: Hashable) -> None:
        """Forget a listener; after the last one the iteration ends with the next message."""
        with self._changing:
            self._listeners.pop(key, None)
            if not self._listeners:
                self._stop()

    def stop(self) -> None:
        """Ask the iteration to end, without a report."""
        with self._changing:
            self._listeners.clear()
            self._stop()

    def _stop(self) -> None:
        if self._run is not None:
            self._run.stopped = True
            self._run = None
            # Its thread may be in foreign code for long: the next start shall not wait for another.
            self._workers.prepare()

    def _ended(self, run: _Run, failure: Exception | None) -> None:
        with self._changing:
            if self._run is not run:
                return
            self._run = None
            self.failure = failure
            listeners = list(self._listeners.values())
        for finished in listeners:
            finished(failure)


@define(eq=False)
class _Run:
    """One iteration from its beginning to its end."""

    _messages: Iterator[Any]
    _emitter: Callable[[], Callable[[Any], None]]
    _ended: Callable[[_Run, Exception | None], None]
    _name: str
    stopped: bool = field(default=False, init=False)

    def work(self) -> None:
        thread = threading.current_thread()
        before, thread.name = thread.name, self._name
        try:
            self._iterate()
        finally:
            thread.name = before

    def _iterate(self) -> None:
        failure: Exception | None = None
        for step in (self._emit_all, self._close):
            try:
                foreign(step)
            except Exception as error:  # noqa: BLE001 - a component may raise anything
                failure = failure or error
        self._ended(self, failure)

    def _emit_all(self) -> None:
        for message in self._messages:
            emit = self._emitter()
            if self.stopped:
                break
            emit(message)

    def _close(self) -> None:
        close = getattr(self._messages, "close", None)
        if callable(close):
            close()


class Instance:
    """One component: its object, what takes its messages, and its source thread.

    Args:
        parameters: handed to a class when it is built, to a function at each call.
        workers: gives a source its thread.

    Raises:
        BridgeError: the parameters do not fit. What a class raises passes through.
    """

    def __init__(
        self, target: Target, parameters: Options, coroutines: Coroutines, workers: WorkerPool
    ) -> None:
        self._target = target
        self._workers = workers
        self._parameters = target.build_parameters(parameters)
        self._coroutines = coroutines
        self._receiving = threading.Lock()
        self._receivers: Receivers = {}  # replaced and never changed, as it is read without lock
        self._services: dict[str, Callable[[Message, float], Message]] = {}
        self._source: IteratedSource | None = None
        self._closing = threading.Lock()
        self._is_closed = False
        self._object: Any = target.value(**self._parameters) if target.is_class else target.value

    @property
    def is_dead(self) -> bool:
        """Whether its source raised."""
        return self._source is not None and self._source.failure is not None

    def source(self, port: TargetPort) -> IteratedSource:
        """Return what iterates over the component, which takes no messages.

        Raises:
            HintError: the hint of its messages cannot be converted.
        """
        if self._source is None:
            write = port.writer
            name = f"uoarm-{self._target.name}"
            emitter = partial(self._emitter, write)
            self._source = IteratedSource(self._iterator, emitter, name, self._workers)
        return self._source

    def add_receiver(self, port: str, key: Hashable, deliver: Deliver) -> None:
        """Send what the component emits at a port to one more receiver."""
        with self._receiving:
            others = self._receivers.get(port, ())
            self._receivers = {**self._receivers, port: (*others, (key, deliver))}

    def remove_receiver(self, port: str, key: Hashable) -> None:
        """Send a receiver nothing more but what is under way, which its channel counts."""
        with self._receiving:
            others = tuple(item for item in self._receivers[port] if item[0] is not key)
            self._receivers = {**self._receivers, port: others}

    def feed(self, endpoint: Endpoint) -> Callable[[Message], None]:
        """Return a function that hands a message to an input and emits what comes back.

        Raises:
            HintError: a hint cannot be converted.
        """
        port = self._target.port(endpoint)
        read, write = port.reader, port.writer
        name, handler = self._target.name, self._handler(endpoint)

        def take(message: Message) -> None:
            before = self._receivers
            result = handler(message if read is None else read(message))
            # By what comes back: a decorated function does not say that it is asynchronous.
            if inspect.iscoroutine(result):
                result = self._coroutines.run(name, result)
            elif inspect.isasyncgen(result):
                result = self._coroutines.iterate(name, result)
            if isinstance(result, Iterator):
                for item in result:
                    self._emit(before, write, item)
                    before = self._receivers
            elif result is not None:
                self._emit(before, write, result)

        return take

    def answer(self, endpoint: Endpoint, message: Message, timeout: float) -> Message:
        """Call a service and return its reply; a coroutine is cancelled after `timeout` seconds."""
        service = self._services.get(endpoint.port)
        if service is None:
            service = self._services[endpoint.port] = self._service(endpoint)
        return service(message, timeout)

    def close(self) -> None:
        """End the component: stop its source, cancel its coroutines and call its own `close`.

        Once: one that died may be closed before its last channel is.
        """
        with self._closing:
            if self._is_closed:
                return
            self._is_closed = True
        if self._source is not None:
            self._source.stop()
        self._coroutines.cancel()
        close = getattr(self._object, "close", None)
        if self._target.is_class and callable(close):
            closing = close()
            if inspect.iscoroutine(closing):
                self._coroutines.run(f"closing {self._target.name}", closing)

    def _service(self, endpoint: Endpoint) -> Callable[[Message, float], Message]:
        port, handler = self._target.port(endpoint), self._handler(endpoint)
        name, read, write = self._target.name, port.reader, port.writer or plain

        def answer(message: Message, timeout: float) -> Message:
            reply = handler(message if read is None else read(message))
            if inspect.iscoroutine(reply):
                reply = self._coroutines.run(name, reply, timeout)
            return write(reply)

        return answer

    def _handler(self, endpoint: Endpoint) -> Callable[[Any], Any]:
        if self._target.is_class:
            name = "__call__" if endpoint.port == "default" else endpoint.port
            handler: Callable[[Any], Any] = getattr(self._object, name)
            return handler
        if not self._parameters:
            function: Callable[[Any], Any] = self._object
            return function
        before = self._target.before_message(endpoint)  # by place, as the message is handed over
        after = {
            name: parameter for name, parameter in self._parameters.items() if name not in before
        }
        return partial(self._object, *(self._parameters[name] for name in before), **after)

    def _iterator(self) -> Iterator[Any]:
        made = self._object if self._target.is_class else self._object(**self._parameters)
        if isinstance(made, Iterable):
            return iter(made)
        if hasattr(made, "__aiter__"):
            messages: AsyncIterator[Any] = aiter(made)
            return self._coroutines.iterate(self._target.name, messages)
        if inspect.iscoroutine(made):
            made.close()
        text = f"{self._target.name} returned {type(made).__name__}, expected messages"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)

    def _emitter(self, write: Write) -> Callable[[Any], None]:
        """Return what takes the next message of the source, for those who receive it now."""
        return partial(self._emit, self._receivers, write)

    def _emit(self, before: Receivers, write: Write, message: Any) -> None:
        """Hand over what the component emits.

        Where there is no subscriber, those from its beginning get it: their channels were closed
        meanwhile, and count it.
        """
        port = "default"
        if isinstance(message, Emit):
            port, message, write = message.port, message.message, None
        wanted = self._receivers.get(port) or before.get(port)
        if wanted and message is not None:
            if write is not None:
                message = write(message)
            elif message.__class__ is not dict:
                message = plain(message)
            for _, deliver in wanted:
                deliver(message)
