# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""What processes of ours have left in components: ended by the next one, and only that."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from _uoarm_rtm_stubs import RTC, SDOPackage
from omniORB import CORBA

from uoarm.errors import BridgeError
from uoarm_rtm._calls import calls
from uoarm_rtm._journal import JournalEntry, journal
from uoarm_rtm._orb import Orb, limit

__all__ = ["NAME", "PROCESS", "Leftovers", "end_connector", "end_observer"]

NAME, PROCESS = "uoarm.name", "uoarm.process"
"""Properties in which a connector names its maker: the bridge, and `Journal.process`."""

_AT_ONCE = 8

_log = logging.getLogger("uoarm.rtm")


def end_connector(identifier: str, ports: Sequence[Any]) -> bool:
    """End a connector at each of its ports, of which any may be gone; those have no connectors.

    The first walks all of them. The others are notified on their own, since a walk ends at a port
    whose component is gone, and leaves those behind it as they are (observed).

    Returns:
        Whether a port had it, or is gone: else it may be about to be made.

    Raises:
        CORBA.TIMEOUT: a port did not answer; the others were notified.
    """
    silent: CORBA.TIMEOUT | None = None
    is_over = False
    for index, port in enumerate(ports):
        try:
            disconnect = port.disconnect if index == 0 else port.notify_disconnect
            is_over = disconnect(identifier) == RTC.RTC_OK or is_over
        except CORBA.TIMEOUT as error:
            silent = error
        except CORBA.Exception as error:
            _log.debug("connector %s: a port is gone: %r", identifier, error)
            is_over = True
    if silent is not None:
        raise silent
    return is_over


def end_observer(identifier: str, configuration: Any) -> None:
    """Remove an observer from a component, which may be gone or have none of that name.

    Raises:
        CORBA.TIMEOUT: the component did not answer.
    """
    try:
        configuration.remove_service_profile(identifier)
    except CORBA.TIMEOUT:
        raise
    except CORBA.Exception as error:
        _log.debug("observer %s: %r", identifier, error)


class Leftovers:
    """What the journals of processes that are gone hold.

    Args:
        orb: the ORB to call through.
        seconds: limit of each call.
    """

    def __init__(self, orb: Orb, seconds: float) -> None:
        self._orb = orb
        self._seconds = seconds

    def end(self) -> int:
        """End them, several at once; returns how many.

        Those whose component hangs are left in the journal, for the next process. Blocks for the
        limits of two calls at most, however many there are.
        """
        ended = 0
        deadline = time.monotonic() + self._seconds

        def end(entry: JournalEntry) -> bool:
            return time.monotonic() < deadline and self._end(entry)

        for token, entries in journal().left():
            if not entries:
                continue
            with ThreadPoolExecutor(_AT_ONCE, "uoarm-rtm-clear") as pool:
                for entry, done in zip(entries, pool.map(end, entries), strict=True):
                    if done:
                        journal().forget(token, entry.id)
                        ended += 1
        if ended:
            _log.info("ended %d connections that killed processes of ours had left", ended)
        return ended

    def _end(self, entry: JournalEntry) -> bool:
        """End one; returns whether it is certain that it does not exist any more."""
        kind = SDOPackage.Configuration if entry.is_observer else RTC.PortService
        references = []
        for ior in entry.references:
            try:
                reference = self._orb.reference(ior)._unchecked_narrow(kind)
                references.append(limit(reference, self._seconds))
            except (BridgeError, AttributeError):  # what cannot be read was never connected
                _log.warning("%s: the journal has no reference of it", entry.where)
        try:
            with calls:
                if not entry.is_observer:
                    end_connector(entry.id, references)
                for item in references if entry.is_observer else ():
                    end_observer(entry.id, item)
        except CORBA.Exception as error:
            _log.warning("%s at %s is left: %r", entry.id, entry.where, error)
            return False
        return True
