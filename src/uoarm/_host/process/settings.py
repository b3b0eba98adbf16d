"""What the configuration says of a host: which Python, which variables, which limits."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from attrs import field, frozen

from uoarm.environments import environment_python, passed_on
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Options

__all__ = ["HostSettings"]

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
        if self.environment is not None:
            found = environment_python(self.environment)
            hint = f"make it: uoarm env create {self.environment} --plugin ..."
        elif self.python is not None:
            found, hint = Path(self.python).expanduser(), "check the path under `python`"
        else:
            return Path(sys.executable)
        if not os.access(found, os.X_OK):
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
