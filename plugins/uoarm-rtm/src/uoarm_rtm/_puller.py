"""Asking an OutPort for its data again and again."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from _uoarm_rtm_stubs import OpenRTM
from omniORB import CORBA

from uoarm_rtm._calls import CallGuard, calls
from uoarm_rtm._sizes import is_there

__all__ = ["Puller"]


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
