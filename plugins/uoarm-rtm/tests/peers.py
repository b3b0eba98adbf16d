"""Peer processes, seen from the tests."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from uoarm.testing import patience

HERE = Path(__file__).parent
LONG = "IDL:RTC/TimedLong:1.0"


class Peer:
    """A component in a process of its own; `peer.received()` asks it and returns its answer."""

    def __init__(self, nameserver: str, name: str, type_id: str = LONG, idl: str = "") -> None:
        words = [str(HERE / "peer_process.py"), nameserver, name, type_id, idl]
        self.name = name
        self.process = subprocess.Popen(
            [sys.executable, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._answers: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        assert self._answer() == "ready"

    def __getattr__(self, command: str) -> Any:
        def ask(*arguments: Any) -> Any:
            assert self.process.stdin is not None
            self.process.stdin.write(json.dumps([command, *arguments]) + "\n")
            self.process.stdin.flush()
            return self._answer()

        return ask

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(patience())
        self._hush()

    def _hush(self) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()

    def freeze(self) -> None:
        """Stop it; returns when all its threads stand."""
        self.process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, self.process.pid, os.WSTOPPED)

    def thaw(self) -> None:
        self.process.send_signal(signal.SIGCONT)

    def end(self) -> None:
        """End it in good order, and by force where that does not work."""
        if self.process.poll() is None:
            self.thaw()
            self._hush()
            try:
                self.process.wait(patience())
            except subprocess.TimeoutExpired:
                self.kill()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                self._answers.put(line)

    def _answer(self) -> Any:
        return json.loads(self._answers.get(timeout=patience()))
