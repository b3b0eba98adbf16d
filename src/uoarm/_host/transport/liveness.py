"""Whether a host lives: by its token, its heartbeat and its end.

A token of the transport drops when the process dies, but stays while the process hangs and holds
the interpreter lock; only the answer to a heartbeat shows that it lives.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from uoarm._host.transport import keys
from uoarm._host.transport.zenoh_transport import ANSWER_SECONDS, Transport
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError

__all__ = ["Heartbeat", "LivenessMonitor"]

_MARGIN_SECONDS = 0.5
_NEWS_SECONDS = 0.3
_LEAST_SECONDS = 0.1
_INTERVAL_SECONDS = 0.5
_ANSWER_SECONDS = 0.5
_DOUBT = 1 / 3


class LivenessMonitor:
    """Keeps what is known of one host's life, and asks it while it lives. For any thread.

    Args:
        name: of the bridge in the host.
        on_doubt: called when the host does not answer, or does again, and the cause.
        on_death: called once with why it died; `dead` is set already.

    Attributes:
        dead: why it died, "" while it lives.
    """

    def __init__(
        self, name: str, on_doubt: Callable[[bool, str], None], on_death: Callable[[str], None]
    ) -> None:
        self._host = f"bridge host {name!r}"
        self._on_doubt = on_doubt
        self._on_death = on_death
        self._news = threading.Condition()
        self._present = False
        self._ending = False
        self.dead = ""

    def seen(self, present: bool) -> None:  # noqa: FBT001 - a callback
        """Note that the token of the host has come or gone."""
        with self._news:
            self._present = present
            self._news.notify_all()

    def doubt(self, in_doubt: bool) -> None:  # noqa: FBT001 - a callback
        """Note that the host does not answer its heartbeat, or does again."""
        self._on_doubt(in_doubt, "its bridge host does not answer" if in_doubt else "it answers")

    def die(self, cause: str) -> None:
        """Note that the host died; the first cause counts."""
        with self._news:
            if self.dead or self._ending:
                return
            self.dead = cause
            self._news.notify_all()
        self._on_death(cause)

    def expect_end(self) -> None:
        """Take no death for news any more: the host is being closed."""
        with self._news:
            self._ending = True

    def await_token(self, deadline: float) -> None:
        """Return when the host has shown its token, which comes after all that it declares.

        Raises:
            BridgeError: it died before.
            BridgeTimeoutError: it was not ready in time.
        """
        with self._news:
            self._news.wait_for(
                lambda: self._present or bool(self.dead), deadline - time.monotonic()
            )
        if self.dead:
            text = f"{self._host} did not start: {self.dead}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if not self._present:
            raise BridgeTimeoutError(f"{self._host} was not ready in time")

    def greet(self, transport: Transport, deadline: float) -> Mapping[str, Any]:
        """Return how the host answers to hello.

        Raises:
            UoarmError: what the host refused with.
        """
        limit = max(_LEAST_SECONDS, deadline - time.monotonic())
        greeting: Mapping[str, Any] = transport.ask(keys.ASK, {"op": "hello"}, timeout=limit)
        return greeting

    def ask(self, transport: Transport, operation: str, values: Mapping[str, Any]) -> Any:
        """Ask the host for one operation of the contract; waits two minutes at most.

        Raises:
            UoarmError: what the bridge raised.
            BridgeError: UNAVAILABLE when the host is dead; the text says of what it died.
        """
        self._refuse_dead(operation)
        limit = ANSWER_SECONDS
        if "timeout" in values:
            limit = min(limit, values["timeout"] + _MARGIN_SECONDS)
        try:
            return transport.ask(keys.ASK, {"op": operation, **values}, timeout=limit)
        except BridgeError as error:
            if error.reason is not FailureReason.UNAVAILABLE:
                raise
            with self._news:
                self._news.wait_for(lambda: bool(self.dead), _NEWS_SECONDS)
            self._refuse_dead(operation, error)
            raise

    def _refuse_dead(self, operation: str, cause: UoarmError | None = None) -> None:
        if self.dead:
            text = f"{self._host} is dead, {operation!r} is not possible: {self.dead}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from cause


class Heartbeat:
    """Asks a host whether it lives, in a thread, until it is stopped or the host is given up.

    Args:
        name: of the bridge, for the thread.
        transport: to the host.
        silence: seconds without an answer after which it is given up.
        on_answer: called with what an answer holds.
        on_doubt: called with True when a third of the silence has passed, False when it is over.
        on_silence: called with for how many seconds there was no answer; the last call.
    """

    def __init__(
        self,
        name: str,
        transport: Transport,
        *,
        silence: float,
        on_answer: Callable[[Any], None],
        on_doubt: Callable[[bool], None],
        on_silence: Callable[[float], None],
    ) -> None:
        self._transport = transport
        self._silence = silence
        self._on_answer = on_answer
        self._on_doubt = on_doubt
        self._on_silence = on_silence
        self._stopped = threading.Event()
        self._thread = threading.Thread(
            target=self._run, name=f"uoarm-heartbeat-{name}", daemon=True
        )

    def start(self) -> None:
        """Begin to ask."""
        self._thread.start()

    def stop(self) -> None:
        """Ask no more, from any thread; a question under way ends within half a second."""
        self._stopped.set()

    def join(self, timeout: float) -> None:
        """Wait for the thread to end, unless this is it."""
        if self._thread is not threading.current_thread() and self._thread.ident is not None:
            self._thread.join(timeout)

    def _run(self) -> None:
        last = time.monotonic()
        missed = 0
        in_doubt = False
        while not self._stopped.wait(_INTERVAL_SECONDS):
            try:
                self._on_answer(self._transport.ask(keys.HEARTBEAT, None, timeout=_ANSWER_SECONDS))
                last, missed = time.monotonic(), 0
            except UoarmError:
                missed += 1
            # The clock alone would give up a host whenever this process has been stopped.
            silent = min(time.monotonic() - last, missed * (_INTERVAL_SECONDS + _ANSWER_SECONDS))
            if self._stopped.is_set():
                return
            if in_doubt != (silent > self._silence * _DOUBT):
                in_doubt = not in_doubt
                self._on_doubt(in_doubt)
            if silent > self._silence:
                self._on_silence(silent)
                return
