"""One host process from start to end: its process and output, settings, transport and heartbeat."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from io import BufferedWriter
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any

from attrs import field, frozen

from uoarm._forks import at_exit, close_in_children, forks
from uoarm._host.transport import keys
from uoarm._host.transport.frames import LinkSockets
from uoarm._host.transport.liveness import HostConnection, LivenessMonitor
from uoarm._host.transport.shared_counters import SharedCounters
from uoarm._host.transport.socket_transport import SocketTransport
from uoarm._host.transport.transport import Reply
from uoarm._log_lines import HOST_LINE, read_host_line
from uoarm._raised import Log, on_failure, reason_of
from uoarm._support.process_tuning import KEEPING
from uoarm.bridge import CONTRACT_VERSION
from uoarm.environments import find_interpreter, passed_on
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import BridgeSpec, Options

_TERMINATE_SECONDS = 0.7
_FATAL = "Fatal Python error"


class HostProcess:
    """A child process and the two threads that belong to it.

    One thread starts the process and waits for its end: the kernel ends the process when the
    thread that started it ends, so this thread lives exactly as long. The other one reads what
    the process prints and hands it to the logger `uoarm.host.NAME`.

    Args:
        variables: the environment variables of the process.
        exited: called with how the process ended, in the waiting thread.
        passed: descriptors that the process inherits under their numbers.

    Raises:
        BridgeError: the process could not be started.
    """

    def __init__(
        self,
        name: str,
        command: list[str],
        variables: Mapping[str, str],
        exited: Callable[[str], None],
        passed: Sequence[int] = (),
    ) -> None:
        self._name = name
        self._command = command
        self._variables = variables
        self._exited = exited
        self._passed = tuple(passed)
        self._log = Log(f"uoarm.host.{name}")
        self._last: deque[str] = deque(maxlen=5)
        self._gone = threading.Event()
        self._signalling = threading.Lock()
        started: SimpleQueue[subprocess.Popen[bytes] | Exception] = SimpleQueue()
        self._waiter = threading.Thread(
            target=self._run, args=(started,), name=f"uoarm-host-{name}", daemon=True
        )
        process: subprocess.Popen[bytes] | Exception
        try:
            self._waiter.start()
            process = started.get()
        except RuntimeError as error:  # the system gives no more threads
            process = error
        if isinstance(process, Exception):
            text = f"bridge host {name!r} could not be started: {process}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from process
        self._process = process

    @property
    def number(self) -> int:
        return self._process.pid

    @property
    def last_words(self) -> str:
        """The last lines that it printed."""
        return "\n".join(self._last)

    @property
    def log_level(self) -> int:
        """The level from which on it prints records: what its logger writes, and of note anyway."""
        return min(self._log.logger.getEffectiveLevel(), logging.INFO)

    def send_orders(self, orders: Mapping[str, object]) -> None:
        """Write one line of JSON to the process, which keeps its stdin to see us die."""
        stdin = self._process.stdin
        assert stdin is not None, "stdin is a pipe"
        try:
            stdin.write(json.dumps(orders).encode() + b"\n")
            stdin.flush()
        except OSError:
            self._log.debug("it ended at once")  # how, is reported by the waiting thread

    def wait(self, timeout: float) -> bool:
        """Wait for the process to end; False when it has not within `timeout` seconds."""
        return self._gone.wait(timeout)

    def close_stdin(self) -> None:
        """Have the process stop what moves, and end, as if this one had died."""
        assert self._process.stdin is not None, "stdin is a pipe"
        try:
            self._process.stdin.close()
        except OSError:
            self._log.debug("its stdin was broken")

    def kill(self) -> None:
        """End the process and its children without a word."""
        self._signal(signal.SIGKILL)

    def end(self, patience: float) -> None:
        """See the process end: by itself, after SIGTERM, after SIGKILL; at last free its pipes.

        Args:
            patience: seconds that it has for ending by itself; 0: it was not asked to.

        Raises:
            BridgeError: it did not end even then.
        """
        process = self._process
        if not self.wait(patience):
            if patience > 0:
                self._log.warning("it does not end by itself: SIGTERM")
            self._signal(signal.SIGTERM)
            if not self.wait(_TERMINATE_SECONDS):
                self._log.warning("it does not end after SIGTERM: SIGKILL")
                self.kill()
        gone = self.wait(_KILLED_SECONDS)
        self.close_stdin()
        self._waiter.join(_KILLED_SECONDS)
        if not gone:
            raise BridgeError(f"process {process.pid} of bridge host {self._name!r} does not end")

    def _signal(self, number: int) -> None:
        """Send a signal to the whole session of the process, which it leads."""
        with self._signalling:
            if not self._gone.is_set():
                self._send(self._process.pid, number)

    def _send(self, session: int, number: int) -> None:
        try:
            os.killpg(session, number)
        except (ProcessLookupError, PermissionError):
            self._log.debug("signal %d finds no process", number)

    def _run(self, started: SimpleQueue[subprocess.Popen[bytes] | Exception]) -> None:
        try:
            process = subprocess.Popen(  # noqa: S603 - the configured interpreter
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                env=dict(self._variables),
                start_new_session=True,
                pass_fds=self._passed,
            )
            assert isinstance(process.stdin, BufferedWriter), "stdin is a pipe"
            # A child that is forked would hold open what shows the host that we died.
            close_in_children(process.stdin.raw)
            reader = threading.Thread(
                target=self._read, args=(process,), name=f"uoarm-log-{self._name}", daemon=True
            )
            with on_failure(self._discard, process):
                reader.start()
        except Exception as error:  # noqa: BLE001 - such as a variable that no process can have
            started.put(error)
            return
        started.put(process)
        status: int | None = None
        if sys.platform == "linux":
            # The number of a process that was not waited for is not given to another one,
            # so children that it left behind can be ended safely.
            with suppress(ChildProcessError):  # the application waits for all, or ignores SIGCHLD
                status = _status(os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT))
            self._send(process.pid, signal.SIGKILL)
            with self._signalling:
                process.wait()
                self._gone.set()
        else:
            status = process.wait()
            self._gone.set()
        reader.join(_TERMINATE_SECONDS)
        self._exited(_how(status))
        reader.join()

    def _discard(self, process: subprocess.Popen[bytes]) -> None:
        """End a process of which none knows yet, and free its pipes."""
        self._send(process.pid, signal.SIGKILL)
        process.__exit__(None, None, None)

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None, "stdout is a pipe"
        level_of_others = logging.INFO
        with process.stdout as lines:
            while line := lines.readline(HOST_LINE):
                level, text = read_host_line(line.decode(errors="replace").rstrip())
                if text.startswith(_FATAL):
                    level_of_others = logging.ERROR  # where it was, is what follows
                if text:
                    self._last.append(text)
                    self._log.log(level_of_others if level is None else level, "%s", text)


def _status(ended: os.waitid_result | None) -> int | None:
    if ended is None:
        return None
    return ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status


def _how(status: int | None) -> str:
    if status is None:
        return "its process ended; the application waits for all children, or ignores SIGCHLD"
    if status >= 0:
        return f"its process ended with status {status}"
    try:
        name = signal.Signals(-status).name
    except ValueError:
        name = f"signal {-status}"
    return f"its process was killed by {name}"


def host_command(python: Path, bridge: str, origin: str = "") -> list[str]:
    """Return the command that runs a host with this interpreter.

    The host gets all orders on its stdin; the bridge and the configuration file stand in the
    command for people who list processes.
    """
    robot = ["--robot", origin] if origin else []
    return [str(python), "-u", "-m", "uoarm._host", "--bridge", bridge, *robot]


_UNITS = {"MiB": 2**20, "GiB": 2**30}


@frozen
class HostSettings:
    """Settings of one bridge host.

    Attributes:
        machine: name of another machine, where the host was started and joins by itself; of the
            others, only `silence` and `start` go with it.
        environment: name of an environment made with `uoarm env create`.
        python: path of an interpreter; where neither is given, the application's own.
        variables: environment variables to set, or with None to take away.
        silence: seconds without an answer after which the host counts as dead.
        start: seconds within which it must be ready.
        restarts: deaths in a row after which the manager gives it up.
        memory: how much memory it may have, `512 MiB` or `2 GiB`; None: all there is. Linux.
    """

    machine: str | None = None
    environment: str | None = None
    python: str | None = None
    variables: Mapping[str, str | None] = field(factory=dict, hash=False)
    silence: float = 3.0
    start: float = 30.0
    restarts: int = 5
    memory: str | None = None

    @classmethod
    def read(cls, options: Options) -> HostSettings:
        """Return the settings of a `host:` mapping, whose keys the configuration has checked."""
        given: dict[str, Any] = dict(options)
        return cls(**given)

    @property
    def memory_bytes(self) -> int | None:
        """How much memory it may have; None: all there is."""
        if self.memory is None:
            return None
        return int(self.memory[:-3]) * _UNITS[self.memory[-3:]]

    def interpreter(self) -> Path:
        """Return the interpreter that runs the host.

        Raises:
            BridgeError: it is not there; the text says how to make it.
        """
        found, hint = find_interpreter(self.environment, self.python)
        if hint:
            text = f"there is no Python interpreter at {found}; {hint}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return found

    def process_variables(self, inherited: Mapping[str, str]) -> dict[str, str]:
        """Return the variables of the host's process, without what belongs to another Python."""
        left = passed_on(inherited, is_environment=self.environment is not None)
        for name, value in self.variables.items():
            left.pop(name, None)
            if value is not None:
                left[name] = value
        return left


_log = Log("uoarm")
_POLITE_SECONDS = 1.5
_STOP_SECONDS = 1.5  # more than a host takes for that
_KILLED_SECONDS = 5.0


class ProcessConnection(HostConnection):
    """Starts a host and returns when it is ready: its token seen and its greeting received.

    Args:
        spec: the bridge that runs in it.
        on_answer: called with what every answer to a heartbeat holds.
        on_doubt: called when it does not answer, or does again, and the cause.
        on_death: called once with why it died; `dead` is set already.
        on_health: takes what the bridge reports, from before it is ready on.
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
        on_answer: Callable[[Any], None],
        on_doubt: Callable[[bool, str], None],
        on_death: Callable[[str], None],
        on_health: Callable[[Mapping[str, Any], Reply], None],
        origin: str = "",
    ) -> None:
        super().__init__(LivenessMonitor(spec.name, on_doubt, on_death))
        self._name = spec.name
        self._memory = settings.memory
        self._given_up = ""
        self._process = forks.generation
        self._forget_exit: Callable[[], None] = lambda: None
        self._started: HostProcess | None = None
        deadline = time.monotonic() + settings.start
        command = host_command(settings.interpreter(), spec.name, origin)
        variables = {**KEEPING, **settings.process_variables(os.environ)}
        counted, near, far = _shared_with_host(spec.name)
        self.counters = SharedCounters(counted.fileno(), gives=True)
        with counted, closing(far):  # the host has inherited them, or there is none
            with on_failure(self.counters.close):
                self.transport = SocketTransport(near, spec.name)
            self.transport.watch_alive(keys.ALIVE, self._liveness.seen)
            self.transport.answer(keys.HEALTH, on_health)
            passed = *far.descriptors, counted.fileno()
            with on_failure(self.close, None):
                self._started = HostProcess(spec.name, command, variables, self._exited, passed)
                self._started.send_orders(
                    {
                        "bridge": spec.to_host(),
                        "link": far.descriptors,
                        "counters": counted.fileno(),
                        "parent": os.getpid(),
                        "memory": settings.memory_bytes,
                        "log_level": self._started.log_level,
                    }
                )
        with on_failure(self.close, None):
            self._await_token(deadline)
            self.greeting = self._greet(deadline)
            self._begin_heartbeat(
                spec.name, silence=settings.silence, on_answer=on_answer, on_silence=self._give_up
            )
        self._forget_exit = at_exit(self._end_with_python)

    @property
    def process(self) -> int:
        """The id of the host's process."""
        assert self._started is not None, "the constructor raises when there is none"
        return self._started.number

    def close(self, say_close: Callable[[], object] | None) -> None:
        """End the host: with `say_close` when it is given and the host lives, else at once.

        Raises:
            UoarmError: the bridge in the host failed while closing; the host has ended anyway.
            BridgeError: its process does not end.
        """
        if forks.generation != self._process:
            return  # in a child that was forked: the host is its parent's
        self._forget_exit()
        super().close(say_close)

    def _end_host(self, *, ends_alone: bool) -> None:
        if self._started is not None:
            self._started.end(_POLITE_SECONDS if ends_alone else 0.0)

    def _end_with_python(self) -> None:
        """End a host that was not closed before the interpreter ends."""
        try:
            self.close(None)
        except UoarmError as error:
            _log.warning("%s", error)

    def _await_token(self, deadline: float) -> None:
        """Wait for the token; where the process ended instead, say what it printed last."""
        try:
            self._liveness.await_token(deadline)
        except BridgeError as error:
            if not self.dead or self._started is None:
                raise
            text = f"{error}\n{self._started.last_words}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error

    def _greet(self, deadline: float) -> Mapping[str, Any]:
        greeting = self._liveness.greet(self.transport, deadline)
        ours = {"protocol": keys.PROTOCOL_VERSION, "contract": CONTRACT_VERSION}
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
        if self._memory:
            how = f"{how}; it might have {self._memory} of memory"
        self._liveness.die(self._given_up or how)

    def _give_up(self, silent: float) -> None:
        """End it before its death is reported: what it took later would be counted as lost, too.

        What it moves would go on after a kill. Where it comes to run once more, it stops that.
        """
        assert self._started is not None, "it has a heartbeat"
        self._given_up = f"it has not answered for {silent:.1f} s"
        if self.moves:
            self._started.close_stdin()
            self._started.wait(_STOP_SECONDS)
        self._started.kill()
        self._started.wait(_KILLED_SECONDS)
        self._liveness.die(self._given_up)


def _shared_with_host(name: str) -> tuple[IO[bytes], LinkSockets, LinkSockets]:
    """Make the file of the counters, and both ends of a link.

    Raises:
        BridgeError: UNAVAILABLE, such as where the disk is full.
    """
    try:
        counted = SharedCounters.make_file()
        try:
            return counted, *LinkSockets.make()
        except OSError:
            counted.close()
            raise
    except OSError as error:
        text = f"bridge host {name!r} has no place for its link: {reason_of(error)}"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
