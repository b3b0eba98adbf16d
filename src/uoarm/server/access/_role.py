"""Roles: which operations on which functions a client may use."""

from __future__ import annotations

import hashlib
import hmac
import json
import logging
import os
import re
import secrets
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from enum import Enum
from fnmatch import fnmatchcase
from io import TextIOWrapper
from logging.handlers import WatchedFileHandler
from pathlib import Path
from typing import Any

import orjson
from attrs import field, frozen

from uoarm._raised import Log
from uoarm._secrets import HIDDEN, is_secret_name
from uoarm.errors import ConfigurationError, UoarmError
from uoarm.model import Message, StopReport


class DeniedError(UoarmError):
    """The client's role does not allow what it asked."""

    error_code = "UOA-704"


class Operation(Enum):
    """What a role allows or does not.

    SEE names functions and their status, REQUEST opens and receives, SEND publishes to an input,
    CALL calls a service, KILL ends what other clients hold. One's own connections may always be
    killed. The others are of no function, and a role has them for everything or not at all:
    CONFIGURE changes the configuration, which can name any code, and no client has it without an
    access file; KEEP is the same for writing it to the robot's file, beside CONFIGURE; STOP stops
    whatever moves and RELEASE lets commands through again. APPROVE decides about what another
    principal asks for, by function as the first ones, and so RECORD, which writes what functions
    give into files, and moves recordings that are played in their place.
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
    APPROVE = "approve"
    RECORD = "record"


OF_NO_FUNCTION = frozenset({Operation.CONFIGURE, Operation.KEEP, Operation.STOP, Operation.RELEASE})
"""Operations that are of no function: no pattern gives them."""


_OF_IMPORTERS = frozenset({
    Operation.SEE, Operation.REQUEST, Operation.SEND, Operation.CALL, Operation.KILL,
})  # fmt: skip
"""Operations on exported functions that another manager may use, where its role has them."""


@frozen
class AccessRole:
    """A named set of rights; whatever is not named is denied.

    Attributes:
        name: as the audit log and the client's hello show it.
        rules: patterns of function names by operation, `*` and `?` as in file names.
        everything: operations that it may use on everything, also on what is of no function. No
            pattern stands for that, `*` neither.
        supervised: whether it does what needs an approval with an approval only, which it asks
            for by the Model Context Protocol: by any other protocol it may not do it.
        exported: patterns of the functions that a manager which imports may use; None: it is no
            such manager, and the rules say all.
    """

    name: str
    rules: Mapping[Operation, tuple[str, ...]] = field(factory=dict, hash=False)
    everything: frozenset[Operation] = frozenset()
    supervised: bool = False
    exported: tuple[str, ...] | None = None

    def exporting(self, names: tuple[str, ...]) -> AccessRole:
        """Return the role of a manager that imports: what is exported to it, and no more rights.

        Of what is of no function it keeps the emergency stop: its own must reach here.
        """
        operations = set(self.rules) | self.everything
        rules = {
            operation: ("*",) if operation in self.everything else self.rules[operation]
            for operation in operations & _OF_IMPORTERS
        }
        kept = self.everything & {Operation.STOP, Operation.RELEASE}
        return AccessRole(self.name, rules, kept, self.supervised, names)

    def allows(self, operation: Operation, function: str) -> bool:
        """Say whether an operation on a function is allowed."""
        if self.exported is not None and not any(
            fnmatchcase(function, pattern) for pattern in self.exported
        ):
            return operation in self.everything
        return self.allows_all(operation) or (
            bool(function)
            and any(fnmatchcase(function, pattern) for pattern in self.rules.get(operation, ()))
        )

    def allows_all(self, operation: Operation) -> bool:
        """Say whether an operation is allowed on everything, whatever it is of."""
        return operation in self.everything

    def rights(self) -> dict[str, Any]:
        """Return what it may do, as an access file says it."""
        rights: dict[str, Any] = {
            operation.value: list(patterns) for operation, patterns in self.rules.items()
        }
        return rights | {operation.value: "all" for operation in self.everything}

    def require(self, operation: Operation, function: str) -> None:
        """Raise DeniedError when an operation on a function is not allowed."""
        if not self.allows(operation, function):
            raise self._denied(operation, f" {function[:100]!r}")

    def require_all(self, operation: Operation) -> None:
        """Raise DeniedError when an operation is not allowed on everything."""
        if not self.allows_all(operation):
            raise self._denied(operation, "" if operation in OF_NO_FUNCTION else " everything")

    def _denied(self, operation: Operation, what: str) -> DeniedError:
        if self.exported is not None and operation in _OF_IMPORTERS:
            # The same words for what is not there, not exported and not allowed.
            return DeniedError(
                f"role {self.name!r} may not {operation.value}{what} from another manager: the "
                f"function must be in `export: {{{self.name}: [...]}}` of this robot's "
                "configuration, and in the role"
            )
        hint = (
            f": without an access file no client may. Give a role `{operation.value}: all` "
            "in one, let `uoarm token NAME --role ROLE` make a token and its line there, and "
            "serve with `uoarm serve --access FILE`"
        )
        return DeniedError(
            f"role {self.name!r} may not {operation.value}{what}"
            f"{hint if self is EVERYTHING else ''}"
        )


EVERYTHING = AccessRole(
    "local", everything=frozenset(Operation) - {Operation.CONFIGURE, Operation.KEEP}
)


_TOKEN_BYTES = 32


@frozen
class Grant:
    """One token or certificate and the role it has.

    Attributes:
        name: for the audit log.
        role: what it may do.
        expires: when it ends; None: never.
        principal: the person or program that it is of, who may have several.
    """

    name: str
    role: AccessRole
    expires: datetime | None = None
    principal: str = ""


@frozen
class AccessPolicy:
    """Which credentials have which role, as an access file says.

    Attributes:
        tokens: grants by the SHA-256 of the token, in lower-case hex.
        certificates: grants by the common name of a client's certificate.
    """

    tokens: Mapping[str, Grant] = field(hash=False)
    certificates: Mapping[str, Grant] = field(factory=dict, hash=False)

    def grant_of(self, digest: str, now: datetime) -> Grant | None:
        """Return the grant of a token's hash, None for an unknown or expired one.

        Takes the same time whichever token it is: every hash is compared, each in constant time.
        """
        found: Grant | None = None
        for known, grant in self.tokens.items():
            if hmac.compare_digest(known, digest):
                found = grant
        return _unless_expired(found, now)

    def certificate_grant(self, name: str, now: datetime) -> Grant | None:
        """Return the grant of a certificate's common name."""
        return _unless_expired(self.certificates.get(name), now)


def make_token() -> str:
    """Return a new token of 256 random bits: too many to guess, so a plain hash keeps it safe."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def hash_token(token: str) -> str:
    """Return a token as it is kept at rest."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def _unless_expired(grant: Grant | None, now: datetime) -> Grant | None:
    if grant is None or (grant.expires is not None and now >= grant.expires):
        return None
    return grant


LOCAL = Grant("local", EVERYTHING, principal="local")
"""Of everyone, where there is no access file."""

_log, _server_log = Log("uoarm.audit"), Log("uoarm.server")
_PIN = re.compile(r"(^|_)pin$", re.IGNORECASE)
_AUDIT_MODE = 0o600
_DEPTH = 16


def masked(value: Message, depth: int = _DEPTH) -> Message:
    """Return a message for a log: what is named like a secret is left out, and so are octets."""
    if isinstance(value, bytes | bytearray | memoryview):
        return f"{len(value)} octets"
    if depth == 0:
        return HIDDEN
    if isinstance(value, Mapping):
        return {
            str(name): HIDDEN
            if is_secret_name(str(name)) or _PIN.search(str(name))
            else masked(part, depth - 1)
            for name, part in value.items()
        }
    if isinstance(value, list | tuple):
        return [masked(part, depth - 1) for part in value]
    return value


class Audit:
    """Writes one JSON line for each decision to the logger `uoarm.audit`.

    Denials are warnings. What was allowed is information, except that each message sent would
    drown the rest: those are for debugging.
    """

    @property
    def is_kept(self) -> bool:
        """Whether the last line is in every file that the log is appended to."""
        return not any(
            handler.is_failing for handler in _log.logger.handlers if isinstance(handler, AuditFile)
        )

    def note(
        self, session: str, role: AccessRole, operation: Operation, function: str, *, allowed: bool
    ) -> None:
        """Record one decision about an operation on a function."""
        level = logging.DEBUG if operation is Operation.SEND else logging.INFO
        if not allowed:
            level = logging.WARNING
        if _log.logger.isEnabledFor(level):
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

    def leased(self, change: str) -> None:
        """Record who commands an input now, or gave it back."""
        self._write(logging.INFO, operation="lease", lease=change)

    def approval(self, facts: Mapping[str, object], arguments: Message) -> None:
        """Record a step of an approval: who, what, when and with which arguments."""
        self._write(logging.INFO, **facts, arguments=masked(arguments))

    def approval_denied(self, approval: str, requester: str, function: str, cause: str) -> None:
        """Record that something was not done for want of an approval."""
        self._write(
            logging.WARNING,
            approval=approval[:64],
            requester=requester,
            function=function[:200],
            refused=cause,
        )

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
        entry = {**facts, "time": time.time()}
        try:
            line = orjson.dumps(entry).decode()
        except TypeError:  # of a client: half a character, or a number beyond 64 bits
            line = json.dumps(entry, default=str)
        _log.log(level, "%s", line)


class AuditFile(WatchedFileHandler):
    """Appends the audit log to a file that only this user may read, until it is closed.

    It begins with a line that says so, which a full disk refuses before anything is served. What is
    there already stays. Where the file was moved away, as by the rotation of logs, the next
    line begins a new one. A line that cannot be written, as on a full disk, is in the server's log.

    Args:
        path: of the file.

    Attributes:
        is_failing: whether the last line could not be written.

    Raises:
        ConfigurationError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        try:
            super().__init__(path, encoding="utf-8")
            stream = self.stream
            assert stream is not None, "it was opened"
            try:
                stream.write(json.dumps({"began": True, "time": time.time()}) + "\n")
                stream.flush()
            except OSError:
                with suppress(OSError):  # it tries once more
                    stream.close()
                raise
        except OSError as error:
            raise ConfigurationError(
                f"the audit log cannot be written to {path}: {error.strerror or error}; make room, "
                "or choose another place"
            ) from error
        self.setFormatter(logging.Formatter("%(message)s"))
        self.is_failing = False
        self._has_failed = False
        self._former_level = _log.logger.level
        if _log.logger.getEffectiveLevel() > logging.INFO:
            _log.logger.setLevel(logging.INFO)
        _log.logger.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        self._has_failed = False
        try:
            super().emit(record)
        except OSError:  # a file that was moved away, and whose folder is gone
            self.handleError(record)
        self.is_failing = self._has_failed

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - of logging
        """Take in that a line was not written, in the `except` block of its cause."""
        self._has_failed = True
        cause, line = sys.exc_info()[1], record.getMessage()
        text = "the audit log %s cannot be written: %s; it lacks the line %s"
        _server_log.error(text, self.baseFilename, cause, line)
        stream, self.stream = self.stream, None  # it is opened anew for the next line
        with suppress(OSError):
            if stream is not None:
                stream.close()

    def close(self) -> None:
        """Append no more. Idempotent."""
        if self in _log.logger.handlers:
            _log.logger.removeHandler(self)
            _log.logger.setLevel(self._former_level)
        with suppress(OSError):  # what could not be written was reported
            super().close()

    def _open(self) -> TextIOWrapper:
        # Of a pipe that no one reads it says so, where it would wait for who does.
        how = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK
        descriptor = os.open(self.baseFilename, how, _AUDIT_MODE)
        os.set_blocking(descriptor, True)
        stream = os.fdopen(descriptor, "a", encoding="utf-8")
        if self._is_broken():  # a disk that was full has half of a line
            stream.write("\n")
        return stream

    def _is_broken(self) -> bool:
        """Say whether the last line has no end."""
        path = Path(self.baseFilename)
        if not path.is_file() or not path.stat().st_size:
            return False
        with path.open("rb") as written:
            written.seek(-1, os.SEEK_END)
            return written.read(1) != b"\n"
