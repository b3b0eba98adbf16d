"""Discovered components as candidates: found in rounds, and given to the configuration in force."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial

from uoarm._control.live.driver import Driver
from uoarm._control.live.revisions import Revisions
from uoarm._dataplane import Clock
from uoarm._interrupts import wait_until
from uoarm._raised import LimitedLog, Log
from uoarm._resolve import (
    Discovery,
    DiscoveryRounds,
    Proofs,
    Structures,
    Unavailable,
    UndescribedComponents,
    add_candidates,
)
from uoarm.bridge import Bridge, BridgeType
from uoarm.errors import BridgeTimeoutError, UoarmError
from uoarm.model import Component, Endpoint, Robot

_ASK_SECONDS = 5.0
_GRACE_SECONDS = 1.0
_TURN_SECONDS = 1.0
_KEPT_ANSWERS = 3
_log = Log("uoarm")


class CandidateWatch:
    """Has discovered components for candidates, while a configuration has functions with needs.

    One thread asks all bridges in rounds, two seconds apart, or four times as long as a round
    takes; a component whose structures are not to be had is asked again as seldom. However often
    components come and go meanwhile, a round changes the candidates once at most. The thread begins
    with the first who needs candidates. A bridge that answers later than others is in a later
    round, and one that fails shows what it showed before, for three answers. In a new
    configuration's first three seconds the rounds follow each other closely, however long they
    take, until every function with needs has a candidate: so long those wait who ask for one, and
    until each bridge has answered once.

    Args:
        driver: takes the change, but for what is in use then.
        types: of bridges, by plugin; they know topics.
    """

    def __init__(
        self,
        revisions: Revisions,
        driver: Driver,
        get: Callable[[str], Bridge],
        types: Mapping[str, BridgeType],
        clock: Clock,
    ) -> None:
        self._records = LimitedLog(_log)
        self._revisions = revisions
        self._driver = driver
        self._types = types
        self._clock = clock
        self._proofs = Proofs(clock)
        self._rounds = DiscoveryRounds()
        self._undescribed = UndescribedComponents()
        # Guards what is known of rounds; requests wait on it for candidates, and the thread for a
        # close.
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._is_closed = False
        self._discovery = Discovery(get, _KEPT_ANSWERS)
        self._step = "no bridge was asked yet"

    def wait(self, timeout: float, function: str | None = None) -> float:
        """Wait until the configuration in force has its candidates; at once without needs.

        Args:
            timeout: seconds.
            function: where it is asked for alone; one that no candidate can provide or feed does
                not wait.

        Returns:
            How many of the seconds are left.

        Raises:
            BridgeTimeoutError: it has none in time; the text says what is waited for.
        """
        revision = self._revisions.current
        if not revision.needs_candidates:
            return timeout
        deadline = time.monotonic() + timeout
        with self._changed:
            if self._thread is None and not self._is_closed:
                thread = threading.Thread(target=self._run, name="uoarm-candidates", daemon=True)
                thread.start()
                self._thread = thread
            self._changed.notify_all()  # the thread may rest, and not know this configuration
            may_wait = function is None or self._is_known() or revision.has_needs(function)
            if not may_wait:
                return timeout
            if not wait_until(self._changed, self._is_known, timeout):
                said = "bridges have not yet listed what components they see"
                text = f"{said}, after {timeout:g} s: {self._step}"
                raise BridgeTimeoutError(text)
        return max(0.1, round(deadline - time.monotonic(), 1))

    def close(self) -> None:
        """Ask bridges no more. Idempotent; waits for a round no longer than a second."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._discovery.close()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(_TURN_SECONDS)

    def _run(self) -> None:
        while True:
            begun = self._clock()
            revision = self._revisions.current
            base = revision.base
            try:
                if revision.needs_candidates:
                    self._round(base)
            except UoarmError as error:
                _log.warning("looking for candidates failed: %s", error)
            except Exception as error:  # noqa: BLE001 - the next round may do better
                self._records.write(logging.ERROR, "looking for candidates failed", error)
            has_all = self._has_all(base)
            with self._changed:
                pause = self._rounds.ended(
                    base, begun, self._clock(), is_whole=self._discovery.is_whole, has_all=has_all
                )
                self._changed.notify_all()
                self._changed.wait_for(partial(self._is_outdated, base), pause)
                if self._is_closed:
                    return

    def _is_known(self) -> bool:
        return self._is_closed or self._rounds.matched is self._revisions.current.base

    def _is_outdated(self, base: Robot) -> bool:
        return self._is_closed or base is not self._revisions.current.base

    def _has_all(self, base: Robot) -> bool:
        """Say whether every function with needs has a candidate that was discovered."""
        revision = self._revisions.current
        return revision.base is base and all(
            any(component.match is not None for component in function.components)
            for function in revision.robot.functions.values()
            if function.needs is not None
        )

    def _round(self, base: Robot) -> None:
        self._step = "bridges are started, and asked what they see"
        findings = self._discovery.look(base, _ASK_SECONDS, _GRACE_SECONDS)
        types, bridges = self._types, base.bridges

        def topic(end: Endpoint) -> str | None:
            kind = types.get(bridges[end.bridge].plugin)
            if kind is None or kind.topic is None:
                return None
            return kind.topic(end.address, end.options) or None

        revision = self._revisions.current
        asked: dict[str, Structures | Unavailable] = {}

        def structures(component: Component) -> Structures | Unavailable:
            name = component.name
            if name in asked:
                return asked[name]
            begun = self._clock()
            found: Structures | Unavailable | None = self._undescribed.known(base, name, begun)
            if found is None:
                self._step = f"bridge {component.bridge!r} is asked for the structures of {name!r}"
                found = revision.structures.structures(component)
                if isinstance(found, Unavailable):
                    self._undescribed.note(name, found, begun, self._clock())
            asked[name] = found
            return found

        for item in base.components():
            if item.outputs:
                structures(item)  # before the time for proofs begins
        self._step = "what bridges see is compared with what functions need"
        self._proofs.begin_round()
        robot = add_candidates(
            base,
            findings,
            structures=structures,
            topic=topic,
            proofs=self._proofs,
        )
        if self._proofs.unjudged:
            _log.info("%d pairs of structures wait to be compared", self._proofs.unjudged)
        with self._revisions.alone(_TURN_SECONDS):
            if self._revisions.current.base is base:
                self._driver.change_candidates(robot)
