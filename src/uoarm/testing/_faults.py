"""Faults on demand: of a step of any bridge, and of a TCP connection through a `Proxy`.

A step raises, hangs or lies while a `with` block runs. Each fault replaces one raw step
(`_describe`, `_open_sink`, ...) of one bridge instance, below the core's final methods, which is
where a framework would fail. What a real framework does beside (print, crash the process, hold the
interpreter) is not imitated. A `Proxy` between client and server breaks connections for real.
"""

from __future__ import annotations

import asyncio
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from typing_extensions import Self

from uoarm._arguments import arguments
from uoarm.bridge import Bridge, Channel
from uoarm.testing._waiting import patience


class Hang:
    """A step that hangs until it is released.

    Attributes:
        entered: set when the step was called and hangs.
    """

    def __init__(self) -> None:
        self.entered = threading.Event()
        self._released = threading.Event()

    def release(self) -> None:
        """Let the step go on."""
        self._released.set()

    def wait(self) -> None:
        """Hang here; for use as a step."""
        self.entered.set()
        self._released.wait(2 * patience())  # longer than the test waits for what hangs here


@arguments()
@contextmanager
def raising(subject: Bridge | Channel, step: str, error: BaseException) -> Iterator[None]:
    """Have a step raise, as a framework does that is broken or offline."""

    def fail(*_: Any, **__: Any) -> Any:
        raise error

    with _replaced(subject, step, lambda _: fail):
        yield


@arguments()
@contextmanager
def hanging(subject: Bridge | Channel, step: str) -> Iterator[Hang]:
    """Have a step hang until `release`, or the end of the block, and then do its work."""
    hang = Hang()

    def stuck(original: Callable[..., Any]) -> Callable[..., Any]:
        def step_of_fault(*given: Any, **named: Any) -> Any:
            hang.wait()
            return original(*given, **named)

        return step_of_fault

    with _replaced(subject, step, stuck):
        try:
            yield hang
        finally:
            hang.release()


@arguments()
@contextmanager
def lying(subject: Bridge | Channel, step: str, answer: object) -> Iterator[None]:
    """Have a step return something that the contract does not allow."""
    with _replaced(subject, step, lambda _: lambda *_, **__: answer):
        yield


@contextmanager
def _replaced(
    subject: Bridge | Channel,
    step: str,
    replace: Callable[[Callable[..., Any]], Callable[..., Any]],
) -> Iterator[None]:
    original = getattr(subject, step, None)
    if not callable(original):
        raise ValueError(f"{type(subject).__name__} has no step {step!r}")  # noqa: TRY004
    before = vars(subject).get(step)
    setattr(subject, step, replace(original))
    try:
        yield
    finally:
        if before is None:
            delattr(subject, step)
        else:
            setattr(subject, step, before)


_RESET = struct.pack("ii", 1, 0)


class Proxy:
    """Passes bytes on until a method changes that; methods from any thread.

    Realism: `cut` resets both ends as a crashed router would; `hold` keeps bytes as a dead link
    does, and what was held at a cut is lost.
    """

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self._target = host, port
        self._loop = asyncio.new_event_loop()
        self._pairs: set[tuple[_End, _End]] = set()
        self._admits = True
        self.refused = 0
        self._server: asyncio.AbstractServer | None = None
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)

    @property
    def port(self) -> int:
        assert self._server is not None
        number: int = self._server.sockets[0].getsockname()[1]  # type: ignore[attr-defined]
        return number

    def cut(self, *, admit: bool = True, server: bool = True) -> None:
        """Reset every connection, with `server=False` towards the client only."""
        self._do(partial(self._cut, admit=admit, server=server))

    def admit(self) -> None:
        """Let clients connect again."""
        self._do(setattr, self, "_admits", True)

    def hold(self, *, to_server: bool = False, to_client: bool = False) -> None:
        """Keep what comes from now on, in these directions."""
        for client, backend in list(self._pairs):
            self._do(setattr, client, "held", to_server)
            self._do(setattr, backend, "held", to_client)

    def jam(self, *, to_server: bool = False) -> None:
        """Take nothing more from the server, or from clients, so that they cannot write on.

        Of the connections that there are: those that come later pass.
        """
        for client, backend in list(self._pairs):
            self._do(client.pause if to_server else backend.pause)

    def _do(self, action: Any, *arguments: Any) -> None:
        async def act() -> None:
            action(*arguments)

        asyncio.run_coroutine_threadsafe(act(), self._loop).result(patience())

    def _cut(self, *, admit: bool, server: bool) -> None:
        self._admits = admit
        for client, backend in self._pairs:
            client.reset()
            if server:
                backend.reset()
        self._pairs.clear()

    async def _start(self) -> None:
        self._server = await self._loop.create_server(lambda: _End(self), "127.0.0.1", 0)

    async def connect(self, client: _End) -> None:
        """Find a way to the server for a client that has come."""
        if not self._admits:
            self.refused += 1
            client.reset()
            return
        _, backend = await self._loop.create_connection(lambda: _End(None), *self._target)
        self._pairs.add((client, backend))
        client.join(backend)
        backend.join(client)

    def __enter__(self) -> Self:
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self._start(), self._loop).result(patience())
        return self

    def __exit__(self, *_: object) -> None:
        self.cut(admit=False)
        assert self._server is not None
        self._do(self._server.close)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(patience())
        self._loop.close()


class _End(asyncio.Protocol):
    """One of the two connections of a pair."""

    def __init__(self, proxy: Proxy | None) -> None:
        self._proxy = proxy
        self._early = bytearray()
        self._peer: _End | None = None
        self._transport: Any = None
        self.held = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport
        if self._proxy is not None:
            self._connecting = asyncio.ensure_future(self._proxy.connect(self))

    def join(self, peer: _End) -> None:
        self._peer = peer
        peer.write(bytes(self._early))

    def data_received(self, data: bytes) -> None:
        if self._peer is None:
            self._early += data
        elif not self.held:
            self._peer.write(data)

    def connection_lost(self, exc: Exception | None) -> None:
        del exc
        if self._peer is not None and not self.held:
            self._peer.close()

    def write(self, data: bytes) -> None:
        self._transport.write(data)

    def pause(self) -> None:
        self._transport.pause_reading()

    def close(self) -> None:
        self._transport.close()

    def reset(self) -> None:
        self._peer = None
        if self._transport.is_closing():
            return
        found: socket.socket = self._transport.get_extra_info("socket")
        found.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        self._transport.abort()
