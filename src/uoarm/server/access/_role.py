"""Roles: which operations on which functions a client may use."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from fnmatch import fnmatchcase

from attrs import field, frozen

from uoarm.errors import UoarmError

__all__ = ["EVERYTHING", "DeniedError", "Operation", "Role"]


class DeniedError(UoarmError):
    """The client's role does not allow what it asked."""


class Operation(Enum):
    """What a role allows or does not.

    SEE names functions and their status, REQUEST opens and receives, SEND publishes to an input,
    CALL calls a service, KILL ends what other clients hold. One's own connections may always be
    killed. CONFIGURE changes the configuration, which can name any code: it is of no function, so
    that only the pattern `*` gives it, and nobody has it without an access file. KEEP is the same
    for writing it to the robot's file, beside CONFIGURE. STOP stops
    whatever moves and RELEASE lets commands through again; both are of no function, too.
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


_OF_NO_FUNCTION = frozenset(
    {Operation.CONFIGURE, Operation.KEEP, Operation.STOP, Operation.RELEASE}
)


@frozen
class Role:
    """A named set of rights; whatever is not named is denied.

    Attributes:
        name: as the audit log and the client's hello show it.
        rules: patterns of function names by operation, `*` and `?` as in file names.
    """

    name: str
    rules: Mapping[Operation, tuple[str, ...]] = field(hash=False)

    def allows(self, operation: Operation, function: str) -> bool:
        """Say whether an operation on a function is allowed."""
        return any(fnmatchcase(function, one) for one in self.rules.get(operation, ()))

    def require(self, operation: Operation, function: str) -> None:
        """Raise DeniedError when an operation on a function is not allowed."""
        if not self.allows(operation, function):
            what = "" if operation in _OF_NO_FUNCTION else f" {function[:100]!r}"
            hint = ": that takes a role of an access file (serve --access)"
            raise DeniedError(
                f"role {self.name!r} may not {operation.value}{what}"
                f"{hint if self is EVERYTHING else ''}"
            )


EVERYTHING = Role(
    "local", dict.fromkeys(set(Operation) - {Operation.CONFIGURE, Operation.KEEP}, ("*",))
)
