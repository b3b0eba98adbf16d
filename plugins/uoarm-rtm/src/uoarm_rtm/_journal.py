# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""What this process has in components, in private files, so that what a killed one leaves ends.

    $XDG_STATE_HOME/uoarm/rtm/TOKEN/lock     held locked for as long as the process runs
    $XDG_STATE_HOME/uoarm/rtm/TOKEN/ID.json  one for each connector or observer that may exist

The kernel releases the lock however the process ends, so a folder whose lock can be had belongs
to a process that is gone. An entry is written before a component is asked to connect and removed
after the connector has ended: what is in no file was never connected, or has ended. What a process
left is ended by the next one, and only that.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import secrets
import shutil
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from _uoarm_rtm_stubs import RTC, SDOPackage
from attrs import frozen
from omniORB import CORBA

from uoarm.bridge import Log, WorkerExecutor, at_exit, reason_of
from uoarm.errors import BridgeError, UsageError
from uoarm.plugins import user_folder
from uoarm_rtm._orb import Orb, calls, limit

_MOST_OCTETS = 1 << 16
_MOST_ENTRIES = 10_000
_LOCK = "lock"

_log = Log("uoarm.rtm")


@frozen
class JournalEntry:
    """A connector, or an observer in a component.

    Attributes:
        references: stringified, of the ports, or of the configuration that has the observer.
        where: the ports or the component, for the log.
    """

    id: str
    references: tuple[str, ...]
    where: str
    is_observer: bool = False


class Journal:
    """The files of one process.

    Where they cannot be written, that is logged once and connections are made all the same.

    Args:
        base: folder of all processes of this user; None: there is none.
    """

    def __init__(self, base: Path | None) -> None:
        self._base = base or Path(os.devnull)  # below which nothing is, and nothing can be made
        self.token = secrets.token_hex(8)
        self._lock: int | None = None
        self._broken = base is None
        # Guards the making of our folder and files, and `_broken`: any thread may connect.
        self._guard = threading.Lock()
        # Held while the lock of another process's folder is tried, from other threads of this one:
        # a record lock keeps no thread of its own process out, and any close gives it up.
        self._looking = threading.Lock()

    @property
    def process(self) -> str:
        """What connectors say of their maker: host, process id and token."""
        return f"{socket.gethostname()}/{os.getpid()}/{self.token}"

    def write(self, entry: JournalEntry) -> None:
        """Keep an entry; it is on its way to the disk when this returns, and outlives us."""
        with self._guard:
            if self._broken:
                return
            try:
                folder = self._folder()
                file = folder / f"{entry.id}.json"
                new = file.with_suffix(".new")
                kind = "observer" if entry.is_observer else "ports"
                new.write_text(json.dumps({kind: entry.references, "where": entry.where}))
                new.replace(file)
            except OSError as error:
                self._broken = True
                text = "connections cannot be noted in %s (%s): a kill would leave them behind"
                _log.warning(text, self._base, reason_of(error))

    def erase(self, identifier: str, token: str = "") -> None:
        """Remove an entry, whose connector has ended; also one that is not there.

        Args:
            identifier: of the connector or observer.
            token: of the process that wrote it, where that is gone; empty for this one.
        """
        with contextlib.suppress(OSError):
            (self._base / (token or self.token) / f"{identifier}.json").unlink()

    def runs(self, token: str) -> bool | None:
        """Whether a process runs; None for one that has no files here."""
        if token == self.token:
            return True
        if not (self._base / token / _LOCK).is_file():
            return None
        with self._looking, self._locked(token) as dead:
            return not dead

    def left(self) -> Iterator[tuple[str, list[JournalEntry]]]:
        """Yield the token and the entries of each process that is gone, one at a time.

        No other process is given them meanwhile. `erase` removes an entry; what stays is yielded
        again another time.
        """
        try:
            tokens = sorted(path.name for path in self._base.iterdir() if path.name[0] != ".")
        except OSError:
            return
        for token in tokens:
            if token == self.token:
                continue
            with self._looking, self._locked(token) as dead:
                if not dead:
                    continue
                yield token, self._entries(token)
                if not any((self._base / token).glob("*.json")):
                    shutil.rmtree(self._base / token, ignore_errors=True)

    def close(self) -> None:
        """Remove our folder where nothing is left in it; the process is about to end."""
        with self._guard, contextlib.suppress(OSError):
            folder = self._base / self.token
            if self._lock is not None and not any(folder.glob("*.json")):
                shutil.rmtree(folder)

    def _folder(self) -> Path:
        folder = self._base / self.token
        if self._lock is None:
            # It gets its name when it is locked, so that no process takes it for a dead one's.
            made = folder.with_name(f".{self.token}")
            made.mkdir(mode=0o700, parents=True)
            lock = os.open(made / _LOCK, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
            # Record locks are the process's own: children that are forked do not hold them.
            fcntl.lockf(lock, fcntl.LOCK_EX)
            made.rename(folder)
            self._lock = lock
        return folder

    @contextlib.contextmanager
    def _locked(self, token: str) -> Iterator[bool]:
        """Hold the lock of another process's folder; False where it has it, or the folder goes."""
        try:
            lock = os.open(self._base / token / _LOCK, os.O_RDWR | os.O_CLOEXEC)
        except OSError:
            yield False
            return
        try:
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield False
        else:
            yield True
        finally:
            os.close(lock)

    def _entries(self, token: str) -> list[JournalEntry]:
        entries = []
        for file in sorted((self._base / token).glob("*.json"))[:_MOST_ENTRIES]:
            try:
                with file.open("rb") as opened:
                    found = json.loads(opened.read(_MOST_OCTETS))
                is_observer = "observer" in found
                references = found["observer" if is_observer else "ports"]
                texts = tuple(str(reference) for reference in references)
                entries.append(JournalEntry(file.stem, texts, str(found["where"]), is_observer))
            except (OSError, ValueError, KeyError, TypeError):
                _log.warning("%s is no entry of a connection: removed", file)
                self.erase(file.stem, token)
        return entries


class _Process:
    def __init__(self) -> None:
        # Guards the journal, which the first thread that connects makes for all others.
        self._guard = threading.Lock()
        self._journal: Journal | None = None

    def journal(self) -> Journal:
        """Return the journal of this process; a child that is forked begins one of its own."""
        with self._guard:
            if self._journal is None:
                self._journal = Journal(self._folder())
                at_exit(self._journal.close)
            return self._journal

    def _folder(self) -> Path | None:
        try:
            return user_folder("state") / "rtm"
        except UsageError as error:
            _log.warning("connections cannot be noted: a kill would leave them behind: %s", error)
            return None

    def forget(self) -> None:
        self.__init__()  # type: ignore[misc]  # in a child, where no other thread is


_process = _Process()
os.register_at_fork(after_in_child=_process.forget)
journal = _process.journal


def process_of(text: str) -> tuple[str, int, str] | None:
    """Read what `Journal.process` writes: host, process id, token; None for anything else."""
    parts = text.split("/")
    if len(parts) != 3 or not all(parts) or not parts[1].isdigit():  # noqa: PLR2004 - as it says
        return None
    return parts[0], int(parts[1]), parts[2]


NAME, PROCESS = "uoarm.name", "uoarm.process"
"""Properties in which a connector names its maker: the bridge, and `Journal.process`."""

_AT_ONCE = 8


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


def end_leftovers(orb: Orb, seconds: float) -> int:
    """End what the journals of processes that are gone hold, several at once; returns how many.

    Those whose component hangs are left in the journal, for the next process. Blocks for the
    limits of two calls at most, however many there are.
    """
    ended = 0
    deadline = time.monotonic() + seconds

    def end(entry: JournalEntry) -> bool:
        return time.monotonic() < deadline and _end_entry(orb, entry, seconds)

    for token, entries in journal().left():
        if not entries:
            continue
        with WorkerExecutor("uoarm-rtm-clear", _AT_ONCE) as pool:
            for entry, is_ended in zip(entries, pool.map(end, entries), strict=True):
                if is_ended:
                    journal().erase(entry.id, token)
                    ended += 1
    if ended:
        _log.info("ended %d connections that killed processes of ours had left", ended)
    return ended


def _end_entry(orb: Orb, entry: JournalEntry, seconds: float) -> bool:
    """End one; returns whether it is certain that it does not exist any more."""
    kind = SDOPackage.Configuration if entry.is_observer else RTC.PortService
    references = []
    for ior in entry.references:
        try:
            references.append(limit(orb.reference(ior)._unchecked_narrow(kind), seconds))
        except (BridgeError, AttributeError):  # what cannot be read was never connected
            _log.warning("%s: the journal has no reference of it", entry.where)
    try:
        with calls:
            if entry.is_observer:
                for configuration in references:
                    end_observer(entry.id, configuration)
            else:
                end_connector(entry.id, references)
    except CORBA.Exception as error:
        _log.warning("%s at %s is left: %r", entry.id, entry.where, error)
        return False
    return True
