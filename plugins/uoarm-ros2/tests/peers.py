"""A peer process, spoken to in lines of JSON; what it does is in peer_process.py."""

from __future__ import annotations

import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from uoarm.testing import patience, slowness

HERE = Path(__file__).parent


def _reserved_domain() -> int:
    """A domain that, with the next one, no other process of tests on this machine uses.

    It is held by a socket that lasts as long as this process. DDS ports end at domain 101 on Linux.
    """
    for step in range(0, 80, 2):
        domain = 20 + (os.getpid() * 2 + step) % 80
        held = socket.socket(socket.AF_UNIX)
        try:
            held.bind(f"\0uoarm-tests-domain-{domain}")
        except OSError:
            held.close()
        else:
            held.detach()
            return domain
    raise RuntimeError("all ROS domains are taken by other tests")


DOMAIN = _reserved_domain()
WAIT_SECONDS = 3.5 * slowness()
"""As long as a bridge waits by default for what is to be there, on an idle machine."""
OPTIONS = f"domain_id: {DOMAIN}, wait: {WAIT_SECONDS}"
"""Those of a bridge of ROS 2 in a configuration."""


MORTAL = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(HERE / "mortal.xml")}
"""Others notice within a second or two that a process was killed."""
MORTAL_CALM = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(HERE / "mortal_calm.xml")}
"""Within four seconds: for one that must not count as gone before, however busy the machine is."""


def own_line(output: IO[str]) -> str:
    """Return the next line that a program wrote itself, or nothing at the end.

    Fast DDS writes its log to the output, too, as of a port whose process was killed.
    """
    return next((line for line in output if "[RTPS_" not in line), "")


class Peer:
    """A ROS 2 node in a process of its own; for one that is killed `environment` has `MORTAL`.

    Others forget a process that stands still for the lease that it announces, and meet it again;
    what is published meanwhile never arrives. So only who is killed announces a short one.
    """

    def __init__(self, name: str, environment: dict[str, str], *words: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(HERE / "peer_process.py"), name, *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PATIENCE": str(patience()), **environment},
        )
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()
        try:
            assert self._answer()["ready"]
        except BaseException:
            self.kill()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    def start(self, op: str, **arguments: object) -> None:
        """Send the peer a command, without waiting for its answer."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"op": op, **arguments}) + "\n")
        self._process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        """Wait for the answer to something that was started."""
        return self._answer()

    def do(self, op: str, **arguments: object) -> dict[str, Any]:
        """Send the peer a command and wait for its answer."""
        self.start(op, **arguments)
        return self._answer()

    def kill(self) -> None:
        """End it without any farewell."""
        self._process.kill()
        self._process.wait()

    def freeze(self) -> None:
        """Stop it; returns when all its threads stand."""
        self._process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, self._process.pid, os.WSTOPPED)

    def thaw(self) -> None:
        self._process.send_signal(signal.SIGCONT)

    def end(self) -> None:
        """End it, with a farewell if it can: else the next test meets its ghost for its lease."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self.thaw()
        with suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(patience())
        except subprocess.TimeoutExpired:
            self.kill()
        self._process.stdout.close()

    def _answer(self) -> dict[str, Any]:
        answer = self._answers.get(timeout=8 * patience())  # the peer has the limits itself
        if answer is None:
            self._answers.put(None)  # for the next that asks
            raise AssertionError(f"the peer has ended with {self._process.wait(patience())}")
        assert "failed" not in answer, answer
        return answer

    def _listen(self) -> None:
        assert self._process.stdout is not None
        try:
            for line in self._process.stdout:
                if line.startswith("{"):
                    self._answers.put(json.loads(line))
                else:  # Fast DDS writes its log there, as of a port that another process has
                    sys.stderr.write(line)
        except ValueError:
            pass  # closed while reading, at the end of a test
        self._answers.put(None)
