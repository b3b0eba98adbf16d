"""The lock in force: what bridges describe is held against it where plans are made."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from attrs import evolve

from uoarm._lock._record import Lock, LockError, read_lock
from uoarm._resolve import Structures, Unavailable
from uoarm.errors import ResolutionError
from uoarm.model import Component, LockDifference, LockMode, MessageStructure, Robot

__all__ = ["LockGuard", "guard_of"]

_log = logging.getLogger("uoarm")


class LockGuard:
    """Holds structures against a lock, and remembers what is different. Thread safe.

    Args:
        lock: what was written down.
        mode: whether a component with other structures may be used.
        report: called once for each new difference, with the place and a sentence.
    """

    def __init__(self, lock: Lock, mode: LockMode, report: Callable[[str, str], None]) -> None:
        self.lock = lock
        self.mode = mode
        self._report = report
        self._ports = {
            (part.component, port): fingerprint
            for part in lock.parts()
            for port, fingerprint in part.ports.items()
        }
        self._found: dict[tuple[str, str], LockDifference] = {}
        self._counting = threading.Lock()

    def hold(self, component: Component, structures: Structures) -> Structures | Unavailable:
        """Return structures that may be used, with a warning where they are others; or why not."""
        reports = self.differences(component.name, structures.by_port)
        if not reports:
            return structures
        if self.mode is LockMode.ENFORCE:
            return Unavailable("; ".join(reports))
        return evolve(structures, warnings=(*structures.warnings, *reports))

    def hold_offer(self, name: str, ports: Mapping[str, MessageStructure]) -> None:
        """Hold what an offer has in its framework against the lock.

        Raises:
            ResolutionError: it is not as it was locked, and may not be used.
        """
        reports = self.differences(name, ports)
        if reports and self.mode is LockMode.ENFORCE:
            raise ResolutionError("; ".join(reports))

    def differences(self, component: str, ports: Mapping[str, MessageStructure]) -> tuple[str, ...]:
        """Say for each port of a component that is not as it was locked what is different.

        What is told is counted, too.
        """
        return tuple(
            self._differs(component, port, self._ports.get((component, port)))
            for port, value in ports.items()
            if self._ports.get((component, port)) != value.fingerprint
        )

    def status(self) -> tuple[LockDifference, ...]:
        """Return what was found to be different, by component and port."""
        with self._counting:
            return tuple(difference for _, difference in sorted(self._found.items()))

    def _differs(self, component: str, port: str, locked: str | None) -> str:
        place = f"{component}.{port}"
        if locked is None:
            sentence = f"{place} is not in the lock: `uoarm lock` adds it"
        else:
            sentence = (
                f"{place} has another structure than in the lock: `uoarm lock --check` says what "
                "that breaks, `uoarm lock` accepts it"
            )
        is_refused = self.mode is LockMode.ENFORCE
        with self._counting:
            before = self._found.get((component, port))
            times = 1 if before is None else before.times + 1
            self._found[component, port] = LockDifference(
                component, port, is_refused, times, sentence
            )
        if before is None:
            _log.warning("%s%s", sentence, "; it is not used" if is_refused else "")
            self._report(place, sentence)
        return sentence


def guard_of(
    robot: Robot, report: Callable[[str, str], None], before: LockGuard | None = None
) -> LockGuard | None:
    """Return the guard that a configuration asks for, None where it asks for none. Reads the lock.

    Args:
        robot: the configuration.
        report: as the guard has it.
        before: the guard in force, which stays where the lock is the same.

    Raises:
        LockError: there is no lock beside the configuration, or it cannot be read.
    """
    if robot.lock is None:
        return None
    says = f"the configuration says `lock: {robot.lock.value}`"
    if not robot.origin:
        raise LockError(f"{says}, and was not read from a file: there is no robot.lock beside it")
    path = Path(robot.origin).with_name("robot.lock")
    if not path.exists():
        raise LockError(f"{says}, and there is no {path}: write it with `uoarm lock`")
    lock = read_lock(path)
    if before is not None and (before.lock, before.mode) == (lock, robot.lock):
        return before
    return LockGuard(lock, robot.lock, report)
