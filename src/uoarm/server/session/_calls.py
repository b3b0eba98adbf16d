"""The calls of services that one client has under way: each without a task of its own."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from uoarm._raised import on_failure
from uoarm._wire import Form
from uoarm.model import ControlMessage, Message
from uoarm.server._failures import UnknownError
from uoarm.server.access import Operation
from uoarm.server.session._client import ConnectedClient
from uoarm.server.streams import Charge, FeedRegistry, read_message


class _Call:
    """A call, which may be cancelled: before it has begun, too."""

    def __init__(self, charge: Charge) -> None:
        self.charge = charge
        # `began` comes in the worker, `cancel` in the loop's thread: each says its own first and
        # then looks for the other's, so that one of them, or both, cancel it.
        self._cancel: Callable[[], bool] | None = None
        self._is_cancelled = False

    def began(self, cancel: Callable[[], bool]) -> None:
        self._cancel = cancel
        if self._is_cancelled:
            cancel()

    def cancel(self) -> Callable[[], bool] | None:
        """Have it end early; returns what to do about that outside of the loop, None: nothing."""
        self._is_cancelled = True
        return self._cancel


class ClientCalls:
    """In the loop's thread.

    Args:
        form: in which their messages are.
        write: makes of a question and its reply what is sent; in a worker.
        emit: takes what is sent of a question that was answered.
        fail: takes a question and why it failed.
    """

    def __init__(
        self,
        client: ConnectedClient,
        registry: FeedRegistry,
        form: Form,
        write: Callable[[ControlMessage, Message], bytes],
        emit: Callable[[str | None, bytes], None],
        fail: Callable[[ControlMessage, BaseException], None],
    ) -> None:
        self._client, self._registry = client, registry
        self._read = partial(read_message, form)
        self._write, self._emit, self._fail = write, emit, fail
        self._under_way: dict[_Call, str | None] = {}  # by each call the id of its question

    def __len__(self) -> int:
        return len(self._under_way)

    def begin(self, asked: ControlMessage, charge: Charge) -> None:
        """Begin what is asked; its charge is released at its end.

        Raises:
            UoarmError: it may not be called, or no worker is free; the charge was released.
        """
        name, limits = str(asked.type), self._client.limits
        call = _Call(charge)
        self._under_way[call] = asked.id
        with on_failure(self._leave, call):
            self._client.require(Operation.CALL, name)
            wanted = asked.extensions.get("x-timeout", limits.call_seconds)
            assert isinstance(wanted, int | float), "the schema says so"
            limit = min(float(wanted), limits.call_seconds)
            act, ended = partial(self._write, asked), partial(self._ended, call, asked)
            self._registry.begin_call(
                name, None, asked.jsonMessage, self._read, limit, call.began, act, ended
            )

    def cancel(self, identity: str) -> Callable[[], bool] | None:
        """Have a call end early; returns what to do about that in a worker, None: nothing.

        Raises:
            UnknownError: no call of this id is under way.
        """
        for call, question in self._under_way.items():
            if question == identity:
                return call.cancel()
        raise UnknownError(f"this client has no call {identity!r:.100} under way")

    def close(self) -> None:
        """Wait for none of them: their answers go nowhere."""
        for call in tuple(self._under_way):
            self._leave(call)

    def _leave(self, call: _Call) -> None:
        del self._under_way[call]
        call.charge.release()

    def _ended(
        self, call: _Call, asked: ControlMessage, frame: bytes, error: Exception | None
    ) -> None:
        if call not in self._under_way:  # its client has gone
            return
        self._leave(call)
        if error is None:
            self._emit(asked.id, frame)
        else:
            self._fail(asked, error)
