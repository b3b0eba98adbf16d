"""The audit log: who was admitted, and what each was allowed and denied."""

from __future__ import annotations

import logging

import orjson

from uoarm.model import StopReport
from uoarm.server.access._role import Operation, Role

__all__ = ["Audit"]

_log = logging.getLogger("uoarm.audit")


class Audit:
    """Writes one JSON line for each decision to the logger `uoarm.audit`.

    Denials are warnings. What was allowed is information, except that each message sent would
    drown the rest: those are for debugging.
    """

    def note(
        self, session: str, role: Role, operation: Operation, function: str, *, allowed: bool
    ) -> None:
        """Record one decision about an operation on a function."""
        level = logging.DEBUG if operation is Operation.SEND else logging.INFO
        if not allowed:
            level = logging.WARNING
        if _log.isEnabledFor(level):
            self._write(
                level,
                session=session,
                role=role.name,
                operation=operation.value,
                function=function[:200],
                allowed=allowed,
            )

    def stopped(self, asker: str, role: str, report: StopReport) -> None:
        """Record what an emergency stop came to, and which inputs have not stopped.

        Args:
            asker: the session, or the name of the signal.
            role: of the session.
            report: what it came to.
        """
        left = [
            f"{input_.component}.{input_.port}" for input_ in report.inputs if not input_.stopped
        ]
        level = logging.WARNING if left else logging.INFO
        self._write(level, session=asker, role=role, operation="stop", done=not left, left=left)

    def released(self, asker: str, role: str, cause: str = "") -> None:
        """Record that commands are let through again, or, with a cause, why they are not."""
        level = logging.WARNING if cause else logging.INFO
        self._write(
            level, session=asker, role=role, operation="release", done=not cause, cause=cause
        )

    def leased(self, told: str) -> None:
        """Record who commands an input now, or gave it back."""
        self._write(logging.INFO, operation="lease", lease=told)

    def arrival(self, address: str, session: str, role: str, cause: str = "") -> None:
        """Record a client that was admitted, or, with a cause, that was not."""
        level = logging.WARNING if cause else logging.INFO
        self._write(level, address=address, session=session, role=role, refused=cause)

    def dropped(self, session: str) -> None:
        """Record that a client's connection broke while its session is kept."""
        self._write(logging.INFO, session=session, dropped=True)

    def resumed(self, address: str, session: str) -> None:
        """Record that a client goes on with its session."""
        self._write(logging.INFO, address=address, session=session, resumed=True)

    def departure(self, session: str) -> None:
        """Record that a client has gone."""
        self._write(logging.INFO, session=session, gone=True)

    def _write(self, level: int, **facts: object) -> None:
        _log.log(level, "%s", orjson.dumps(facts).decode())
