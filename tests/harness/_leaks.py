"""What a test leaves behind: threads, processes, descriptors, temporary folders, changed settings.

Linux shows all of it; elsewhere processes and descriptors go unseen.
"""

from __future__ import annotations

import functools
import gc
import locale
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from typing_extensions import ParamSpec

from uoarm.testing import patience, wait

P = ParamSpec("P")
T = TypeVar("T")
MARK = "UOARM_TEST_MADE_BY"
_RUN = f"{os.getpid()}-{time.monotonic_ns()}"
_PROCESSES = Path("/proc")
_DESCRIPTORS = Path("/proc/self/fd")
_GLANCE_SECONDS = 0.01
# These come by themselves with a library's first use and stay for the next one.
_OF_LIBRARIES = re.compile(r"anon_inode:|/dev/(u?random|null)$|/memfd:|.*\.(so|py|zip|db)$")
_END_OF_VARIABLES = 48  # of the fields that follow the name in /proc/PID/stat; see proc_pid_stat(5)
_IDLE_THREADS = {"uoarm-step"}  # the core's own, which end by themselves

_starts = 0  # looking for processes costs too much to be done after tests that started none


def _notice() -> None:
    global _starts  # noqa: PLW0603 - each way of starting a process comes here
    _starts += 1


def _noticed(start: Callable[P, T]) -> Callable[P, T]:
    @functools.wraps(start)
    def run(*arguments: P.args, **options: P.kwargs) -> T:
        _notice()
        return start(*arguments, **options)

    return run


# An audit hook sees them all, but each call of `id`, too, of which a check of schemas makes many.
os.register_at_fork(before=_notice)
for _name in ("system", "posix_spawn", "posix_spawnp"):
    setattr(os, _name, _noticed(getattr(os, _name)))
subprocess.Popen._execute_child = _noticed(subprocess.Popen._execute_child)  # type: ignore[attr-defined]


class maker:  # noqa: N801 - used like a function
    """Everything that processes started in this block, and by their children, is put to a name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __enter__(self) -> None:
        self._before = os.environ.get(MARK)
        os.environ[MARK] = f"{_RUN} {self._name}"

    def __exit__(self, *error: object) -> None:
        if self._before is None:
            os.environ.pop(MARK, None)
        else:
            os.environ[MARK] = self._before


class Holdings:
    """What this process holds at one moment, and how it is set."""

    def __init__(self) -> None:
        self._starts = _starts
        self._threads = set(threading.enumerate())
        self._descriptors = _descriptors()
        self._folders = _folders()
        self._settings = _settings()

    def keep(self, before: Holdings) -> None:
        """Count what has come since `before` as held: by a fixture that other tests use, too."""
        self._threads |= set(threading.enumerate()) - before._threads
        self._descriptors += _descriptors() - before._descriptors
        self._folders |= _folders() - before._folders
        settings = _settings()
        self._settings |= {
            name: value for name, value in settings.items() if value != before._settings.get(name)
        }

    def left(self, name: str, kept: tuple[str, ...] = ()) -> list[str]:
        """Return what is there that was not, after the time that it may take to end by itself.

        What begins with one of `kept` does not count.
        """
        found = self._found(name, kept)
        if found:
            deadline = time.monotonic() + patience() / 6
            pause = threading.Event()
            gc.collect()
            while (found := self._found(name, kept)) and time.monotonic() < deadline:
                pause.wait(_GLANCE_SECONDS)
                gc.collect()  # a thread may have let go of a cycle since the last time
        settings = _settings()
        return found + [
            f"{what} changed from {self._settings.get(what)!r} to {settings.get(what)!r}"
            for what in self._settings.keys() | settings.keys()
            if self._settings.get(what) != settings.get(what)
        ]

    def _new_threads(self) -> Iterator[threading.Thread]:
        for thread in threading.enumerate():
            if thread not in self._threads and not isinstance(thread, threading._DummyThread):
                yield thread

    def _found(self, name: str, kept: tuple[str, ...]) -> list[str]:
        # One that has taken the place of another of its name, which has ended, is not one more.
        new = Counter(
            thread.name for thread in self._new_threads() if thread.name not in _IDLE_THREADS
        )
        new -= Counter(thread.name for thread in self._threads if not thread.is_alive())
        found = [f"thread {element!r}" for element in new.elements()]
        if _starts != self._starts:
            found += [f"process {pid}: {text}" for pid, text in processes_of(name).items()]
        extra = _descriptors() - self._descriptors
        found += [f"descriptor of {element}" for element in extra.elements()]
        found += [f"temporary {folder}" for folder in _folders() - self._folders]
        return [word for word in found if not word.startswith(kept)]


def processes_of(name: str = "") -> dict[int, str]:
    """Return the processes made by this run under a name, or under any, with their commands."""
    wanted = f"{MARK}={_RUN} {name}"
    found = {}
    for folder in _PROCESSES.iterdir() if _PROCESSES.is_dir() else ():
        if not folder.name.isdigit() or int(folder.name) == os.getpid():
            continue
        with suppress(OSError):  # it ended meanwhile, or is another user's
            entries = variables_of(folder).decode(errors="replace").split("\0")
            made = [entry for entry in entries if entry.startswith(MARK)]
            if made and (made[0] == wanted if name else made[0].startswith(wanted)):
                command = (folder / "cmdline").read_bytes().decode(errors="replace")
                found[int(folder.name)] = command.replace("\0", " ")[:200]
    return found


def variables_of(process: Path) -> bytes:
    """Return the environment that a process was started with.

    A start returns as soon as the kernel has let go of the old program, which is before the new
    one's variables are in place: until then there are none to read, and no end of them is known.
    """

    def are_in_place() -> bool:
        (process / "exe").readlink()  # fails for a thread of the kernel and for what has ended
        fields = (process / "stat").read_bytes().rpartition(b")")[2].split()
        return fields[_END_OF_VARIABLES] != b"0"

    found = (process / "environ").read_bytes()
    if not found:
        with suppress(AssertionError):
            wait(are_in_place)
        found = (process / "environ").read_bytes()
    return found


def end_processes(name: str = "") -> None:
    """Kill what a test left behind, so that it disturbs no other one."""
    for pid in processes_of(name):
        with suppress(OSError):
            os.kill(pid, signal.SIGKILL)
        with suppress(OSError):
            os.waitpid(pid, 0)
    with suppress(AssertionError):  # what hangs in the system is reported at the end of the run
        wait(lambda: not processes_of(name))  # those of other parents end when they come to run


def _descriptors() -> Counter[str]:
    found: Counter[str] = Counter()
    try:
        entries = list(os.scandir(_DESCRIPTORS))
    except OSError:
        return found
    for entry in entries:
        with suppress(OSError):
            place = os.readlink(entry)  # noqa: PTH115 - done for each of thousands of tests
            if not _OF_LIBRARIES.match(place) and not place.endswith("/fd"):
                found[place] += 1
    return found


def _folders() -> set[str]:
    return {entry.path for entry in os.scandir(tempfile.gettempdir())}


def _settings() -> dict[str, object]:
    """Return what one test can change under another's feet."""
    found: dict[str, object] = {f"${name}": value for name, value in os.environ.items()}
    # OpenCV changes the second one when it is imported.
    for name in ("$PYTEST_CURRENT_TEST", "$LD_LIBRARY_PATH", f"${MARK}"):
        found.pop(name, None)
    found["the working directory"] = Path.cwd()
    found["the locale"] = locale.setlocale(locale.LC_ALL)
    found["sys.excepthook"] = sys.excepthook
    found["threading.excepthook"] = threading.excepthook
    found["the switch interval"] = sys.getswitchinterval()
    found["the recursion limit"] = sys.getrecursionlimit()
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD):
            found[f"the handler of {number.name}"] = signal.getsignal(number)
    return found
