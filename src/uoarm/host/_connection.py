"""One host from start to end: its folder, link, process and pulse."""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from uoarm.bridge import CONTRACT_VERSION
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError
from uoarm.host import _keys
from uoarm.host._folders import link_folder
from uoarm.host._link import ANSWER_SECONDS, Link
from uoarm.host._process import HostProcess, host_command
from uoarm.host._pulse import Pulse
from uoarm.host._settings import HostSettings
from uoarm.host._tally import Tally
from uoarm.model import BridgeSpec

__all__ = ["HostConnection"]

_log = logging.getLogger("uoarm")
_MARGIN_SECONDS = 0.5
_NEWS_SECONDS = 0.3
_POLITE_SECONDS = 1.5
_JOIN_SECONDS = 2.0
_LEASE_SECONDS = 10.0


class HostConnection:
    """Starts a host and returns when it is ready: its token seen and its greeting heard.

    Args:
        spec: the bridge that runs in it.
        settings: of the host.
        heard: told what every answer of its pulse holds.
        doubted: told that it does not answer, or does again, and the cause.
        died: told once why it died; `dead` is set already.

    Raises:
        UoarmError: what starting the bridge in the host raised.
        BridgeError: it could not be started, or speaks another version.
        BridgeTimeoutError: it was not ready in time.
    """

    def __init__(
        self,
        spec: BridgeSpec,
        settings: HostSettings,
        *,
        heard: Callable[[Any], None],
        doubted: Callable[[bool, str], None],
        died: Callable[[str], None],
    ) -> None:
        self._name = spec.name
        self._died = died
        self._doubted = doubted
        self._memory = settings.memory
        self._state = threading.Condition()
        self._alive = False
        self._closing = False
        self._link: Link | None = None
        self._started: HostProcess | None = None
        self.dead = ""
        deadline = time.monotonic() + settings.start
        command = host_command(settings.interpreter())
        variables = settings.process_variables(os.environ)
        folder = link_folder()
        try:
            self.tally = Tally(folder / "tally", make=True)
            place = f"unixsock-stream/{folder}/link"
            lease = max(_LEASE_SECONDS, 3 * settings.silence)
            shared = settings.shared_memory
            self._link = Link(place, listen=True, lease=lease, shared_memory=shared)
            self._link.watch_alive(_keys.ALIVE, self._seen)
            self._started = HostProcess(spec.name, command, variables, self._exited)
            self._started.tell(
                {
                    "name": spec.name,
                    "plugin": spec.plugin,
                    "options": dict(spec.options),
                    "place": place,
                    "folder": str(folder),
                    "tally": str(folder / "tally"),
                    "parent": os.getpid(),
                    "memory": settings.memory_bytes,
                    "lease": lease,
                    "shared_memory": shared,
                }
            )
            self._await_token(deadline)
            self.greeting = self._greet(deadline)
        except BaseException:
            self.close(None)
            raise
        finally:
            shutil.rmtree(folder, ignore_errors=True)  # both ends stand: nobody needs it now
        self._pulse = Pulse(
            spec.name,
            self._link,
            silence=settings.silence,
            heard=heard,
            doubted=self._doubt,
            given_up=self._give_up,
        )
        self._pulse.start()
        atexit.register(self._end_with_python)

    @property
    def link(self) -> Link:
        """The link to the host."""
        assert self._link is not None, "the constructor raises when there is none"
        return self._link

    @property
    def process(self) -> int:
        """The id of the host's process."""
        assert self._started is not None, "the constructor raises when there is none"
        return self._started.number

    def ask(self, operation: str, values: Mapping[str, Any]) -> Any:
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
            return self.link.ask(_keys.ASK, {"op": operation, **values}, timeout=limit)
        except BridgeError as error:
            if error.reason is not FailureReason.UNAVAILABLE:
                raise
            with self._state:
                self._state.wait_for(lambda: bool(self.dead), _NEWS_SECONDS)
            self._refuse_dead(operation, error)
            raise

    def close(self, say_close: Callable[[], object] | None) -> None:
        """End the host: with `say_close` when it is given and the host lives, else at once.

        Raises:
            UoarmError: the bridge in the host failed while closing; the host has ended anyway.
            BridgeError: its process does not end.
        """
        atexit.unregister(self._end_with_python)
        with self._state:
            self._closing = True
        pulse: Pulse | None = getattr(self, "_pulse", None)
        if pulse is not None:
            pulse.stop()
        try:
            if say_close is not None and not self.dead:
                say_close()
        finally:
            ends_alone = say_close is not None or bool(self.dead)
            try:
                if self._started is not None:
                    self._started.end(_POLITE_SECONDS if ends_alone else 0.0)
            finally:
                if pulse is not None:
                    pulse.join(_JOIN_SECONDS)
                if self._link is not None:
                    self._link.close()
                    self.tally.close()

    def _end_with_python(self) -> None:
        """End a host that nobody closed before the interpreter ends."""
        try:
            self.close(None)
        except UoarmError as error:
            _log.warning("%s", error)

    def _await_token(self, deadline: float) -> None:
        with self._state:
            self._state.wait_for(
                lambda: self._alive or bool(self.dead), deadline - time.monotonic()
            )
        if self.dead:
            assert self._started is not None, "only a process can have ended"
            text = f"bridge host {self._name!r} did not start: {self.dead}"
            raise BridgeError(f"{text}\n{self._started.last_words}", FailureReason.UNAVAILABLE)
        if not self._alive:
            raise BridgeTimeoutError(f"bridge host {self._name!r} was not ready in time")

    def _greet(self, deadline: float) -> Mapping[str, Any]:
        limit = max(0.1, deadline - time.monotonic())
        greeting: Mapping[str, Any] = self.link.ask(_keys.ASK, {"op": "hello"}, timeout=limit)
        ours = {"link": _keys.LINK_VERSION, "contract": CONTRACT_VERSION}
        for what, version in ours.items():
            if greeting.get(what) != version:
                raise BridgeError(
                    f"bridge host {self._name!r} has uoarm {greeting.get('version')} with {what} "
                    f"version {greeting.get(what)}, the manager has {version}: install the same "
                    "uoarm in the host's environment",
                    FailureReason.UNSUPPORTED,
                )
        return greeting

    def _refuse_dead(self, operation: str, cause: UoarmError | None = None) -> None:
        if self.dead:
            text = f"bridge host {self._name!r} is dead, {operation!r} is not possible"
            raise BridgeError(f"{text}: {self.dead}", FailureReason.UNAVAILABLE) from cause

    def _seen(self, alive: bool) -> None:  # noqa: FBT001 - told, not asked
        with self._state:
            self._alive = alive
            self._state.notify_all()

    def _exited(self, how: str) -> None:
        self._die(f"{how}; it might have {self._memory} of memory" if self._memory else how)

    def _doubt(self, in_doubt: bool) -> None:  # noqa: FBT001 - told, not asked
        self._doubted(in_doubt, "its bridge host does not answer" if in_doubt else "it answers")

    def _give_up(self, silent: float) -> None:
        self._die(f"it has not answered for {silent:.1f} s")
        if self._started is not None:
            self._started.kill()

    def _die(self, cause: str) -> None:
        with self._state:
            if self.dead or self._closing:
                return
            self.dead = cause
            self._state.notify_all()
        self._died(cause)
