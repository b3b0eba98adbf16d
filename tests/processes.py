"""Programs run to their end, and what the kernel reports of a process that runs. Linux."""

from __future__ import annotations

import gc
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO, Any

from typing_extensions import Self

from uoarm.testing import patience, wait

_LAST_OCTETS = 4000
SIGNALS_AS_IT_OPENS = """
import os
import signal
from collections.abc import Iterator


class Early:
    def __init__(self) -> None:
        os.kill(os.getpid(), signal.SIGUSR1)

    def __iter__(self) -> Iterator[int]:
        yield 1
"""
"""A module with a component whose program gets SIGUSR1 as it opens."""


def run_program(
    *command: str | Path,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    check: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, with `env` beside the variables that are set.

    Raises:
        AssertionError: it has not ended in time; says what it wrote last.
    """
    try:
        return subprocess.run(
            command,
            cwd=cwd,
            env={**os.environ, **(env or {})},
            capture_output=True,
            text=True,
            timeout=4 * patience(),
            check=check,
        )
    except subprocess.TimeoutExpired as error:
        written = b"".join(octets for octets in (error.output, error.stderr) if octets)
        last = written[-_LAST_OCTETS:].decode(errors="replace")
        raise AssertionError(f"{command} has not ended; it wrote last:\n{last}") from None


def run_python(
    *words: str | Path,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    check: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Run this interpreter, as `run_program` does."""
    return run_program(sys.executable, *words, cwd=cwd, env=env, check=check)


class ForkedProgram:
    """Python code that forks once it has run, as a context; its child lives until the end of that.

    Args:
        code: run before; may read what is written, and print lines.
        words: its arguments.
    """

    def __init__(self, code: str, *words: str) -> None:
        command = (sys.executable, "-c", code + _FORK, *words)
        pipe = subprocess.PIPE
        self._parent = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)

    def read(self) -> str:
        """Return the next line that it prints; the last is `forked`."""
        assert self._parent.stdout is not None
        return self._parent.stdout.readline().rstrip("\n")

    def write(self, line: str) -> None:
        assert self._parent.stdin is not None
        self._parent.stdin.write(f"{line}\n")
        self._parent.stdin.flush()

    def kill_parent(self) -> None:
        """Kill the parent, and return when it is gone."""
        self._parent.kill()
        self._parent.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._parent.kill()
        self._parent.communicate()  # closes what the child reads


class AnsweringProgram:
    """A program that reads requests, a line of JSON each, and answers each with another line.

    An answer is `{"is": ...}`, or `{"raised": ...}`; the first comes when it is ready.

    Args:
        command: of the program.
        environment: its variables; left out: as here.
        errors: takes what it writes as errors; left out: as here.
    """

    def __init__(
        self,
        *command: str,
        environment: Mapping[str, str] | None = None,
        errors: IO[bytes] | None = None,
    ) -> None:
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=errors, encoding="utf-8", env=environment
        )
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._listening = threading.Thread(target=self._listen, daemon=True)
        self._listening.start()
        try:
            self.receive()
        except BaseException:
            self.kill()
            raise

    def send(self, request: object) -> None:
        """Send a request, without waiting for its answer."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()

    def receive(self) -> Any:
        """Wait for the answer to what was sent."""
        answer = self._answers.get(timeout=8 * patience())  # the program has the limits itself
        if answer is None:
            self._answers.put(None)  # for the next that asks
            raise AssertionError(f"it has ended with {self._process.wait(patience())}")
        assert "raised" not in answer, answer
        return answer["is"]

    def start(self, what: str, **arguments: object) -> None:
        """Send a request by name, without waiting for its answer."""
        self.send({"do": what, **arguments})

    def do(self, what: str, **arguments: object) -> Any:
        """Send a request by name, and wait for its answer."""
        self.start(what, **arguments)
        return self.receive()

    def freeze(self) -> None:
        """Stop it; returns when all its threads stand."""
        self._process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, self._process.pid, os.WSTOPPED)

    def thaw(self) -> None:
        self._process.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        """End it without any farewell."""
        self._process.kill()
        self._put_away()

    def end(self) -> None:
        """End it in good order, and by force where that does not work."""
        self.thaw()
        self._end_requests()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience())
        self.kill()

    def _end_requests(self) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()

    def _put_away(self) -> None:
        self._process.wait(patience())
        self._end_requests()
        self._listening.join(patience())

    def _listen(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                if line.startswith("{"):
                    self._answers.put(json.loads(line))
                else:  # such as the log of Fast DDS, of a port that another process has
                    sys.stderr.write(line)
        self._answers.put(None)


_FORK = """
import os, signal
if os.fork():
    signal.pause()
print("forked", flush=True)
os.read(0, 1)  # until the test ends it
os._exit(0)
"""


def frame_of(thread: int) -> FrameType:
    """Return where a thread of this process is, by its identity.

    Before 3.12 all of CPython may hang where its look at the frames begins a collection of garbage
    (its issue 106883).
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        return sys._current_frames()[thread]
    finally:
        if collects:
            gc.enable()


@contextmanager
def signal_beside(handle: Callable[[], object], *waiting: Callable[..., object]) -> Iterator[None]:
    """Have a signal handled while the main thread waits in a function, once in this block.

    It comes in another thread, as the kernel may give it: so it ends no wait by itself.

    Args:
        handle: the signal's handler.
        waiting: the function; others follow which it is to have been called within.
    """
    main = threading.get_ident()
    first, *others = (function.__code__ for function in waiting)

    def is_waiting() -> bool:
        frame = frame_of(main)
        outer = {item.f_code for item, _ in traceback.walk_stack(frame)}
        return frame.f_code is first and outer.issuperset(others)

    def send() -> None:
        wait(is_waiting)
        signal.pthread_kill(threading.get_ident(), signal.SIGUSR1)

    before = signal.signal(signal.SIGUSR1, lambda *_: handle())
    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        thread.join()
        signal.signal(signal.SIGUSR1, before)


def hold_ends_all(*command: str) -> None:
    """Hold that SIGTERM ends a program with all that it started, in order, once it has printed.

    Raises:
        AssertionError: it writes a traceback, ends otherwise than with 130, or leaves a process.
    """
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, start_new_session=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        started = [child for child in processes_of(process.pid) if child != process.pid]
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=patience())
    assert started, f"{command} has started nothing that could be left"
    assert "Traceback" not in said, said
    assert process.returncode == 130, said
    assert not [child for child in started if lives(child)]


def hold_ends_unread(*command: str) -> None:
    """Hold that a program ends with 1, in silence, once what it prints is read no more.

    Raises:
        AssertionError: it does not, or writes something to standard error.
    """
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        process.stdout.close()
        process.stdout = None
        _, said = process.communicate(timeout=patience())
    assert (process.returncode, said) == (1, "")


def hold_dies_whole(*command: str, after: str, env: Mapping[str, str] | None = None) -> None:
    """Hold that all that a program started ends when it is killed, once it has printed some words.

    Raises:
        AssertionError: it has started nothing, or what it started lives on.
    """
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdout=pipe, text=True, start_new_session=True, env={**os.environ, **(env or {})}
    ) as process:
        assert process.stdout is not None
        assert any(after in line for line in process.stdout)
        started = [child for child in processes_of(process.pid) if child != process.pid]
        process.kill()
        try:
            wait(lambda: not any(map(lives, started)), f"what {command} started lives on")
        finally:
            with suppress(ProcessLookupError):  # as it should be
                os.killpg(process.pid, signal.SIGKILL)
    assert started, f"{command} has started nothing that could be left"


def processes_of(session: int) -> Iterator[int]:
    """Find the processes of a session, its first one among them."""
    for home in Path("/proc").iterdir():
        if home.name.isdecimal():
            try:
                fields = (home / "stat").read_text(encoding="utf-8").rpartition(") ")[2].split()
            except (FileNotFoundError, ProcessLookupError):
                continue
            if fields[3] == str(session):
                yield int(home.name)


def lives(process: int) -> bool:
    """Say whether a process is there and has not ended."""
    return _status(Path(f"/proc/{process}"), "State")[:1] not in ("", "Z")


def states(process: int) -> list[str]:
    """Return the state of each thread of a process, a letter each, the main thread's first."""
    return [state[0] for home in _threads(process) if (state := _status(home, "State"))]


def thread_names(process: int) -> list[str]:
    """Return the names of the threads of a process, the main thread's first."""
    return [name for home in _threads(process) if (name := _status(home, "Name"))]


def _threads(process: int) -> Iterator[Path]:
    try:
        homes = list(Path(f"/proc/{process}/task").iterdir())
    except FileNotFoundError:
        return
    yield from sorted(homes, key=lambda home: home.name != str(process))


def _status(home: Path, field: str) -> str:
    """Return a field of a thread, nothing where it has ended, as it may between two reads."""
    try:
        lines = (home / "status").read_text(encoding="utf-8").splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return ""
    return next(line.partition(":")[2].strip() for line in lines if line.startswith(f"{field}:"))
