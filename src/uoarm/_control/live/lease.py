"""Who may command an input that one sender at a time may.

`Lease` decides, as a state machine, and touches no thread or clock: its times are seconds of one
monotonic clock. `InputLease` wraps it for the threads that send.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from uoarm._dataplane import Clock
from uoarm.bridge import boot_seconds
from uoarm.errors import CommandRefusedError
from uoarm.model import LeaseHolder, LeasePolicy, LeaseStatus

__all__ = ["InputLease", "Lease"]


class Lease:
    """One holder at a time, until it gives it back, sends nothing for a while, or is overridden.

    Args:
        policy: of the input.
    """

    def __init__(self, policy: LeasePolicy) -> None:
        self._duration = policy.duration
        self._priorities = dict(policy.priorities)
        self._holder: LeaseHolder | None = None
        self._until = 0.0
        self._refused = 0

    def holder(self, now: float) -> LeaseHolder | None:
        """Return who holds it; None where it is free."""
        return self._holder if now < self._until else None

    def ask(self, sender: LeaseHolder, now: float, *, take_over: bool = False) -> str:
        """Give it to a sender or renew it; return why it may not have it, nothing where it has it.

        Whoever asks first has it. One of a higher priority takes it over; one of the same
        priority does where it wants to.
        """
        holder = self.holder(now)
        if holder is not None and holder.id != sender.id:
            mine, other = self._priority(sender), self._priority(holder)
            if mine < other or (mine == other and not take_over):
                self._refused += 1
                left = f"for another {self._until - now:.3f} s without a command of its own"
                return f"{holder} holds its lease, {left}"
        self._holder, self._until = sender, now + self._duration
        return ""

    def passes(self, sender: LeaseHolder, now: float) -> bool:
        """Say whether a command that was let in still may go on: nobody else has it meanwhile."""
        holder = self.holder(now)
        if holder is None or holder.id == sender.id:
            return True
        self._refused += 1
        return False

    def give_back(self, sender: LeaseHolder, now: float) -> bool:
        """Free it; return whether this sender held it."""
        holder = self.holder(now)
        if holder is None or holder.id != sender.id:
            return False
        self._holder = None
        self._until = now
        return True

    def status(self, now: float) -> LeaseStatus:
        """Return what the status map shows."""
        holder = self.holder(now)
        if holder is None:
            return LeaseStatus(refused=self._refused)
        return LeaseStatus(holder, self._priority(holder), self._until - now, self._refused)

    def _priority(self, sender: LeaseHolder) -> float:
        return self._priorities.get(sender.role, 0.0)


class InputLease:
    """The lease of one open input. Thread safe.

    Args:
        policy: of the input.
        place: of the input, `base.default`.
        announce: told who holds it now, in a sentence, whenever that changes by what somebody did;
            nobody is told when it lapses.
        clock: seconds.
    """

    def __init__(
        self,
        policy: LeasePolicy,
        place: str,
        announce: Callable[[str], None],
        clock: Clock = boot_seconds,
    ) -> None:
        self._lease = Lease(policy)
        self._place = place
        self._announce = announce
        self._clock = clock
        self._lock = threading.Lock()

    def ask(self, sender: LeaseHolder, *, take_over: bool = False) -> None:
        """Give it to a sender or renew it; see `Lease.ask`.

        Raises:
            CommandRefusedError: somebody else holds it, whom the text names.
        """
        with self._lock:
            now = self._clock()
            before = self._lease.holder(now)
            refused = self._lease.ask(sender, now, take_over=take_over)
        if refused:
            raise CommandRefusedError(f"{self._place}: {refused}", "leased")
        if before is None or before.id != sender.id:
            over = "" if before is None else f", who took it over from {before}"
            self._announce(f"{self._place}: {sender} holds its lease{over}")

    def require(self, sender: LeaseHolder) -> None:
        """Refuse a command whose sender has lost it since.

        Raises:
            CommandRefusedError: somebody else holds it.
        """
        with self._lock:
            passes = self._lease.passes(sender, self._clock())
        if not passes:
            text = f"{self._place}: its lease was taken over while the command waited"
            raise CommandRefusedError(text, "leased")

    def is_open_to(self, sender: LeaseHolder) -> bool:
        """Say whether this sender holds it, or nobody does."""
        with self._lock:
            holder = self._lease.holder(self._clock())
        return holder is None or holder.id == sender.id

    def give_back(self, sender: LeaseHolder) -> bool:
        """Free it; return whether this sender held it."""
        with self._lock:
            held = self._lease.give_back(sender, self._clock())
        if held:
            self._announce(f"{self._place}: {sender} gave its lease back")
        return held

    def status(self) -> LeaseStatus:
        """Return what the status map shows."""
        with self._lock:
            return self._lease.status(self._clock())
