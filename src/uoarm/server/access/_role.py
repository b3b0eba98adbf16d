"""Roles: which operations on which functions a client may use."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from fnmatch import fnmatchcase

from attrs import field, frozen

from uoarm.errors import UoarmError

__all__ = ["EVERYTHING", "OF_NO_FUNCTION", "DeniedError", "Operation", "Role"]


class DeniedError(UoarmError):
    """The client's role does not allow what it asked."""


class Operation(Enum):
    """What a role allows or does not.

    SEE names functions and their status, REQUEST opens and receives, SEND publishes to an input,
    CALL calls a service, KILL ends what other clients hold. One's own connections may always be
    killed. The others are of no function, and a role has them for everything or not at all:
    CONFIGURE changes the configuration, which can name any code, and no client has it without an
    access file; KEEP is the same for writing it to the robot's file, beside CONFIGURE; STOP stops
    whatever moves and RELEASE lets commands through again.
    """

    SEE = "see"
    REQUEST = "request"
    SEND = "send"
    CALL = "call"
    KILL = "kill"
    CONFIGURE = "configure"
    KEEP = "keep"
    STOP = "stop"
    RELEASE = "release"


OF_NO_FUNCTION = frozenset({Operation.CONFIGURE, Operation.KEEP, Operation.STOP, Operation.RELEASE})
"""Operations that are of no function: no pattern gives them."""


@frozen
class Role:
    """A named set of rights; whatever is not named is denied.

    Attributes:
        name: as the audit log and the client's hello show it.
        rules: patterns of function names by operation, `*` and `?` as in file names.
        everything: operations that it may use on everything, also on what is of no function. No
            pattern stands for that, `*` neither.
    """

    name: str
    rules: Mapping[Operation, tuple[str, ...]] = field(factory=dict, hash=False)
    everything: frozenset[Operation] = frozenset()

    def allows(self, operation: Operation, function: str) -> bool:
        """Say whether an operation on a function is allowed."""
        return self.allows_all(operation) or (
            bool(function)
            and any(fnmatchcase(function, pattern) for pattern in self.rules.get(operation, ()))
        )

    def allows_all(self, operation: Operation) -> bool:
        """Say whether an operation is allowed on everything, whatever it is of."""
        return operation in self.everything

    def require(self, operation: Operation, function: str) -> None:
        """Raise DeniedError when an operation on a function is not allowed."""
        if not self.allows(operation, function):
            raise self._denied(operation, f" {function[:100]!r}")

    def require_all(self, operation: Operation) -> None:
        """Raise DeniedError when an operation is not allowed on everything."""
        if not self.allows_all(operation):
            raise self._denied(operation, "" if operation in OF_NO_FUNCTION else " everything")

    def _denied(self, operation: Operation, what: str) -> DeniedError:
        hint = (
            f": without an access file nobody may. Give a role `{operation.value}: all` "
            "in one, let `uoarm token NAME --role ROLE` make a token and its line there, and "
            "serve with `uoarm serve --access FILE`"
        )
        return DeniedError(
            f"role {self.name!r} may not {operation.value}{what}"
            f"{hint if self is EVERYTHING else ''}"
        )


EVERYTHING = Role("local", everything=frozenset(Operation) - {Operation.CONFIGURE, Operation.KEEP})
