"""Peer processes, seen from the tests."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from tests.processes import AnsweringProgram  # type: ignore[import-not-found]

HERE = Path(__file__).parent
LONG = "IDL:RTC/TimedLong:1.0"


class Peer(AnsweringProgram):  # type: ignore[misc]  # the harness is not on its path
    """A component in a process of its own; `peer.received()` asks it and returns its answer."""

    def __init__(self, nameserver: str, name: str, type_id: str = LONG, idl: str = "") -> None:
        self.name = name
        program = str(HERE / "peer_process.py")
        super().__init__(sys.executable, program, nameserver, name, type_id, idl)

    def __getattr__(self, command: str) -> Any:
        def ask(*arguments: Any) -> Any:
            self.send([command, *arguments])
            return self.receive()

        return ask
