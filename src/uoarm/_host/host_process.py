"""The process of a host: started, its output read, and ended for certain."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from io import BufferedWriter
from pathlib import Path
from queue import SimpleQueue

from uoarm._forks import close_in_children
from uoarm._log_lines import HOST_LINE, read_host_line
from uoarm.errors import BridgeError, FailureReason

__all__ = ["HostProcess", "host_command"]

_POLITE_SECONDS = 0.7
_KILLED_SECONDS = 5.0
_FATAL = "Fatal Python error"


class HostProcess:
    """A child process and the two threads that belong to it.

    One thread starts the process and waits for its end: the kernel ends the process when the
    thread that started it ends, so this thread lives exactly as long. The other one reads what
    the process prints and hands it to the logger `uoarm.host.NAME`.

    Args:
        name: name of the bridge.
        command: program and arguments.
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
        self._log = logging.getLogger(f"uoarm.host.{name}")
        self._last: deque[str] = deque(maxlen=5)
        self._gone = threading.Event()
        self._signalling = threading.Lock()
        started: SimpleQueue[subprocess.Popen[bytes] | OSError] = SimpleQueue()
        self._waiter = threading.Thread(
            target=self._run, args=(started,), name=f"uoarm-host-{name}", daemon=True
        )
        self._waiter.start()
        process = started.get()
        if isinstance(process, OSError):
            text = f"bridge host {name!r} could not be started: {process}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from process
        self._process = process

    @property
    def number(self) -> int:
        """The process's id."""
        return self._process.pid

    @property
    def last_words(self) -> str:
        """The last lines that it printed."""
        return "\n".join(self._last)

    @property
    def log_level(self) -> int:
        """The level from which on it prints records: what its logger writes, and of note anyway."""
        return min(self._log.getEffectiveLevel(), logging.INFO)

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
            if not self.wait(_POLITE_SECONDS):
                self._log.warning("it does not end after SIGTERM: SIGKILL")
                self.kill()
        gone = self.wait(_KILLED_SECONDS)
        assert process.stdin is not None, "stdin is a pipe"
        try:
            process.stdin.close()
        except OSError:
            self._log.debug("its stdin was broken")
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

    def _run(self, started: SimpleQueue[subprocess.Popen[bytes] | OSError]) -> None:
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
        except OSError as error:
            started.put(error)
            return
        started.put(process)
        reader = threading.Thread(
            target=self._read, args=(process,), name=f"uoarm-log-{self._name}", daemon=True
        )
        reader.start()
        if sys.platform == "linux":
            # The number of a process that was not waited for is not given to another one,
            # so children that it left behind can be ended safely.
            os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
            self._send(process.pid, signal.SIGKILL)
            with self._signalling:
                status = process.wait()
                self._gone.set()
        else:
            status = process.wait()
            self._gone.set()
        reader.join(_POLITE_SECONDS)
        self._exited(_how(status))
        reader.join()

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


def _how(status: int) -> str:
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
