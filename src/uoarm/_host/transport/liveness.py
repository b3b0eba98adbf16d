"""Whether a host lives, by its token, its heartbeat and its end, and the connection to it.

A token of the transport drops when the process dies, but stays while the process hangs and holds
the interpreter lock; only the answer to a heartbeat shows that it lives.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from queue import Empty, Queue
from typing import Any

from uoarm._host.transport import keys
from uoarm._host.transport.shared_counters import SharedCounters
from uoarm._host.transport.transport import ANSWER_SECONDS, LinkLostError, Transport
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError

_MARGIN_SECONDS = 0.5
_NEWS_SECONDS = 2.0
_LEAST_SECONDS = 0.1
_INTERVAL_SECONDS = 0.5
_JOIN_SECONDS = 2.0
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
        # Guards the fields below, from the link's thread, the heartbeat's and the one that waits
        # for the process, against callers that ask. It is not held while `on_death` runs, which
        # cuts flows and reports, in whatever locks these take.
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
            # The end of the process, the link's and the silence come in any order, in three
            # threads: the first one wins, and reports once.
            if self.dead or self._ending:
                return
            self.dead = cause
            self._news.notify_all()
        self._on_death(cause)

    def expect_end(self) -> None:
        """Take no death for news any more: the host is being closed."""
        with self._news:
            # Under the lock of `die`: a death is noted before this, or not at all after it.
            self._ending = True
            self._news.notify_all()

    def ended(self) -> None:
        """Note that the host was closed: nothing is asked of it any more, nor waited for."""
        self.dead = self.dead or "it was closed"

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
        # Without the lock: a host that dies from here on ends the wait through its link, or its
        # limit.
        self._refuse_dead(operation)
        limit = ANSWER_SECONDS
        if "timeout" in values:
            limit = min(limit, values["timeout"] + _MARGIN_SECONDS)
        try:
            return transport.ask(keys.ASK, {"op": operation, **values}, timeout=limit)
        except LinkLostError as error:
            with self._news:  # why it died is found out in another thread, unless it was to end
                self._news.wait_for(lambda: bool(self.dead) or self._ending, _NEWS_SECONDS)
            self._refuse_dead(operation, error)
            raise

    def _refuse_dead(self, operation: str, cause: UoarmError | None = None) -> None:
        if self.dead:
            text = f"{self._host} is dead, {operation!r} is not possible: {self.dead}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from cause


class Silence:
    """For how long a host has not answered: from what it is asked and answers, and when.

    Any answer counts, also a late one: a host that waits for a processor lives. The clock alone
    would give up a host whenever this process had been stopped, so a question counts for the time
    to the next one at most.

    Args:
        limit: seconds after which it is given up; it is doubted after a third of them.
        now: seconds of a monotonic clock; so are all times.

    Attributes:
        in_doubt: whether it was doubted at the last look.
    """

    def __init__(self, limit: float, now: float) -> None:
        self.limit = limit
        self.in_doubt = False
        self._answered_at = now
        self._unanswered = 0

    def asked(self) -> None:
        """Note a question; there is one after each interval."""
        self._unanswered += 1

    def answered(self, now: float) -> None:
        """Note an answer, to whichever question."""
        # By one thread, the heartbeat's: it takes answers and asks in turns, so that nothing is
        # locked.
        self._answered_at, self._unanswered = now, 0

    def seconds(self, now: float) -> float:
        """Return for how long it has been silent."""
        return min(now - self._answered_at, self._unanswered * _INTERVAL_SECONDS)

    def doubt(self, now: float) -> bool | None:
        """Return whether it is doubted from now on, or no more; None where that is as it was."""
        before, self.in_doubt = self.in_doubt, self.seconds(now) > self.limit * _DOUBT
        return None if before is self.in_doubt else self.in_doubt

    def is_over(self, now: float) -> bool:
        """Say whether it has been silent for too long."""
        return self.seconds(now) > self.limit


class Heartbeat:
    """Asks a host twice a second whether it lives, in a thread, until that ends or it is given up.

    Args:
        name: of the bridge, for the thread.
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
        self._on_answer = on_answer
        self._on_doubt = on_doubt
        self._on_silence = on_silence
        self._silence = Silence(silence, time.monotonic())
        # All else is this thread's alone: other threads hand it answers and the end here. Not a
        # SimpleQueue: with no time left, CPython 3.10 to 3.12 may wait there for ever.
        self._answers: Queue[Any] = Queue()
        self._stopped = False
        self._thread = threading.Thread(
            target=self._run, name=f"uoarm-heartbeat-{name}", daemon=True
        )

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Ask no more, from any thread. Returns at once."""
        self._stopped = True  # before it is woken, which is what it looks at then
        self._answers.put(None)

    def join(self, timeout: float) -> None:
        """Wait for the thread to end, unless this is it."""
        if self._thread is not threading.current_thread() and self._thread.ident is not None:
            self._thread.join(timeout)

    def _run(self) -> None:
        while self._take_answers(time.monotonic() + _INTERVAL_SECONDS):
            now = time.monotonic()
            self._report_doubt(now)
            # After all answers that are there were taken: a late one still saves the host.
            if self._silence.is_over(now):
                self._on_silence(self._silence.seconds(now))
                return
            self._silence.asked()
            with suppress(BridgeError):  # the link is closed, which is silence
                limit = self._silence.limit
                self._transport.ask_later(keys.HEARTBEAT, self._answers.put, timeout=limit)

    def _take_answers(self, until: float) -> bool:
        """Take answers until it is time for the next question; False when there is to be none."""
        while not self._stopped:
            try:
                answer = self._answers.get(timeout=max(0.0, until - time.monotonic()))
            except Empty:
                return not self._stopped
            if answer is None:
                continue
            now = time.monotonic()
            self._silence.answered(now)
            self._report_doubt(now)
            self._on_answer(answer)
        return False

    def _report_doubt(self, now: float) -> None:
        doubt = self._silence.doubt(now)
        if doubt is not None:
            self._on_doubt(doubt)


class HostConnection:
    """What a manager has of one host, wherever that runs: its link, and whether it lives.

    Attributes:
        transport: to the host; set before `close` may be called.
        counters: in memory that is shared with the host; None: there is none.
        greeting: how it answered to hello.
        moves: whether it has had an input that must be stopped when all else ends.
    """

    transport: Transport
    counters: SharedCounters | None = None
    greeting: Mapping[str, Any]
    moves = False
    _heartbeat: Heartbeat | None = None

    def __init__(self, liveness: LivenessMonitor) -> None:
        self._liveness = liveness

    @property
    def dead(self) -> str:
        """Why the host died or was lost, "" while it is there."""
        return self._liveness.dead

    def ask(self, operation: str, values: Mapping[str, Any]) -> Any:
        """Ask the host for one operation of the contract; raises as `LivenessMonitor.ask`."""
        return self._liveness.ask(self.transport, operation, values)

    def close(self, say_close: Callable[[], object] | None) -> None:
        """End the link: with `say_close` when it is given and the host lives, else at once.

        Raises:
            UoarmError: the bridge in the host failed while closing; the link has ended anyway.
        """
        self._liveness.expect_end()
        if self._heartbeat is not None:
            self._heartbeat.stop()
        try:
            if say_close is not None and not self.dead:
                say_close()
        finally:
            try:
                self._end_host(ends_alone=say_close is not None or bool(self.dead))
            finally:
                if self._heartbeat is not None:
                    self._heartbeat.join(_JOIN_SECONDS)
                self.transport.close()
                if self.counters is not None:
                    self.counters.close()
                self._liveness.ended()

    def _end_host(self, *, ends_alone: bool) -> None:
        """End what was started of the host here, unless it ends alone in time."""

    def _begin_heartbeat(self, name: str, **options: Any) -> None:
        doubt = self._liveness.doubt
        self._heartbeat = Heartbeat(name, self.transport, on_doubt=doubt, **options)
        self._heartbeat.start()
