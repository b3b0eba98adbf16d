"""A front end that no distribution ships: lines of text, one a frame.

`call NAME JSON` calls a service; `open NAME` sends what a function emits; `raise` and `quit` fail,
`leave` leaves a task behind that quits.
"""

from __future__ import annotations

import asyncio
import functools
import json
from collections.abc import Callable

from uoarm.errors import ControlMessageError, MessageError, UoarmError
from uoarm.model import BudgetUse
from uoarm.server.front_end import (
    TEXT_FORM,
    Backend,
    Client,
    FeedKey,
    FrontEnd,
    MakeSession,
    MemoryUse,
    MessageForm,
    Operation,
    Session,
    Subscription,
    code_of,
    error_text,
    hookimpl,
    read_message,
    read_text,
)

MISTAKES = {
    "raise": ValueError("a mistake of this front end"),
    "quit": SystemExit("a mistake of this front end"),
}
FATAL: list[object] = [{"value": 13}, {"value": 17}]


async def _quit() -> None:
    raise MISTAKES["quit"]


class Lines:
    """One client."""

    def __init__(self, client: Client, backend: Backend) -> None:
        self._client = client
        self._backend = backend
        self._subscription = Subscription(
            client,
            MessageForm("lines", _write, text=True),
            on_refused=self._refuse,
            on_end=self._ended,
        )
        self._tasks: set[asyncio.Task[None]] = set()

    def octets(self, frame: str | bytes) -> int:
        return len(frame)

    def decode(self, frame: str | bytes, spending: BudgetUse) -> tuple[Callable[[], None], int]:
        try:
            verb, name, text = [*str(frame).split(" ", 2), "", ""][:3]
            message = read_text(text, spending) if text else None
        except ControlMessageError as error:
            return functools.partial(self._fail, error), 0
        if verb.startswith("decode-"):
            raise MISTAKES[verb.removeprefix("decode-")]
        return functools.partial(self._act, verb, name, message), len(frame)

    def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        feed = self._subscription.feed
        self._subscription.close()
        if feed is not None:
            feed.remove(self._subscription)
            self._backend.leave(feed)

    def _refuse(self, error: MessageError) -> None:
        """Fail as the writing did, as a listener that raises where it must not."""
        raise MISTAKES["raise" if "ValueError" in str(error) else "quit"]

    def _ended(self, state: str, cause: str) -> None:
        del cause
        self._client.outbox.finish(self._subscription.lane, f"ended {state}".encode())

    def _act(self, verb: str, name: str, message: object) -> None:
        if verb in MISTAKES:
            raise MISTAKES[verb]
        if verb == "leave":
            self._tasks.add(asyncio.ensure_future(_quit()))
            return
        try:
            charge = self._client.account.charge(MemoryUse.ASKED, self._client.in_hand)
        except UoarmError as error:
            self._fail(error)
            return
        task = asyncio.ensure_future(self._call(name, message) if message else self._open(name))
        self._tasks.add(task)
        task.add_done_callback(lambda _: charge.release())

    async def _call(self, name: str, message: object) -> None:
        try:
            self._client.require(Operation.CALL, name)
            read = functools.partial(read_message, TEXT_FORM)
            reply = await self._backend.call(name, message, read, self._client.limits.call_seconds)
        except Exception as error:  # noqa: BLE001 - reported to the client
            self._fail(error)
        else:
            self._client.outbox.reply(TEXT_FORM.write(reply), text=True)

    async def _open(self, name: str) -> None:
        try:
            self._client.require(Operation.REQUEST, name)
            feed = await self._backend.join(FeedKey(name))
        except Exception as error:  # noqa: BLE001 - reported to the client
            self._fail(error)
        else:
            self._client.outbox.reply(b"open", text=True)
            self._subscription.begin(feed)

    def _fail(self, error: BaseException) -> None:
        self._client.outbox.reply(f"{code_of(error)}: {error_text(error)}".encode(), text=True)


def _write(number: int, message: object) -> bytes:
    if message in FATAL:
        raise MISTAKES["raise" if message == FATAL[0] else "quit"]
    return f"{number} {json.dumps(message)}".encode()


def _start(backend: Backend) -> MakeSession:
    def make_session(client: Client) -> Session:
        return Lines(client, backend)

    return make_session


LINES = FrontEnd(
    name="lines",
    summary="lines of text",
    path="/lines",
    start=_start,
    subprotocols=("lines.v2", "lines.v1"),
    contract=1,
)


@hookimpl
def uoarm_front_ends() -> list[FrontEnd]:
    return [LINES]
