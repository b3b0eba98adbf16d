"""One host from start to end: its folder, link, process and pulse."""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from uoarm._host import _keys
from uoarm._host._folders import link_folder
from uoarm._host._lifeline import Lifeline
from uoarm._host._link import Link
from uoarm._host._process import HostProcess, host_command
from uoarm._host._pulse import Pulse
from uoarm._host._settings import HostSettings
from uoarm._host._tally import Tally
from uoarm.bridge import CONTRACT_VERSION
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import BridgeSpec

__all__ = ["HostConnection"]

_log = logging.getLogger("uoarm")
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
        origin: the configuration file, which the host's command line shows.

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
        origin: str = "",
    ) -> None:
        self._name = spec.name
        self._memory = settings.memory
        self._life = Lifeline(spec.name, doubted, died)
        self._link: Link | None = None
        self._started: HostProcess | None = None
        self._pulse: Pulse | None = None
        deadline = time.monotonic() + settings.start
        command = host_command(settings.interpreter(), spec.name, origin)
        variables = settings.process_variables(os.environ)
        folder, self.tally = _tallied_folder(spec.name)
        try:
            place = f"unixsock-stream/{folder}/link"
            lease = max(_LEASE_SECONDS, 3 * settings.silence)
            shared = settings.shared_memory
            self._link = Link(place, listen=True, lease=lease, shared_memory=shared)
            self._link.watch_alive(_keys.ALIVE, self._life.seen)
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
            doubted=self._life.doubt,
            given_up=self._give_up,
        )
        self._pulse.start()
        atexit.register(self._end_with_python)

    @property
    def dead(self) -> str:
        """Why the host died, "" while it lives."""
        return self._life.dead

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
        return self._life.ask(self.link, operation, values)

    def close(self, say_close: Callable[[], object] | None) -> None:
        """End the host: with `say_close` when it is given and the host lives, else at once.

        Raises:
            UoarmError: the bridge in the host failed while closing; the host has ended anyway.
            BridgeError: its process does not end.
        """
        atexit.unregister(self._end_with_python)
        self._life.give_back()
        if self._pulse is not None:
            self._pulse.stop()
        try:
            if say_close is not None and not self.dead:
                say_close()
        finally:
            ends_alone = say_close is not None or bool(self.dead)
            try:
                if self._started is not None:
                    self._started.end(_POLITE_SECONDS if ends_alone else 0.0)
            finally:
                if self._pulse is not None:
                    self._pulse.join(_JOIN_SECONDS)
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
        """Wait for the token; where the process ended instead, say what it printed last."""
        try:
            self._life.await_token(deadline)
        except BridgeError as error:
            if not self.dead or self._started is None:
                raise
            text = f"{error}\n{self._started.last_words}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error

    def _greet(self, deadline: float) -> Mapping[str, Any]:
        greeting = self._life.greet(self.link, deadline)
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

    def _exited(self, how: str) -> None:
        self._life.die(f"{how}; it might have {self._memory} of memory" if self._memory else how)

    def _give_up(self, silent: float) -> None:
        self._life.die(f"it has not answered for {silent:.1f} s")
        if self._started is not None:
            self._started.kill()


def _tallied_folder(name: str) -> tuple[Path, Tally]:
    """Make the folder of a link, with the counters that both ends share.

    Raises:
        BridgeError: UNAVAILABLE, such as where the disk is full.
    """
    folder: Path | None = None
    try:
        folder = link_folder()
        return folder, Tally(folder / "tally", make=True)
    except OSError as error:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        text = f"bridge host {name!r} has no place for its link: {error}"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
