"""Which components are there, compared with the last check."""

from __future__ import annotations

from collections.abc import Callable

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health
from uoarm_rtm._directory import Directory

__all__ = ["DirectoryMonitor"]


class DirectoryMonitor:
    """Which components are there, compared with the last check.

    Args:
        directory: names and what stands behind them.
        report: that of the bridge.
        own: path to leave out: the bridge's own component.
    """

    def __init__(self, directory: Directory, report: Callable[..., None], own: str) -> None:
        self._directory = directory
        self._report = report
        self._own = own
        self._conditions: dict[str, str] | None = None
        self._is_unreachable = False

    def tick(self) -> None:
        """Report what came, left, died, hung or woke up; the first check reports nothing."""
        try:
            entries = self._directory.entries()
        except BridgeError as error:
            if error.reason is FailureReason.CLOSED:
                return
            # A naming service that is gone says nothing of the components.
            if not self._is_unreachable:
                self._is_unreachable = True
                self._report(Health.DEGRADED, str(error))
            return
        if self._is_unreachable:
            self._is_unreachable = False
            self._report(Health.OK, "a naming service answers again")
        now = {entry.path: entry.condition for entry in entries if entry.path != self._own}
        before, self._conditions = self._conditions, now
        if before is None:
            return
        for path in sorted(before.keys() | now.keys()):
            was, is_now = before.get(path), now.get(path)
            if was != is_now:
                self._report_change(path, was, is_now)

    def _report_change(self, path: str, was: str | None, is_now: str | None) -> None:
        if is_now == "alive":
            word = "answers again" if was == "hung" else "appeared"
            self._report(Health.OK, f"component {path} {word}", component=path)
        elif is_now == "hung":
            text = f"component {path} does not answer: it hangs"
            self._report(Health.LOST, text, component=path)
        elif was in {"alive", "hung"}:
            end = "left" if is_now is None else "died: only its name is left"
            self._report(Health.LOST, f"component {path} {end}", component=path)
