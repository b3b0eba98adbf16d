"""How an OutPort of ours hands data to one connector: at once, the newest, or on request."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from omniORB import CORBA

from uoarm_rtm._calls import calls
from uoarm_rtm._stubs import OpenRTM, OpenRTM__POA
from uoarm_rtm._wishes import Wishes

__all__ = ["Pulled", "Pusher", "Threaded"]

_BUFFERED = 8


class Pusher:
    """Calls an InPort in the thread that writes (`flush`).

    Args:
        target: the InPort, with its time limit set.
        lost: told once, when the InPort is gone.
    """

    def __init__(self, target: Any, lost: Callable[[], None]) -> None:
        self._target = target
        self._lost = lost

    def write(self, data: bytes) -> None:
        """Send one message; a hung InPort costs its time limit."""
        try:
            with calls:
                self._target.put(data)
        except CORBA.TIMEOUT:
            return  # it may be back for the next
        except CORBA.Exception:
            self._lost()

    def close(self) -> None:
        """End."""


class Threaded:
    """Sends the newest message from a thread of its own: `new` and `periodic`."""

    def __init__(self, pusher: Pusher, wishes: Wishes) -> None:
        self._pusher = pusher
        self._period = 1.0 / wishes.rate if wishes.subscription == "periodic" else 0.0
        self._changed = threading.Condition()
        self._newest: bytes | None = None
        self._closed = False
        threading.Thread(target=self._run, name="uoarm-rtm-push", daemon=True).start()

    def write(self, data: bytes) -> None:
        """Replace what waits to be sent."""
        with self._changed:
            self._newest = data
            self._changed.notify()

    def close(self) -> None:
        """End the thread; what waits is dropped."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._newest is not None)
                if self._closed:
                    return
                data, self._newest = self._newest, None
            assert data is not None
            self._pusher.write(data)
            if self._period:
                with self._changed:
                    self._changed.wait_for(lambda: self._closed, self._period)


class Pulled(OpenRTM__POA.OutPortCdr):  # type: ignore[misc]  # generated, without annotations
    """Keeps the last messages until the other side asks for them."""

    def __init__(self) -> None:
        self._waiting: deque[bytes] = deque(maxlen=_BUFFERED)

    def get(self) -> tuple[Any, bytes]:
        """Return the oldest message that waits (CORBA operation)."""
        try:
            return OpenRTM.PORT_OK, self._waiting.popleft()
        except IndexError:
            return OpenRTM.BUFFER_EMPTY, b""

    def write(self, data: bytes) -> None:
        """Keep one message; the oldest gives way."""
        self._waiting.append(data)

    def close(self) -> None:
        """End."""
