"""How an OutPort of ours hands data to one connector: at once, from a thread, or on request."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from _uoarm_rtm_stubs import OpenRTM, OpenRTM__POA
from omniORB import CORBA

from uoarm_rtm._buffer import Buffer
from uoarm_rtm._buffering import BufferPolicy, PushPolicy
from uoarm_rtm._calls import CallGuard, calls
from uoarm_rtm._sizes import SizeLimit

__all__ = ["PullBuffer", "Pusher", "ThreadedPusher"]

_log = logging.getLogger("uoarm.rtm")


class Pusher:
    """Calls an InPort in the thread that writes (`flush`).

    Args:
        target: the InPort, with its time limit set.
        sizes: what is known of how large a message it takes.
        lost: called when the InPort is gone; not once `end` was called, when the InPort is still
            to be notified of the end.
    """

    def __init__(self, target: Any, sizes: SizeLimit, lost: Callable[[], None]) -> None:
        self.dropped = 0
        self._target = target
        self._sizes = sizes
        self._lost = lost
        self._ended = False
        self._putting = CallGuard()

    def write(self, data: bytes) -> bool:
        """Send one message; a hung InPort costs its time limit, one too large is dropped."""
        if self._sizes.refusal(len(data)):
            self.dropped += 1
            return False
        try:
            with calls, self._putting:
                self._target.put(data)
        except CORBA.TIMEOUT:
            return True  # it may be back for the next
        except CORBA.Exception as error:
            too_large = self._sizes.explain(error, self._target, len(data))
            if too_large:
                _log.warning("%s", too_large)
                self.dropped += 1
                return False
            if not self._ended:
                self._lost()
        else:
            self._sizes.passed(len(data))
        return True

    def close(self) -> None:
        """Do nothing: nothing waits here."""

    def end(self, seconds: float) -> None:
        """Send no more, and wait up to `seconds` for what is under way."""
        self._ended = True
        self._putting.end(seconds)


class ThreadedPusher:
    """Sends from a thread of its own, out of a buffer: `new` and `periodic`.

    Args:
        put: sends one message; called in that thread, must not raise.
        buffer: policy of what waits.
        push: which of the messages that wait are sent.
        period: seconds from one round to the next; 0 for as soon as something waits.
    """

    def __init__(
        self,
        put: Callable[[bytes], object],
        buffer: BufferPolicy,
        push: PushPolicy,
        period: float = 0.0,
    ) -> None:
        self._put = put
        self._push = push
        self._period = period
        self._passed = 0
        self._buffer = Buffer(buffer)
        self._ended = threading.Event()
        threading.Thread(target=self._run, name="uoarm-rtm-push", daemon=True).start()

    @property
    def dropped(self) -> int:
        """Messages that gave way or were not taken; those left out by policy are not counted."""
        return self._buffer.dropped

    def write(self, data: bytes) -> bool:
        """Have a message wait to be sent; returns whether the buffer took it."""
        return self._buffer.write(data)

    def drain(self, seconds: float) -> bool:
        """Wait until nothing waits any more; returns whether that came."""
        return self._buffer.drain(seconds)

    def close(self) -> None:
        """End the thread; what waits is not sent."""
        self._ended.set()
        self._buffer.close()

    def _run(self) -> None:
        most = 1 if self._push.which == "fifo" else None
        while waiting := self._buffer.take(most):
            for data in self._chosen(waiting):
                if self._ended.is_set():
                    return
                self._put(data)
            self._ended.wait(self._period)

    def _chosen(self, waiting: Sequence[bytes]) -> Iterator[bytes]:
        if self._push.which == "new":
            waiting = waiting[-1:]
        every = self._push.skipped + 1 if self._push.which == "skip" else 1
        for data in waiting:
            self._passed += 1
            if self._passed % every == 0:
                yield data


class PullBuffer(OpenRTM__POA.OutPortCdr):  # type: ignore[misc]  # generated, without annotations
    """Keeps messages in a buffer until the other side asks for them.

    Args:
        policy: of the buffer.
    """

    def __init__(self, policy: BufferPolicy) -> None:
        self._buffer = Buffer(policy)

    @property
    def dropped(self) -> int:
        """Messages that gave way or were not taken."""
        return self._buffer.dropped

    def get(self) -> tuple[Any, bytes]:
        """Return the next message, or what the buffer's policy gives (CORBA operation)."""
        data = self._buffer.read()
        if data is not None:
            return OpenRTM.PORT_OK, data
        waited = self._buffer.policy.empty == "block"
        return OpenRTM.BUFFER_TIMEOUT if waited else OpenRTM.BUFFER_EMPTY, b""

    def write(self, data: bytes) -> bool:
        """Have a message wait; returns whether the buffer took it."""
        return self._buffer.write(data)

    def drain(self, seconds: float) -> bool:
        """Wait until nothing waits any more; returns whether that came."""
        return self._buffer.drain(seconds)

    def close(self) -> None:
        """End; calls that wait in `get` or `write` return."""
        self._buffer.close()
