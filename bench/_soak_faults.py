"""The faults of the soak: what is done to a random host, and what a fault is called."""

from __future__ import annotations

import os
import random
import signal
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from uoarm import RobotManager
from uoarm._host import RemoteBridge

__all__ = ["FAULTS", "Faults"]

FAULTS = ("kill", "stop", "pause", "hang", "refuse", "slow")
DEADLY = frozenset({"kill", "stop", "hang"})
_MOMENT_SECONDS = 0.25


class Faults:
    """Does random harm to the hosts of a robot, and counts it.

    Args:
        robot: whose hosts are harmed.
        folder: where components look for the harm that they do to themselves.
        seed: of the choice.
    """

    def __init__(self, robot: RobotManager, folder: Path, seed: int) -> None:
        self._robot = robot
        self._folder = folder
        self._random = random.Random(seed)
        self.done: Counter[str] = Counter()
        self._does: dict[str, Callable[[], None]] = {
            "kill": lambda: os.kill(self._somebody(), signal.SIGKILL),
            "stop": lambda: os.kill(self._somebody(), signal.SIGSTOP),
            "pause": self._pause,
            "hang": (folder / "hang").touch,
            "refuse": lambda: self._for_a_moment("refuse"),
            "slow": lambda: self._for_a_moment("slow"),
        }

    @property
    def deaths(self) -> int:
        """How many hosts were meant to die."""
        return sum(count for fault, count in self.done.items() if fault in DEADLY)

    def harm(self, fault: str | None = None) -> None:
        """Do one fault, a random one where none is named; nothing when nobody is there."""
        fault = fault or self._random.choice(FAULTS)
        try:
            self._does[fault]()
        except (LookupError, ProcessLookupError):
            return
        self.done[fault] += 1

    def _somebody(self) -> int:
        """Return the process of a random host that runs."""
        bridges = self._robot._bridges._bridges.values()  # noqa: SLF001 - to have somebody to harm
        hosts = sorted(one.process for one in tuple(bridges) if isinstance(one, RemoteBridge))
        return self._random.choice(hosts)

    def _pause(self) -> None:
        process = self._somebody()
        os.kill(process, signal.SIGSTOP)
        threading.Event().wait(_MOMENT_SECONDS)
        os.kill(process, signal.SIGCONT)

    def _for_a_moment(self, harm: str) -> None:
        file = self._folder / harm
        file.touch()
        threading.Event().wait(_MOMENT_SECONDS)
        file.unlink()
