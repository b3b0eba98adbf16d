"""Approvals: what is asked for by one principal is allowed by another one, once, for a time.

`ApprovalBook` is a state without a clock, a thread or I/O. `Approvals` is the one of a server.
Nothing is kept over a restart: an approval that was given and not used is void then.
"""

from __future__ import annotations

import hashlib
import math
import secrets
import time
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any

import orjson
from attrs import evolve, field, frozen

from uoarm._encodable import shown
from uoarm.errors import MessageError
from uoarm.model import Component, Function, Message, Plan, Robot, to_json
from uoarm.server.access._role import AccessRole, Audit, DeniedError, Operation

_MOST_ARGUMENTS = 65_536
_MOST_RANGES = 64
_MOST_COUNT = 1_000
_BEYOND = 2**63
_LONGEST = 3600.0
_MOST_PENDING = 32
_MOST_KEPT = 256
_PENDING_SECONDS = 900.0
_KEPT_SECONDS = 900.0


class ApprovalError(DeniedError):
    """There is no approval for what is to be done, or it may not be given so."""

    error_code = "UOA-707"


class ApprovalPhase(Enum):
    """How an approval stands. Only the first two are ever left."""

    PENDING = "pending"
    APPROVED = "approved"
    USED = "used"
    REFUSED = "refused"
    EXPIRED = "expired"
    VOID = "void"


_OPEN = frozenset({ApprovalPhase.PENDING, ApprovalPhase.APPROVED})


@frozen
class ApprovalFoundation:
    """What an approval rests on; it is void when that is different.

    Attributes:
        revision: of the configuration.
        components: of the plan, in its order: after a takeover they are others.
    """

    revision: int
    components: tuple[str, ...]

    @classmethod
    def of(cls, plan: Plan, revision: int) -> ApprovalFoundation:
        """Return that of a plan."""
        return cls(revision, tuple(step.component.name for step in plan.steps))


def digest_of(arguments: Message) -> str:
    """Return the SHA-256 of arguments, whatever the order of their names.

    Raises:
        MessageError: they have no form as JSON, or are too long to be shown to a person.
    """
    try:
        written = orjson.dumps(arguments, option=orjson.OPT_SORT_KEYS)
    except (TypeError, ValueError) as error:
        raise MessageError(f"arguments that can be approved are plain JSON: {error}") from None
    # What has no JSON of its own, such as NaN, would be shown as something else, and done as it is.
    if orjson.loads(written) != arguments:
        raise MessageError("arguments that can be approved are plain JSON, with finite numbers")
    if len(written) > _MOST_ARGUMENTS:
        raise MessageError(
            f"arguments that can be approved have at most {_MOST_ARGUMENTS:,} octets as JSON, "
            f"got {len(written):,}"
        )
    return hashlib.sha256(written).hexdigest()


@frozen
class ApprovalEnvelope:
    """What may differ from the arguments that are asked for, and how often.

    Attributes:
        ranges: least and greatest number by the path of a field, `linear.x`, as in `limits`.
        count: how often it may be done.
        rate: times a second at most; None: as often as it is asked for.
    """

    ranges: Mapping[str, tuple[float, float]] = field(factory=dict, hash=False)
    count: int = 1
    rate: float | None = None

    def problem(self, arguments: Message) -> str:
        """Return why it is none for these arguments, empty where it is one."""
        if len(self.ranges) > _MOST_RANGES:
            return f"ranges: {_MOST_RANGES} are allowed, got {len(self.ranges)}"
        if not 1 <= self.count <= _MOST_COUNT:
            return f"count: expected 1 to {_MOST_COUNT:,}, got {self.count}"
        rate = 1.0 if self.rate is None else self.rate
        if not 0 < rate < math.inf or not _has_64_bits(rate):
            return f"rate: expected a positive number of times a second, got {shown(rate)}"
        for path, (least, greatest) in self.ranges.items():
            if not -math.inf < least <= greatest < math.inf:
                return f"ranges.{path}: expected two numbers, the least first"
            if not _has_64_bits(least) or not _has_64_bits(greatest):
                return f"ranges.{path}: expected numbers of 64 bits"
            value = _at(arguments, path)
            if not _is_number(value):
                return f"ranges.{path}: the arguments have no number there"
            if not least <= value <= greatest:
                return f"ranges.{path}: {value} of the arguments is not within it"
        return ""

    def mismatch(self, allowed: Message, wanted: Message) -> str:
        """Return what of the arguments is not allowed, empty where all of it is."""
        moved = wanted
        for path, (least, greatest) in self.ranges.items():
            value = _at(wanted, path)
            if not _is_number(value) or not least <= value <= greatest:
                return f"{path}: expected a number of {least} to {greatest}, got {shown(value)}"
            moved = _with(moved, path, _at(allowed, path))
        return "" if digest_of(moved) == digest_of(allowed) else "they are not those approved"


_EXACTLY = ApprovalEnvelope()


@frozen
class ApprovalRequest:
    """What a principal wants to do.

    Attributes:
        requester: the principal.
        operation: `call`, `send` or `request`.
        function: of which function.
        port: the input that is sent to; empty: there is none, or the only one.
        arguments: with which.
        foundation: what the plan of it is.
        envelope: what may differ; without one it is done once, with these arguments.
        seconds: within which it is done, from the approval on.
        preview: what it would do, for the person who decides.
    """

    requester: str
    operation: str
    function: str
    port: str
    arguments: Message = field(hash=False)
    foundation: ApprovalFoundation
    envelope: ApprovalEnvelope = _EXACTLY
    seconds: float = 60.0
    preview: str = ""


@frozen
class Approval:
    """One request and what became of it.

    Attributes:
        id: the one handle of the plan, of its preview, of its approval and of doing it.
        request: what was asked for.
        digest: of its arguments.
        expires: when it ends by itself, in seconds of the clock that `ApprovalBook` is given.
        phase: how it stands.
        approver: the principal that decided.
        uses: how often it was used.
        used: when it was used last.
        cause: why it ended.
    """

    id: str
    request: ApprovalRequest
    digest: str
    expires: float
    phase: ApprovalPhase = ApprovalPhase.PENDING
    approver: str = ""
    uses: int = 0
    used: float = -math.inf
    cause: str = ""

    @property
    def is_open(self) -> bool:
        """Whether it may still be approved or used."""
        return self.phase in _OPEN

    def facts(self) -> dict[str, Any]:
        """Return it as data, without the arguments and what only a person who decides reads."""
        request = self.request
        return {
            "approval": self.id,
            "phase": self.phase.value,
            "requester": request.requester,
            "approver": self.approver,
            "operation": request.operation,
            "function": request.function,
            "port": request.port,
            "envelope": to_json(request.envelope),
            "seconds": request.seconds,
            "uses": self.uses,
            "digest": self.digest,
            "cause": self.cause,
        }


class ApprovalBook:
    """All approvals of one run of a server; a plain state, for one thread.

    Each of its methods is whole before another one begins: of two uses at one time one is first,
    and the other finds it used.
    """

    def __init__(self) -> None:
        self._approvals: dict[str, Approval] = {}
        self._ended: dict[str, float] = {}
        self._changes: list[Approval] = []

    def take_changes(self) -> list[Approval]:
        """Return what has changed since the last time, in order, for the audit log."""
        changes, self._changes = self._changes, []
        return changes

    def all(self, now: float) -> list[Approval]:
        """Return those that are known, oldest first."""
        self._settle(now)
        return list(self._approvals.values())

    def find(self, identity: str, now: float) -> Approval | None:
        """Return one, where it is known."""
        self._settle(now)
        return self._approvals.get(identity)

    def ask(self, identity: str, request: ApprovalRequest, now: float) -> Approval:
        """Take a request in.

        Raises:
            ApprovalError: the principal has too many that wait, or what it asks for is none.
            MessageError: its arguments have no digest.
        """
        self._settle(now)
        if identity in self._approvals:
            raise ApprovalError(f"there is an approval {identity} already")
        digest = digest_of(request.arguments)
        problem = request.envelope.problem(request.arguments)
        if not 0 < request.seconds <= _LONGEST:
            problem = f"seconds: expected up to {_LONGEST:,.0f}, got {request.seconds}"
        if problem:
            raise ApprovalError(problem)
        own = [
            approval
            for approval in self._approvals.values()
            if approval.is_open and approval.request.requester == request.requester
        ]
        if len(own) >= _MOST_PENDING:
            raise ApprovalError(f"{len(own)} approvals are asked for and not used; wait for them")
        return self._put(Approval(identity, request, digest, now + _PENDING_SECONDS))

    def decide(
        self, identity: str, approver: str, now: float, *, approve: bool, cause: str = ""
    ) -> Approval:
        """Approve or refuse a request of another principal.

        Raises:
            ApprovalError: it is one's own, or nothing that waits.
        """
        approval = self._known(identity, now)
        if approver == approval.request.requester:
            raise ApprovalError(
                f"{identity}: {approver!r} asked for it; another principal has to decide"
            )
        if approval.phase is not ApprovalPhase.PENDING:
            raise ApprovalError(f"{identity} is {approval.phase.value}{_because(approval.cause)}")
        phase = ApprovalPhase.APPROVED if approve else ApprovalPhase.REFUSED
        expires = now + approval.request.seconds
        return self._put(
            evolve(approval, phase=phase, approver=approver, expires=expires, cause=cause), now
        )

    def use(self, identity: str, wanted: ApprovalRequest, now: float) -> Approval:
        """Spend an approval on what is about to be done, before it is begun.

        It is spent whatever becomes of that.

        Args:
            identity: of the approval.
            wanted: what is about to be done, with what it rests on at this moment; the envelope,
                seconds and preview of it mean nothing.
            now: seconds.

        Raises:
            ApprovalError: it is no approval of that.
        """
        approval = self._known(identity, now)
        request = approval.request
        if wanted.requester != request.requester:
            raise ApprovalError(f"there is no approval {identity:.64}")
        if approval.phase is not ApprovalPhase.APPROVED:
            raise ApprovalError(f"{identity} is {approval.phase.value}{_because(approval.cause)}")
        what = (wanted.operation, wanted.function, wanted.port)
        if what != (request.operation, request.function, request.port):
            raise ApprovalError(
                f"{identity} is of {request.operation} {request.function}, not of this"
            )
        if wanted.foundation != request.foundation:
            cause = difference(request.foundation, wanted.foundation)
            self._put(evolve(approval, phase=ApprovalPhase.VOID, cause=cause), now)
            raise ApprovalError(f"{identity} is void: {cause}")
        mismatch = request.envelope.mismatch(request.arguments, wanted.arguments)
        if mismatch:
            raise ApprovalError(f"{identity} is of other arguments: {mismatch}")
        rate = request.envelope.rate
        if rate is not None and now - approval.used < 1 / rate:
            raise ApprovalError(f"{identity} allows {rate:g} times a second; wait")
        uses = approval.uses + 1
        phase = ApprovalPhase.USED if uses >= request.envelope.count else approval.phase
        return self._put(evolve(approval, phase=phase, uses=uses, used=now), now)

    def void(self, reason: Callable[[Approval], str], now: float) -> None:
        """End those for which there is a reason, whatever was decided about them."""
        self._settle(now)
        for approval in list(self._approvals.values()):
            if approval.is_open and (cause := reason(approval)):
                self._put(evolve(approval, phase=ApprovalPhase.VOID, cause=cause), now)

    def _known(self, identity: str, now: float) -> Approval:
        approval = self.find(identity, now)
        if approval is None:
            raise ApprovalError(f"there is no approval {identity:.64}")
        return approval

    def _put(self, approval: Approval, now: float = 0.0) -> Approval:
        self._approvals[approval.id] = approval
        self._changes.append(approval)
        if not approval.is_open:
            self._ended[approval.id] = now
            while len(self._ended) > _MOST_KEPT:
                oldest = next(iter(self._ended))
                del self._ended[oldest], self._approvals[oldest]
        return approval

    def _settle(self, now: float) -> None:
        """End what has expired, and forget what ended long ago."""
        for approval in list(self._approvals.values()):
            if approval.is_open and now >= approval.expires:
                cause = "no decision" if approval.phase is ApprovalPhase.PENDING else "unused"
                self._put(evolve(approval, phase=ApprovalPhase.EXPIRED, cause=cause), now)
        for identity, ended in list(self._ended.items()):
            if now - ended >= _KEPT_SECONDS:
                del self._ended[identity], self._approvals[identity]


def difference(allowed: ApprovalFoundation, found: ApprovalFoundation) -> str:
    """Say why what an approval rests on holds no more."""
    if allowed.revision != found.revision:
        return f"the configuration is revision {found.revision}, not {allowed.revision}"
    return f"it would run {', '.join(found.components)}, not {', '.join(allowed.components)}"


def _because(cause: str) -> str:
    return f": {cause}" if cause else ""


def _is_number(value: Message) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _has_64_bits(value: float) -> bool:
    """Say whether every reader of the JSON in which an approval is shown can read a number."""
    return not isinstance(value, int) or -_BEYOND <= value < _BEYOND


def _at(arguments: Message, path: str) -> Message:
    for name in path.split("."):
        if not isinstance(arguments, Mapping) or name not in arguments:
            return None
        arguments = arguments[name]
    return arguments


def _with(arguments: Message, path: str, value: Message) -> Message:
    """Return arguments with another value at a path that they have."""
    assert isinstance(arguments, Mapping), "the path was found"
    name, _, rest = path.partition(".")
    return {**arguments, name: _with(arguments[name], rest, value) if rest else value}


class Supervision:
    """Which functions an agent may use with an approval only, and why; for any thread.

    Args:
        robot: returns the configuration in force.
    """

    def __init__(self, robot: Callable[[], Robot]) -> None:
        self._robot = robot
        # One value, so that threads see either all of a configuration or nothing of it.
        self._known: tuple[Robot | None, dict[tuple[Operation, str], str]] = None, {}

    def reason(self, operation: Operation, function: str) -> str:
        """Return why an operation needs an approval; empty: it needs none."""
        # From any thread: what is found out about a robot is kept with that robot, whichever one
        # another thread looks at meanwhile.
        robot, known = self._robot(), self._known
        if known[0] is not robot:
            known = self._known = robot, {}
        reasons = known[1]
        key = operation, function
        if key not in reasons:
            found = robot.functions.get(function)
            reasons[key] = "" if found is None else _reason(robot, operation, found, frozenset())
        return reasons[key]


def _reason(robot: Robot, operation: Operation, function: Function, above: frozenset[str]) -> str:
    """Return why; all candidates count, as any of them may be taken."""
    if function.approve:
        return f"{function.name} says `approve: true`"
    for component in function.components:
        reason = _moves(component, opened=operation is Operation.REQUEST)
        if reason:
            return reason
        for source in {port.source.function for port in component.inputs if port.source}:
            feeding = robot.functions.get(source)
            if feeding is not None and source not in above:
                reason = _reason(robot, Operation.REQUEST, feeding, above | {function.name, source})
                if reason:
                    return f"{component.name} uses {source}: {reason}"
    return ""


def _moves(component: Component, *, opened: bool) -> str:
    """Say that a component moves something, at all or as soon as it is opened."""
    for port in component.inputs:
        if port.endpoint.command is not None and (port.source is not None or not opened):
            return f"{component.name} moves something: its input {port.name!r} has a lifetime"
    service = component.service
    if service is not None and service.endpoint.command is not None and not opened:
        return f"{component.name} moves something: a call of it has a lifetime"
    return ""


class Approvals:
    """The approvals of a server, in the thread of its loop."""

    def __init__(self, audit: Audit, supervision: Supervision) -> None:
        self.supervision = supervision
        self._audit = audit
        self._book = ApprovalBook()
        self._watchers: dict[Callable[[Approval], None], None] = {}

    def visible(self, role: AccessRole) -> list[Approval]:
        """Return those that a role may decide about, oldest first."""
        return [
            approval
            for approval in self._all()
            if role.allows(Operation.APPROVE, approval.request.function)
        ]

    def find(self, identity: str, requester: str) -> Approval | None:
        """Return one that a principal has asked for."""
        approval = self._book.find(identity, time.monotonic())
        self._report()
        return approval if approval and approval.request.requester == requester else None

    def asked_by(self, requester: str) -> list[Approval]:
        """Return those that a principal has asked for, oldest first."""
        return [approval for approval in self._all() if approval.request.requester == requester]

    def left(self, approval: Approval) -> float:
        """Return the seconds until one ends by itself."""
        return max(0.0, approval.expires - time.monotonic()) if approval.is_open else 0.0

    def ask(self, request: ApprovalRequest) -> Approval:
        """Take a request in; raises as `ApprovalBook.ask`."""
        return self._reported(lambda now: self._book.ask(secrets.token_hex(8), request, now))

    def decide(
        self,
        identity: str,
        approver: str,
        role: AccessRole,
        *,
        approve: bool,
        digest: str = "",
        cause: str = "",
    ) -> Approval:
        """Decide about a request.

        Args:
            identity: of the approval.
            approver: the principal who decides.
            role: of that principal.
            approve: or refuse.
            digest: of the arguments that the principal has seen; empty: not compared.
            cause: why, for who asked.

        Raises:
            ApprovalError: as `ApprovalBook.decide`, or the role may not approve this function.
        """
        approval = self._book.find(identity, time.monotonic())
        # The same text where there is none: a role learns nothing of functions that are not its.
        if approval is None or not role.allows(Operation.APPROVE, approval.request.function):
            self._report()
            raise ApprovalError(f"there is no approval {identity:.64} that this role may give")
        if digest and digest != approval.digest:
            raise ApprovalError(f"{identity} is of other arguments than those that were shown")
        return self._reported(
            lambda now: self._book.decide(identity, approver, now, approve=approve, cause=cause)
        )

    def use(self, identity: str, wanted: ApprovalRequest) -> Approval:
        """Spend an approval; raises as `ApprovalBook.use`, and where that cannot be recorded."""
        try:
            approval = self._reported(lambda now: self._book.use(identity, wanted, now))
        except ApprovalError as error:
            self._audit.approval_denied(identity, wanted.requester, wanted.function, str(error))
            raise
        if not self._audit.is_kept:
            raise ApprovalError(f"{identity}: the audit log cannot be written; nothing is done")
        return approval

    def reconfigured(self, revision: int) -> None:
        """End those of other revisions than the one in force."""
        cause = f"the configuration is revision {revision}"
        self._void(
            lambda approval: cause if approval.request.foundation.revision != revision else ""
        )

    def taken_over(self, function: str) -> None:
        """End those of a function, of which another component runs now."""
        cause = "another component took over"
        self._void(lambda approval: cause if approval.request.function == function else "")

    def watch(self, watcher: Callable[[Approval], None]) -> None:
        """Notify a watcher of every change."""
        self._watchers[watcher] = None

    def unwatch(self, watcher: Callable[[Approval], None]) -> None:
        """Notify a watcher no more. Idempotent."""
        self._watchers.pop(watcher, None)

    def _all(self) -> list[Approval]:
        approvals = self._book.all(time.monotonic())
        self._report()
        return approvals

    def _void(self, reason: Callable[[Approval], str]) -> None:
        self._book.void(reason, time.monotonic())
        self._report()

    def _reported(self, act: Callable[[float], Approval]) -> Approval:
        try:
            return act(time.monotonic())
        finally:
            self._report()

    def _report(self) -> None:
        for approval in self._book.take_changes():
            self._audit.approval(approval.facts(), approval.request.arguments)
            for watcher in tuple(self._watchers):
                watcher(approval)
