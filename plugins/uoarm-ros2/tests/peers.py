"""A peer process, spoken to in lines of JSON; what it does is in peer_process.py."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import IO

from tests.domains import reserved_domain  # type: ignore[import-not-found]
from tests.processes import AnsweringProgram  # type: ignore[import-not-found]

from uoarm.testing import patience, slowness

HERE = Path(__file__).parent
_HELD = ExitStack()
DOMAIN = _HELD.enter_context(reserved_domain())
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


class Peer(AnsweringProgram):  # type: ignore[misc]  # the harness is not on its path
    """A ROS 2 node in a process of its own; for one that is killed `environment` has `MORTAL`.

    Others forget a process that stands still for the lease that it announces, and meet it again;
    what is published meanwhile never arrives. So only who is killed announces a short one.
    """

    def __init__(self, name: str, environment: dict[str, str], *words: str) -> None:
        variables = {**os.environ, "PATIENCE": str(patience()), **environment}
        program = str(HERE / "peer_process.py")
        super().__init__(sys.executable, program, name, *words, environment=variables)
