# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""The two ways of data between ports, push and pull: buffers, the threads at them, size limits.

Buffers hold encoded messages between an OutPort of ours and its consumer. The size limit of a
peer is learnt, since no profile states it: an ORB has a limit for one GIOP message, of omniORB
2 MiB unless it is configured. A larger one makes the receiver close the connection (observed),
which looks like its death: only a further call finds out. What a limit refuses is a fault of the
message, never of the component.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from _uoarm_rtm_stubs import OpenRTM, OpenRTM__POA
from omniORB import CORBA

from uoarm.bridge import Log
from uoarm_rtm._options import BufferPolicy, PushPolicy
from uoarm_rtm._orb import CallGuard, calls

_SURELY_FITS = 1 << 16
_HINT = "omniORB's own limit is 2097152, the option -ORBgiopMaxMsgSize of that process raises it"


def is_there(target: Any) -> bool:
    """Whether an object answers, which must have its time limit set."""
    try:
        with calls:
            return not target._non_existent()
    except CORBA.Exception:
        return False


class SizeLimit:
    """What is known of the limit of one peer. Used by one thread at a time.

    Args:
        where: the port, for errors.
        ours: octets that our own ORB sends at most.
    """

    def __init__(self, where: str, ours: int) -> None:
        self._where = where
        self._ours = ours
        self._passed = 0
        self._refused: int | None = None

    def refusal(self, size: int) -> str:
        """Return why a message of this size need not be tried; empty for one that may pass."""
        if self._refused is None or size < self._refused:
            return ""
        return (
            f"{self._where} does not take a message of {size} octets: up to {self._passed} passed, "
            f"{self._refused} did not; {_HINT}"
        )

    def passed(self, size: int) -> None:
        """Note that a message of this size passed."""
        self._passed = max(self._passed, size)

    def explain(self, error: CORBA.Exception, target: Any, size: int) -> str:
        """Return why a message did not pass, where its size was the reason; empty otherwise.

        Args:
            error: with which the call ended.
            target: the object called, with its time limit; it is asked whether it is alive.
            size: octets of the message.
        """
        if size <= max(self._passed, _SURELY_FITS):
            return ""
        if isinstance(error, CORBA.MARSHAL) and error.completed == CORBA.COMPLETED_NO:
            text = f"a message of {size} octets is larger than our own limit of {self._ours}"
            return f"{self._where}: {text}: the bridge's option `max_message` raises it"
        if not isinstance(error, CORBA.COMM_FAILURE) or not is_there(target):
            return ""
        self._refused = min(size, self._refused or size)
        return self.refusal(size)


class Buffer:
    """A queue with a policy for being full and for being empty. Used from any thread.

    Attributes:
        policy: what a writer does when it is full, a reader when it is empty.
        dropped: messages that gave way to newer ones, or were not taken.
    """

    def __init__(self, policy: BufferPolicy) -> None:
        self.policy = policy
        self.dropped = 0
        self._waiting: deque[bytes] = deque()
        self._last: bytes | None = None
        self._closed = False
        self._busy = False  # the consumer is not done with what it took: `drain` waits for it
        # Guards all fields: the writers, the consumer and `close` are different threads.
        self._changed = threading.Condition()

    @property
    def waiting(self) -> int:
        """Messages that wait now."""
        return len(self._waiting)

    @property
    def unsent(self) -> int:
        """Messages that wait and would have been sent."""
        return self.waiting

    def write(self, data: bytes) -> bool:
        """Keep one message; returns whether it was taken.

        With `block` waits up to `write_seconds` for room.
        """
        with self._changed:
            if self.policy.full == "block":
                self._changed.wait_for(self._has_room, self.policy.write_seconds)
            if self._closed:
                return False
            if not self._has_room():
                self.dropped += 1
                if self.policy.full != "overwrite":
                    return False
                self._waiting.popleft()
            self._waiting.append(data)
            self._changed.notify_all()
            return True

    def read(self) -> bytes | None:
        """Return the oldest message; on empty, what the policy says; None for nothing.

        With `block` waits up to `read_seconds` for one.
        """
        with self._changed:
            if self.policy.empty == "block":
                self._changed.wait_for(self._is_ready, self.policy.read_seconds)
            if self._waiting:
                self._last = self._waiting.popleft()
                self._changed.notify_all()
                return self._last
            return self._last if self.policy.empty == "readback" else None

    def take(self, most: int | None = None) -> list[bytes]:
        """Wait until something waits, and return all of it or the oldest; [] once closed.

        A consumer that calls again is done with what it took before.
        """
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(self._is_ready)
            if self._closed:
                return []
            count = len(self._waiting) if most is None else most
            taken = [self._waiting.popleft() for _ in range(min(count, len(self._waiting)))]
            self._busy = True
            self._changed.notify_all()
            return taken

    def drain(self, seconds: float) -> bool:
        """Wait until nothing waits and the consumer is done; returns whether that came."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._waiting or self._busy), seconds)

    def close(self) -> None:
        """End every wait; what waits is not taken any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _has_room(self) -> bool:
        return self._closed or len(self._waiting) < self.policy.length

    def _is_ready(self) -> bool:
        return self._closed or bool(self._waiting)


_log = Log("uoarm.rtm")


class Pusher:
    """Calls an InPort in the thread that writes (`flush`).

    Args:
        target: the InPort, with its time limit set.
        sizes: what is known of how large a message it takes.
        lost: called when the InPort is gone; not once `end` was called, when the InPort is still
            to be notified of the end.
    """

    unsent = 0  # what waits, waits before it

    def __init__(self, target: Any, sizes: SizeLimit, lost: Callable[[], None]) -> None:
        self.dropped = 0
        self._target = target
        self._sizes = sizes
        self._lost = lost
        self._ended = False
        self._putting = CallGuard()

    def write(self, data: bytes) -> bool:
        """Send one message; returns whether it arrived, and counts it in `dropped` where not.

        A hung InPort costs its time limit.
        """
        if self._sizes.refusal(len(data)):
            self.dropped += 1
            return False
        try:
            with calls, self._putting:
                self._target.put(data)
        except CORBA.TIMEOUT:
            self.dropped += 1
            return False  # it may be back for the next
        except CORBA.Exception as error:
            self.dropped += 1
            too_large = self._sizes.explain(error, self._target, len(data))
            if too_large:
                _log.warning("%s", too_large)
            elif not self._ended:
                self._lost()
            return False
        self._sizes.passed(len(data))
        return True

    def close(self) -> None:
        """Do nothing: nothing waits here."""

    def end(self, seconds: float) -> None:
        """Send no more, and wait up to `seconds` for what is under way."""
        self._ended = True
        self._putting.end(seconds)


class ThreadedPusher(Buffer):
    """A buffer that a thread of its own sends from: `new` and `periodic`.

    Messages that the push policy leaves out are not counted in `dropped`.

    Args:
        put: sends one message; called in that thread, must not raise.
        push: which of the messages that wait are sent.
        period: seconds from one round to the next; 0 for as soon as something waits.
    """

    def __init__(
        self,
        put: Callable[[bytes], object],
        policy: BufferPolicy,
        push: PushPolicy,
        period: float = 0.0,
    ) -> None:
        super().__init__(policy)
        self._put = put
        self._push = push
        self._every = push.skipped + 1 if push.which == "skip" else 1
        self._period = period
        self._passed = 0
        self._left = 0  # of what was taken to be sent, without the one that is being put
        self._is_putting = False
        self._ended = threading.Event()
        threading.Thread(target=self._run, name="uoarm-rtm-push", daemon=True).start()

    def close(self) -> None:
        """End the thread; what waits is not sent."""
        self._ended.set()
        super().close()

    @property
    def unsent(self) -> int:
        """How many messages are to be sent still; `put` counts what becomes of one it has."""
        with self._changed:
            waiting = len(self._waiting) if self._push.which != "new" else bool(self._waiting)
            return (
                self._left + (self._passed + waiting) // self._every - self._passed // self._every
            )

    @property
    def under_way(self) -> int:
        """How many messages are to be sent still, or are being put."""
        return self.unsent + self._is_putting

    def _run(self) -> None:
        most = 1 if self._push.which == "fifo" else None
        while waiting := self.take(most):
            chosen = self._chosen(waiting)
            self._left = len(chosen)
            for data in chosen:
                if self._ended.is_set():
                    return
                self._is_putting = True
                self._left -= 1
                self._put(data)
                self._is_putting = False
            self._ended.wait(self._period)

    def _chosen(self, waiting: Sequence[bytes]) -> list[bytes]:
        if self._push.which == "new":
            waiting = waiting[-1:]
        first, self._passed = self._passed + 1, self._passed + len(waiting)
        return [data for number, data in enumerate(waiting, first) if number % self._every == 0]


class PullBuffer(Buffer, OpenRTM__POA.OutPortCdr):  # type: ignore[misc]  # generated
    """A buffer that the other side asks for its messages; `close` ends calls that wait in `get`."""

    def get(self) -> tuple[Any, bytes]:
        """Return the next message, or what the buffer's policy gives (CORBA operation)."""
        data = self.read()
        if data is not None:
            return OpenRTM.PORT_OK, data
        waited = self.policy.empty == "block"
        return OpenRTM.BUFFER_TIMEOUT if waited else OpenRTM.BUFFER_EMPTY, b""


class Puller:
    """Asks `rate` times a second, in a thread of its own.

    Components in C++ give their last datum again for ever, unless asked otherwise; those in
    Python raise BAD_PARAM while they are empty (observed).

    Args:
        target: the OutPort, with its time limit set.
        rate: times a second.
        repeats: whether a datum that equals the one before it counts.
        take: called with each datum; must not raise.
        lost: called once, with the reason, when the OutPort is gone.
        missed: called for each answer that did not arrive although the OutPort is there; None:
            that counts as gone.
    """

    def __init__(
        self,
        target: Any,
        rate: float,
        *,
        repeats: bool,
        take: Callable[[bytes], object],
        lost: Callable[[CORBA.Exception], None],
        missed: Callable[[CORBA.Exception], None] | None = None,
    ) -> None:
        self._target = target
        self._period = 1.0 / rate
        self._repeats = repeats
        self._take = take
        self._lost = lost
        self._missed = missed
        self._ended = threading.Event()
        self._asking = CallGuard()
        threading.Thread(target=self._run, name="uoarm-rtm-pull", daemon=True).start()

    def end(self, seconds: float) -> None:
        """Ask no more, and wait up to `seconds` for the answer that is under way.

        A component in C++ aborts when it is disconnected while it is asked (observed).
        """
        self._ended.set()
        self._asking.end(seconds)

    def _report_lost(self, error: CORBA.Exception) -> None:
        if not self._ended.is_set():
            self._lost(error)

    def _run(self) -> None:
        before = b""
        while not self._ended.wait(self._period):
            try:
                with calls, self._asking:
                    status, data = self._target.get()
            except (CORBA.BAD_PARAM, CORBA.TIMEOUT):
                continue
            except (CORBA.COMM_FAILURE, CORBA.MARSHAL) as error:
                # What is larger than an ORB takes ends in these, too, and harms nothing else.
                if self._missed is None or not is_there(self._target):
                    self._report_lost(error)
                    return
                self._missed(error)
                continue
            except CORBA.Exception as error:
                self._report_lost(error)
                return
            if status == OpenRTM.PORT_OK and (self._repeats or data != before):
                before = data
                self._take(data)
