"""What components raise, and what they give that does not match: counted and judged by a rule.

`FailureRule` decides, without I/O; the watches count for it in the threads that move messages.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Hashable

from attrs import define, field, frozen

from uoarm._raised import LimitedLog, is_raised, text_of
from uoarm.errors import MessageError
from uoarm.model import FailureLimits, Health

Clock = Callable[[], float]
"""Returns a monotonic clock, in seconds."""


@define
class FailureRule:
    """Judges a component by what becomes of its messages.

    It is degraded from its first failure on. A window begins there, and ends as soon as less than
    `share` of its messages have failed; the next failure begins another. When a window has lasted
    for `messages` messages and `seconds` seconds, the component is lost. When as many messages and
    seconds have passed without a failure, it is well.
    """

    limits: FailureLimits
    health: Health = Health.OK
    _began: float | None = field(default=None, init=False)
    _all: int = field(default=0, init=False)
    _failed: int = field(default=0, init=False)
    _well_since: float | None = field(default=None, init=False)
    _well: int = field(default=0, init=False)

    def note(self, taken: int, failed: int, now: float) -> bool:
        """Take in what became of some messages; say whether `health` has changed.

        Args:
            taken: how many were taken; where some failed too, these came after them.
            failed: how many the component raised on.
            now: seconds of a monotonic clock.
        """
        before = self.health
        if before is Health.LOST or (before is Health.OK and not failed):
            return False
        self._count_well(taken, failed, now)
        self._count_window(taken, failed, now)
        return self.health is not before

    def _count_well(self, taken: int, failed: int, now: float) -> None:
        if failed:
            self.health, self._well_since, self._well = Health.DEGRADED, None, 0
        if not taken:
            return
        if self._well_since is None:
            self._well_since = now
        self._well += taken
        if self._is_enough(self._well, now - self._well_since):
            self.health, self._began = Health.OK, None

    def _count_window(self, taken: int, failed: int, now: float) -> None:
        if failed and self._began is None:
            self._began, self._all, self._failed = now, 0, 0
        if self._began is None:
            return
        self._all += taken + failed
        self._failed += failed
        if self._failed < self.limits.share * self._all:
            self._began = None
        elif self._is_enough(self._all, now - self._began):
            self.health = Health.LOST

    def _is_enough(self, messages: int, seconds: float) -> bool:
        return messages >= self.limits.messages and seconds >= self.limits.seconds


_ORDER = (Health.OK, Health.DEGRADED, Health.LOST)
_TAKING = ""  # the name of no output

Notify = Callable[[Health, str], None]
"""Takes a new verdict and its cause; must not block."""


@frozen
class _FailureDescription:
    """What a component did, for people: `its input 'default' raised`, and how often."""

    once: str
    often: str

    @classmethod
    def raising(cls, place: str) -> _FailureDescription:
        return cls(f"{place} raised", f"{place} raises again and again")

    @classmethod
    def giving(cls, port: str, what: str) -> _FailureDescription:
        place = f"its output {port!r}"
        return cls(f"{place} gave {what}:", f"{place} gives again and again {what}")


_SUCCESS = _FailureDescription("", "")


class FailureWatch:
    """Watches one instance of a component, or one service. Thread safe.

    What it takes and what it gives are judged apart, each output by itself: a message that was
    taken is no success where all that comes of it is wrong. So are what can be read of an output
    at all, and what of that matches. The component is as well as the worst.

    Args:
        notify: called each time the verdict changes.

    Attributes:
        failed: how many messages or calls it raised on, and how many could not be read or did
            not match.
        last_error: of the last of these, empty when there was none.
        cause: of the verdict, empty when it is well.
        is_alert: whether successes count, too: it has failed and is not well again. Read for
            each message, so a plain attribute.
    """

    def __init__(self, name: str, limits: FailureLimits, clock: Clock, notify: Notify) -> None:
        self._name = name
        self._limits = limits
        self._rules: dict[Hashable, FailureRule] = {}
        self._clock = clock
        self._notify = notify
        # Guards counts and rules, and the order of verdicts: messages pass in several threads.
        self._lock = threading.Lock()
        self._records = LimitedLog(f"uoarm.component.{name}", clock=clock)
        self.failed = 0
        self.last_error = ""
        self.cause = ""
        self.is_alert = False

    @property
    def health(self) -> Health:
        # Of a copy: it is read without the lock too, and the first message of another output adds
        # a rule meanwhile.
        rules = tuple(self._rules.values())
        return max((rule.health for rule in rules), key=_ORDER.index, default=Health.OK)

    def raised(self, place: str, error: BaseException) -> None:
        """Take in that the component raised, and log it."""
        text = text_of(error)
        self.note(_FailureDescription.raising(place), 0, 1, text)
        self._log(place, text, error)

    def note_later_report(self, place: str, taken: int, failed: int, text: str) -> None:
        """Take in what a channel reports of messages that were sent before."""
        self.note(_FailureDescription.raising(place), taken, failed, text)
        if failed:
            self._log(place, text)

    def _log(self, place: str, text: str, error: BaseException | None = None) -> None:
        message = f"component {self._name}: {place} raised {text}"
        self._records.write(logging.WARNING, message, error)

    def took(self) -> None:
        """Take in a success; needed only while `is_alert`."""
        self.note(_SUCCESS, 1, 0, "")

    def note(
        self,
        failure: _FailureDescription,
        taken: int,
        failed: int,
        text: str,
        judged: Hashable = _TAKING,
    ) -> bool:
        """Take in what became of some messages; say whether what is judged is not well now.

        Args:
            failure: what it did where it failed, for people.
            taken: how many went well.
            failed: how many it failed on.
            text: of the last error.
            judged: what has a rule of its own; without it, they were given to the component.
        """
        with self._lock:
            if failed:
                self.failed += failed
                self.last_error = text
            before = self.health
            rule = self._rules.get(judged)
            if rule is None:
                rule = self._rules[judged] = FailureRule(self._limits)
            rule.note(taken, failed, self._clock())
            health, count = self.health, self.failed
            # Routes read this without the lock. One that reads it late leaves out a success, which
            # delays that the component is well, and never a failure.
            self.is_alert = health is not Health.OK
            # Within the lock, so that verdicts are reported in their order.
            if health is not before:
                message = _cause(health, failure, count, text)
                self.cause = "" if health is Health.OK else message
                self._notify(health, message)
            return rule.health is not Health.OK


class InputWatch:
    """Watches one input: what a route that feeds it reports of its messages.

    Attributes:
        is_later: whether the channel reports what became of messages, later than `send` returns.
        suspect: called, by edge that feeds it, when messages came that were wrong themselves.
        refusal: why the last of those was not taken of which the channel reported later; empty
            where one was taken since.
    """

    __slots__ = ("_place", "component", "is_later", "refusal", "suspect")

    def __init__(self, component: FailureWatch, port: str) -> None:
        self.component = component
        self._place = f"its input {port!r}"
        self.is_later = False
        self.refusal = ""
        self.suspect: dict[Hashable, Callable[[], None]] = {}

    def took(self) -> None:
        """Take in that a message was taken, unless the channel reports that itself."""
        # Else it would count twice: as it was sent, and as the channel reports it.
        if not self.is_later:
            self.component.took()

    def raised(self, error: Exception) -> bool:
        """Take in what a message came to; say whether it was the component's failure."""
        if not is_raised(error):
            return False
        self.component.raised(self._place, error)
        return True

    def reported(self, taken: int, failed: int, wrong: int, text: str) -> None:
        """Take in what became of messages that were sent before.

        Of those that were wrong only the next show whose they are: each that feeds the input is
        checked.
        """
        if failed or wrong or taken:
            self.refusal = text if failed or wrong else ""
        if failed or (taken and self.component.is_alert):
            self.component.note_later_report(self._place, taken, failed, text)
        if wrong:
            # Of a copy: edges of this input open and close in other threads meanwhile.
            for suspect in tuple(self.suspect.values()):
                suspect()


class OutputWatch:
    """Watches one output: what its bridge can read, and what the checks of its messages find."""

    __slots__ = ("_port", "_reading", "component")

    def __init__(self, component: FailureWatch, port: str) -> None:
        self.component = component
        self._port = port
        # Another key than that of its messages, the name alone: what can be read at all need not
        # match, so neither may make good the failures of the other.
        self._reading = "reading", port

    def took(self) -> None:
        """Take in that a message matched."""
        self.component.note(_SUCCESS, 1, 0, "", self._port)

    def mismatched(self, error: MessageError) -> None:
        """Take in that a message did not match; the route logs it."""
        failure = _FailureDescription.giving(self._port, "what does not match its structure")
        self.component.note(failure, 0, 1, str(error), self._port)

    def unreadable(self, why: str) -> None:
        """Take in that a message could not be read; the route logs it."""
        failure = _FailureDescription.giving(self._port, "what cannot be read")
        self.component.note(failure, 0, 1, why, self._reading)

    def read(self) -> bool:
        """Take in that something could be read; say whether that matters the next time, too."""
        return self.component.note(_SUCCESS, 1, 0, "", self._reading)


def _cause(health: Health, failure: _FailureDescription, count: int, text: str) -> str:
    if health is Health.OK:
        return "it fails no more"
    if health is Health.DEGRADED:
        return f"{failure.once} {text}"
    return f"{failure.often}, {count} times so far: {text}"
