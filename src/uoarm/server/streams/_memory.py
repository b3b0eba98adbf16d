"""How much memory the server holds for its clients: octets of decoded values, by client and kind.

Plain states without I/O, for the loop's thread. What is held is charged to the account of the
client that caused it, before it is kept, and released when it is let go; a client that goes
releases everything, whatever still runs for it elsewhere.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping
from contextvars import ContextVar
from enum import Enum
from typing import final

from uoarm.server._failures import BusyError, LimitError


class MemoryUse(Enum):
    """What memory is held for."""

    ASKED = "asked"
    """Calls, requests and goals that are worked on, with their arguments."""
    SENDING = "sending"
    """Messages on their way into a component."""
    REPLIES = "replies"
    """Replies, events and results that wait to be written."""
    DATA = "data"
    """Data messages that wait to be written."""
    ANSWERS = "answers"
    """Replies that were written, kept for a client that may come back."""
    LATCHED = "latched"
    """Last messages of topics that the client publishes with latch."""
    THROTTLED = "throttled"
    """Messages that a subscription holds back until they are due."""
    FRAGMENTS = "fragments"
    """Pieces of messages that are not complete."""
    ARRIVED = "arrived"
    """What came from the client and was not acted on yet, from the first octet of a message on."""


@final
class Charge:
    """Something that is held. Made by `Account.charge` and `Account.hold`."""

    __slots__ = ("_account", "kind", "octets")

    def __init__(self, account: Account, kind: MemoryUse) -> None:
        self._account = account
        self.kind = kind
        self.octets = 0

    def resize(self, octets: int) -> None:
        """Hold another amount, without regard to limits; nothing once it was released."""
        self.grow(octets - self.octets)

    def grow(self, octets: int) -> bool:
        """Hold so much more, as `resize`; say whether the client holds no more than it may."""
        account = self._account
        # A charge that was released, or whose client has gone, counts as nothing: what runs on for
        # it in a thread may change it once more.
        if self in account.charges:
            self.octets += octets
            account.held += octets
            account.memory.held += octets
        return account.has_room(0)

    def release(self) -> None:
        """Hold it no more. Idempotent."""
        # Before it is taken out, after which its size would count as nothing.
        self.resize(0)
        self._account.charges.discard(self)


@final
class Account:
    """What the server holds for one client. Made by `Memory.open`.

    Attributes:
        memory: of all clients.
        held: octets in all.
        charges: everything that is held.
        arrived: what came and was not acted on, which leaves less room for others, but not for
            what the client itself asked.
    """

    def __init__(self, memory: ServerMemory) -> None:
        self.memory = memory
        self._is_closed = False
        self.held = 0
        self.charges: set[Charge] = set()
        # Last: `hold` needs the fields above.
        self.arrived = self.hold(MemoryUse.ARRIVED)

    def has_room(self, octets: int) -> bool:
        """Say whether so much more may be held for this client."""
        held = self.held + octets
        # Both bounds: of the client itself, and of all, save for who has less than its share: else
        # one that hoards would have others refused.
        return held - self.arrived.octets <= self.memory.most_each and (
            self.memory.held + octets <= self.memory.most or held <= self.memory.fair_share
        )

    @property
    def has_share(self) -> bool:
        """Whether all clients have room, or this one has no more than its share."""
        memory = self.memory
        return memory.held <= memory.most or self.held <= memory.fair_share

    def charge(self, kind: MemoryUse, octets: int) -> Charge:
        """Hold something more for the client.

        Raises:
            LimitError: it is more than one client may have.
            BusyError: it is more than all clients may have, and this one has its share.
        """
        if not self.has_room(octets):
            most = self.memory.most_each
            held = self.held - self.arrived.octets
            if held + octets > most:
                raise LimitError(
                    f"{octets:,} octets of memory are needed, and {held:,} of the {most:,} "
                    "that one client may have are taken; wait for answers, or send less at a time"
                )
            raise BusyError(
                f"{self.memory.held:,} octets of memory are taken by all clients together; the "
                f"server holds {self.memory.most:,}: ask again later"
            )
        made = self.hold(kind)
        made.resize(octets)
        return made

    def hold(self, kind: MemoryUse) -> Charge:
        """Return a charge of nothing yet, for what has bounds of its own; see `Charge.resize`."""
        made = Charge(self, kind)
        if not self._is_closed:
            self.charges.add(made)
        return made

    def close(self) -> None:
        """Release everything; what is charged later counts as nothing. Idempotent."""
        # First: a charge made while others are released must count as nothing.
        self._is_closed = True
        for charge in tuple(self.charges):  # a copy: a release takes it out
            charge.release()
        # Last: until all is released, this client counts where shares are made.
        self.memory.forget(self)


@final
class ServerMemory:
    """What the server holds for all its clients.

    No client that has less than its share is refused because of others: its share is what each
    would have if all had the same. So at most twice `most` is held.

    Args:
        most: octets for all clients together.
        most_each: octets for one client.

    Attributes:
        held: octets in all.
    """

    def __init__(self, most: int, most_each: int) -> None:
        self.most = most
        self.most_each = most_each
        self.held = 0
        self._accounts: set[Account] = set()

    @property
    def fair_share(self) -> int:
        """Octets for each client if all had the same."""
        return self.most // max(1, len(self._accounts))

    @property
    def is_full(self) -> bool:
        """Whether more is held than all clients together should have."""
        return self.held > self.most

    @property
    def kinds(self) -> Mapping[MemoryUse, int]:
        """Octets of each kind."""
        kinds = dict.fromkeys(MemoryUse, 0)
        for account in self._accounts:
            for charge in account.charges:
                kinds[charge.kind] += charge.octets
        return kinds

    @property
    def largest(self) -> int:
        """Octets of the client that has most."""
        return max((account.held for account in self._accounts), default=0)

    def open(self) -> Account:
        """Return the account of a client that has come."""
        account = Account(self)
        self._accounts.add(account)
        return account

    def forget(self, account: Account) -> None:
        """Count a client no more; for accounts."""
        self._accounts.discard(account)


acting: ContextVar[Hashable] = ContextVar("acting", default=None)
"""For which client the loop works: its account. Tasks that are made then go on for the same one."""


@final
class Shares:
    """Counts what is taken, by owner; a plain state without a lock, for the loop's thread.

    No owner who has less than an equal share is refused because of others, as with `ServerMemory`:
    so at most twice `most` is taken.

    Args:
        most: of all owners together.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._taken: Counter[Hashable] = Counter()

    @property
    def total(self) -> int:
        """What is taken in all."""
        return self._taken.total()

    def of(self, owner: Hashable) -> int:
        """Return what an owner has."""
        return self._taken[owner]

    def admits(self, owner: Hashable, count: int = 1) -> bool:
        """Say whether an owner may take so much more."""
        # With room for all there are no shares: who comes first may take it.
        if self.total + count <= self._most:
            return True
        owners = len(self._taken) + (owner not in self._taken)
        return self._taken[owner] + count <= self._most // owners

    def take(self, owner: Hashable, count: int = 1) -> None:
        """Count what an owner takes; see `admits`. A negative count gives back."""
        self._taken[owner] += count
        # Who has nothing is no owner: shares are divided among those who have something.
        if not self._taken[owner]:
            del self._taken[owner]
