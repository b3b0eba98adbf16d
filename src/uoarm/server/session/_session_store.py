"""Sessions that outlive a short drop of their connection, with their last replies."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import Protocol

from attrs import define, field

from uoarm._raised import Log
from uoarm._support.aio_deadlines import result_within
from uoarm.errors import UsageError
from uoarm.model import ControlMessage
from uoarm.server._failures import LimitError, UnknownError
from uoarm.server._limits import Limits
from uoarm.server.access import AccessRole, Credentials, hash_token
from uoarm.server.session._client import ConnectedClient, Session
from uoarm.server.streams import Account, MemoryUse

_log = Log("uoarm.server")
_KEY_BYTES = 32


class Resumable(Session, Protocol):
    """A session that can go on over another connection."""

    form: str

    @property
    def is_in_use(self) -> bool:
        """Whether its client would lose more than its name with it."""

    def go_on(self, asked: ControlMessage) -> None:
        """Answer the Resume that took the session up, and what its client may not have received."""


@define(eq=False)
class KeptSession:
    """A session that its client asked to retain.

    Attributes:
        client: its transport, with everything that waits for the client.
        since: when its connection dropped; None while it is connected.
        free: set while no connection serves it.
    """

    client: ConnectedClient
    session: Resumable
    since: float | None = None
    free: asyncio.Event = field(factory=asyncio.Event)


class SessionStore:
    """All sessions that are kept, by the hash of their key; in the loop's thread.

    Args:
        limits: how long, how many, and how much memory they may hold.
        end: called for a session that is not taken up in time.
    """

    def __init__(self, limits: Limits, end: Callable[[ConnectedClient, Session], None]) -> None:
        self._limits = limits
        self._end = end
        self._kept: dict[str, KeptSession] = {}
        self._keys: dict[ConnectedClient, str] = {}
        self._successors: dict[ConnectedClient, tuple[KeptSession, ControlMessage]] = {}

    @property
    def waiting(self) -> tuple[ConnectedClient, ...]:
        """The clients of sessions without a connection."""
        return tuple(kept.client for kept in self._kept.values() if kept.since is not None)

    def keep(self, client: ConnectedClient, session: Resumable) -> str:
        """Keep a session from now on; returns the key that takes it up again.

        Raises:
            UsageError: it is kept already, or this server keeps none.
        """
        if not self._limits.resume_seconds:
            raise UsageError("this server keeps no sessions")
        if client in self._keys:
            raise UsageError("this session is kept already")
        key = secrets.token_urlsafe(_KEY_BYTES)
        client.is_kept = True
        self._keys[client] = hash_token(key)
        self._kept[self._keys[client]] = KeptSession(client, session)
        return key

    def claim(self, key: str, client: ConnectedClient, form: str, asked: ControlMessage) -> None:
        """Let a client's connection go on with a kept session, also one that has not dropped yet.

        Raises:
            UnknownError: there is none of this key for this client; or its time is over.
            UsageError: it speaks another form.
        """
        kept = self._kept.get(hash_token(key))
        if kept is None or (kept.client.credentials, kept.client.role) != (
            client.credentials,
            client.role,
        ):
            raise UnknownError("there is no such session, or its time is over; begin anew")
        if kept.session.form != form:
            raise UsageError(f"that session speaks {kept.session.form}, not {form}")
        if any(kept_session is kept for kept_session, _ in self._successors.values()):
            raise LimitError("another connection takes this session up")
        self._successors[client] = kept, asked
        client.is_leaving = True
        kept.client.release()

    async def successor(self, client: ConnectedClient) -> KeptSession | None:
        """Return the session that a leaving client's connection goes on with, once it is free."""
        if client not in self._successors:
            return None
        kept, asked = self._successors[client]
        try:
            await result_within(self._limits.stop_seconds, kept.free.wait())
        except asyncio.TimeoutError:
            return None
        finally:
            del self._successors[client]
        if kept.client not in self._keys:
            return None
        kept.since = None
        kept.free.clear()
        kept.session.go_on(asked)
        return kept

    def retain(self, client: ConnectedClient) -> bool:
        """Keep the session of a client whose connection has ended, if it dropped."""
        key = self._keys.get(client)
        if key is None:
            return False
        kept = self._kept[key]
        kept.free.set()
        if client.has_dropped and self._limits.kept_sessions:
            kept.since = time.monotonic()
            if len(self.waiting) > self._limits.kept_sessions:
                last = self._most_dispensable()
                if last is not kept:
                    self._finish(last)
                    return True
            else:
                return True
        self._forget(kept)
        return False

    def _most_dispensable(self) -> KeptSession:
        """Return the session to end when too many wait: one of those who have most.

        Of these the oldest without use, so that who keeps hundreds pays with its own; where all are
        used, the one that came last: none is taken from its client for another.
        """
        waiting = [kept for kept in self._kept.values() if kept.since is not None]
        counts = Counter(_owner(kept.client) for kept in waiting)
        most = max(counts.values())
        theirs = [kept for kept in waiting if counts[_owner(kept.client)] == most]
        unused = [kept for kept in theirs if not kept.session.is_in_use]
        return min(unused, key=_waits_since) if unused else max(theirs, key=_waits_since)

    def refresh(self, now: float, roles: Callable[[Credentials], AccessRole | None]) -> None:
        """End sessions that waited too long, that hold too much, or whose rights changed."""
        for kept in list(self._kept.values()):
            client, since = kept.client, kept.since
            if since is not None and (
                now - since > self._limits.resume_seconds
                or client.outbox.overflowed
                or roles(client.credentials) != client.role
            ):
                self._finish(kept)
        self._make_room()

    def close(self) -> None:
        for kept in list(self._kept.values()):
            if kept.since is not None:
                self._finish(kept)

    def _make_room(self) -> None:
        """End the sessions that hold most while all that wait hold too much: they fill up still."""
        while sum(client.account.held for client in self.waiting) > self._limits.kept_bytes:
            largest = max(self.waiting, key=lambda item: item.account.held)
            text = "the session %s is not kept: those that wait hold more than %d bytes"
            _log.warning(text, largest.identity, self._limits.kept_bytes)
            self._finish(self._kept[self._keys[largest]])

    def _finish(self, kept: KeptSession) -> None:
        self._forget(kept)
        self._end(kept.client, kept.session)

    def _forget(self, kept: KeptSession) -> None:
        del self._kept[self._keys.pop(kept.client)]


def _waits_since(kept: KeptSession) -> float:
    return kept.since or 0.0


def _owner(client: ConnectedClient) -> tuple[Credentials, str]:
    """Return whose session it is, whatever it is called: as it authenticates, and from where."""
    return client.credentials, client.address.rpartition(":")[0]


class ReplyCache:
    """The last replies of one session by id, and what is under way; all in the loop's thread.

    They are repeated to a client that comes back after a drop.

    Args:
        most: answers that are kept.
        most_bytes: bytes that they may have together; fewer where the client's account is full.
    """

    def __init__(self, most: int, most_bytes: int, account: Account) -> None:
        self._most = most
        self._most_bytes = most_bytes
        self._account = account
        self._held = account.hold(MemoryUse.ANSWERS)
        self._under_way: set[str] = set()
        self._frames: OrderedDict[str, bytes] = OrderedDict()
        self._bytes = 0

    def begin(self, identity: str) -> None:
        """Note a message that will be answered."""
        self._under_way.add(identity)

    def add(self, identity: str, frame: bytes) -> None:
        """Keep an answer, at the cost of the oldest."""
        self._under_way.discard(identity)
        self._bytes += len(frame) - len(self._frames.pop(identity, b""))
        self._frames[identity] = frame
        self._held.resize(self._bytes)
        while self._frames and (
            len(self._frames) > self._most
            or self._bytes > self._most_bytes
            or not self._account.has_room(0)
        ):
            self._bytes -= len(self._frames.popitem(last=False)[1])
            self._held.resize(self._bytes)

    def is_under_way(self, identity: str) -> bool:
        """Say whether an answer is still to come."""
        return identity in self._under_way

    def get(self, identity: str) -> bytes | None:
        return self._frames.get(identity)
