"""The transport between a manager and a host: one Zenoh session at either end of a socket.

Requests are Zenoh queries whose payloads are frames of the codec. Every request gets a reply or
an error, also when the answering function raises. Foreign exceptions end here.
"""

from __future__ import annotations

import copy
import json
import logging
import re
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import MappingProxyType, TracebackType
from typing import Any

import zenoh

from uoarm._host.transport.codec import from_failure, pack, to_failure, unpack
from uoarm.bridge import boot_seconds
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    FailureReason,
    MessageError,
    UoarmError,
)

__all__ = ["ANSWER_SECONDS", "NO_MORE", "Reply", "Transport", "configuration"]

ANSWER_SECONDS = 120.0
"""A request that nothing else limits is given up after this time."""

Reply = Callable[[Any], None]
"""Takes the value to answer with, or the exception to answer with; from any thread, once."""

_PLACE_IN_ZENOH = re.compile(r" at /\S+\.rs:\d+")  # of the machine that built it
_BLOCK, _DROP = zenoh.CongestionControl.BLOCK, zenoh.CongestionControl.DROP
_log = logging.getLogger("uoarm")
NO_MORE: Mapping[str, object] = MappingProxyType({})
_FULL_SECONDS = 0.2
_RETRY_MILLISECONDS = 200


class Transport:
    """One end of a transport. All methods may be called from any thread.

    Args:
        address: a Zenoh endpoint, `unixsock-stream/...` or `tls/...`.
        listen: whether this end waits for the other one; it must be there first.
        timeout: seconds for the connection to stand, where this end connects, or connects again;
            `close` waits as long for such a try.
        lease: seconds without a sign of life after which the other end is taken for gone. The
            heartbeat notices a host that hangs, so this may be long.
        shared_memory: whether large frames cross in shared memory; both ends must say the same.
        more: further settings of the session, by name.

    Attributes:
        ahead: by how many nanoseconds the clock at the other end is ahead of this one.
        clock: the clock by which both ends say when a message was sent, nanoseconds. One that
            nobody sets where both are on one machine; else that of the calendar.

    Raises:
        BridgeError: the session could not be opened.
    """

    def __init__(
        self,
        address: str,
        *,
        listen: bool,
        timeout: float = 10.0,
        lease: float = 10.0,
        shared_memory: bool = False,
        more: Mapping[str, object] = NO_MORE,
    ) -> None:
        with _wrapped(f"opening the link at {address}"):
            settings = configuration(
                address,
                listen=listen,
                timeout=timeout,
                lease=lease,
                shared_memory=shared_memory,
                more=more,
            )
            self._session = zenoh.open(settings)
        self._prefix = ""
        self._kept: list[Any] = []
        self.ahead: Callable[[], int] = _same_clock
        self.clock: Callable[[], int] = _boot_nanoseconds

    def part(self, prefix: str) -> Transport:
        """Return a transport over the same session that sees every key behind a prefix.

        Closing it ends what was declared through it; the session stays.
        """
        part = copy.copy(self)
        part._prefix = f"{self._prefix}{prefix}/"  # noqa: SLF001 - one of this kind
        part._kept = []  # noqa: SLF001 - likewise
        return part

    def ask(self, key: str, request: Any, *, timeout: float = ANSWER_SECONDS) -> Any:
        """Send a request and return the answer; waits `timeout` seconds at most.

        Raises:
            UoarmError: what the other end answered with.
            BridgeError: UNAVAILABLE when nobody answers.
            BridgeTimeoutError: no answer in time.
        """
        begun = time.monotonic()
        key = self._prefix + key
        with _wrapped(f"asking {key}"):
            replies = list(self._session.get(key, payload=pack(request), timeout=timeout))
        late = time.monotonic() - begun >= timeout
        if late and (not replies or replies[0].ok is None):
            raise BridgeTimeoutError(f"no answer at {key} within {timeout:g} s")
        if not replies:
            raise BridgeError(f"nobody answers at {key}", FailureReason.UNAVAILABLE)
        return _answer_in(replies[0], key)

    def ask_later(
        self, key: str, request: Any, take: Callable[[Any], None], *, timeout: float
    ) -> None:
        """Send a request, and have the answer handed to `take` in the transport's thread.

        An error, or no answer within `timeout` seconds, is told to nobody. `take` must not block.

        Raises:
            BridgeError: the link is closed.
        """
        key = self._prefix + key

        def handle(reply: zenoh.Reply) -> None:
            try:
                answer = _answer_in(reply, key)
            except UoarmError as error:
                _log.debug("%s", error)
            else:
                take(answer)

        with _wrapped(f"asking {key}"):
            self._session.get(key, _directly(handle), payload=pack(request), timeout=timeout)

    def answer(self, key: str, take: Callable[[Any, Reply], None]) -> Callable[[], None]:
        """Have requests at a key handed to `take`, in the transport's thread; returns what ends it.

        `take` must not block: it answers at once, or hands the reply to another thread.
        """

        def handle(query: zenoh.Query) -> None:
            reply = _reply_to(query)
            try:
                payload = query.payload
                take(None if payload is None else unpack(payload.to_bytes()), reply)
            except Exception as error:  # noqa: BLE001 - an unanswered query looks like a death
                reply(error)

        with _wrapped(f"answering at {key}"):
            return self._keep(
                self._session.declare_queryable(self._prefix + key, _directly(handle))
            )

    def publish(
        self, key: str, payload: bytes, header: bytes, *, must_arrive: bool = False
    ) -> None:
        """Send one frame. When the link is full for 0.2 s, the frame is dropped.

        With `must_arrive` it waits longer, and a link that stays full for 5 s is broken.

        Raises:
            BridgeError: the link is closed.
        """
        with _wrapped(f"sending to {key}"):
            self._session.put(
                self._prefix + key,
                payload,
                attachment=header,
                congestion_control=_BLOCK if must_arrive else _DROP,
            )

    def subscribe(self, key: str, length: int) -> tuple[Callable[[], Any], Callable[[], None]]:
        """Return a function that waits for the next frame, and one that ends the subscription.

        The first returns (payload, header), or None when the subscription has ended. At most
        `length` frames wait; the oldest are lost first.
        """
        with _wrapped(f"subscribing to {key}"):
            ring: Any = zenoh.handlers.RingChannel(length)
            subscriber = self._session.declare_subscriber(self._prefix + key, ring)
        waiting = subscriber.handler

        def receive() -> tuple[bytes, bytes] | None:
            try:
                sample = waiting.recv()
            except zenoh.ZError:
                return None
            header = sample.attachment
            return sample.payload.to_bytes(), b"" if header is None else header.to_bytes()

        return receive, self._keep(subscriber)

    def listen(self, key: str, take: Callable[[bytes], None]) -> Callable[[], None]:
        """Have the headers of frames at a key handed to `take`, in the transport's thread."""

        def handle(sample: zenoh.Sample) -> None:
            header = sample.attachment
            if header is not None:
                take(header.to_bytes())

        with _wrapped(f"listening at {key}"):
            taking = _directly(handle)
            return self._keep(self._session.declare_subscriber(self._prefix + key, taking))

    def show_alive(self, key: str) -> None:
        """Declare a token that goes when this end dies."""
        with _wrapped("declaring the token"):
            self._keep(self._session.liveliness().declare_token(self._prefix + key))

    def watch_alive(self, key: str, seen: Callable[[bool], None]) -> None:
        """Have the coming and going of a token told, in the transport's thread."""
        self.watch_tokens(key, lambda _, alive: seen(alive))

    def watch_tokens(self, keys: str, seen: Callable[[str, bool], None]) -> Callable[[], None]:
        """Have the coming and going of every token that matches told, each with its key.

        Those that are there are told first. Returns what ends it.
        """

        def handle(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr).removeprefix(self._prefix)
            seen(key, sample.kind == zenoh.SampleKind.PUT)

        with _wrapped("watching for tokens"):
            tokens = self._session.liveliness()
            address = self._prefix + keys
            subscriber = tokens.declare_subscriber(address, _directly(handle), history=True)
        return self._keep(subscriber)

    def close(self) -> None:
        """End everything of this end, or of this part of it. Idempotent."""
        kept = list(self._kept)
        self._kept.clear()
        if self._prefix:
            for declared in kept:
                with suppress(zenoh.ZError):  # the session was closed before
                    declared.undeclare()
            return
        with _wrapped("closing the link"):
            self._session.close()  # type: ignore[no-untyped-call] # zenoh's stub says no more

    def _keep(self, declared: Any) -> Callable[[], None]:
        self._kept.append(declared)

        def end() -> None:
            if declared in self._kept:
                self._kept.remove(declared)
                with _wrapped("ending a subscription"):
                    declared.undeclare()

        return end


def _same_clock() -> int:
    return 0


def _boot_nanoseconds() -> int:
    return int(boot_seconds() * 1e9)


def _directly(handle: Callable[[Any], None]) -> Any:
    """Have a handler called in Zenoh's thread; else each one gets a thread that no exit ends."""
    return zenoh.handlers.Callback(handle, indirect=False)


def _answer_in(reply: zenoh.Reply, key: str) -> Any:
    """Return what the other end answered at a key, or raise what it answered with."""
    if reply.err is not None:
        text = reply.err.payload.to_string()
        raise BridgeError(f"asking {key}: {text}", FailureReason.UNAVAILABLE)
    assert reply.ok is not None, "a reply that is no error holds a sample"
    told = unpack(reply.ok.payload.to_bytes())
    match told:
        case [bool(failed), value]:
            if not failed:
                return value
            if isinstance(value, Mapping):
                raise from_failure(value)
    text = f"asking {key}: the answer is none of this link: {str(told)[:40]}"
    raise BridgeError(text, FailureReason.CONTRACT)


def _reply_to(query: zenoh.Query) -> Reply:
    key = str(query.key_expr)

    def reply(value: Any) -> None:
        failed = isinstance(value, BaseException)
        try:
            frame = pack((failed, to_failure(value) if failed else value))
        except MessageError as error:
            frame = pack((True, to_failure(error)))
        try:
            query.reply(key, frame)
            query.drop()  # type: ignore[no-untyped-call] # zenoh's stub says no more
        except zenoh.ZError as error:
            _log.debug("nobody waits for the answer at %s any more: %s", key, error)

    return reply


class _wrapped:  # noqa: N801 - as those of contextlib; each message enters one
    """Raises as a BridgeError what Zenoh raises in a step, which the text names."""

    __slots__ = ("_step",)

    def __init__(self, step: str) -> None:
        self._step = step

    def __enter__(self) -> None:
        pass

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, zenoh.ZError):
            text = _PLACE_IN_ZENOH.sub("", str(error)).rstrip(".")
            text = f"{self._step} failed: {text}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error


def configuration(
    address: str,
    *,
    listen: bool,
    timeout: float,
    lease: float,
    shared_memory: bool,
    more: Mapping[str, object] = NO_MORE,
) -> zenoh.Config:
    """Return settings under which nothing is found by itself and nothing listens elsewhere."""
    full_microseconds = int(_FULL_SECONDS * 1e6)
    settings: dict[str, object] = {
        "mode": "router" if listen else "client",
        "listen/endpoints": [address] if listen else [],
        "connect/endpoints": [] if listen else [address],
        "connect/timeout_ms": int(timeout * 1000),
        "connect/retry": {
            "period_init_ms": _RETRY_MILLISECONDS,
            "period_max_ms": _RETRY_MILLISECONDS,
        },
        "scouting/delay": 0,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": shared_memory,
        "transport/unicast/open_timeout": int(timeout * 1000),
        "transport/link/tx/lease": int(lease * 1000),
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": full_microseconds,
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": (
            full_microseconds
        ),
        **more,
    }
    configuration: zenoh.Config = zenoh.Config()
    for name, value in settings.items():
        configuration.insert_json5(name, json.dumps(value))
    return configuration
