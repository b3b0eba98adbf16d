"""The transport between a manager and the hosts of other machines: one Zenoh session at either end.

Requests are Zenoh queries whose payloads are frames of the codec. Who may join, and what it may
touch, is said by mutual TLS and an access list: everything is denied but to a machine whose
certificate carries its name, and to that one only the keys that begin with it.
"""

from __future__ import annotations

import copy
import json
import os
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, final

import zenoh
from attrs import frozen

from uoarm._host.transport import keys
from uoarm._host.transport.codec import Frame, pack
from uoarm._host.transport.transport import (
    ANSWER_SECONDS,
    LinkLostError,
    Reply,
    Transport,
    answer_of,
    answer_to,
    read_answer,
)
from uoarm._raised import Log
from uoarm._support.files import expanded
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError

MANAGER = "manager"
"""The name of the manager's files in a folder of certificates."""
_AUTHORITY = "ca"
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
_MOST_CERTIFIED = 1024
_OTHERS = 0o077
_MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
_PLACE_IN_ZENOH = re.compile(r" at /\S+\.rs:\d+")  # of the machine that built it
_BLOCK, _DROP = zenoh.CongestionControl.BLOCK, zenoh.CongestionControl.DROP
# Of requests, their answers, and notices: before all messages that wait for a link that is full.
_AHEAD = zenoh.Priority.INTERACTIVE_HIGH
_log = Log("uoarm")
NO_MORE: Mapping[str, object] = MappingProxyType({})
_FULL_SECONDS = 0.2
_RETRY_MILLISECONDS = 200


@frozen
class Identity:
    """The files by which one end of a link shows who it is and knows whom to believe."""

    authority: Path
    certificate: Path
    key: Path

    @classmethod
    def find(cls, folder: str | Path, name: str) -> Identity:
        """Return `ca.pem`, `NAME.pem` and `NAME.key` of a folder.

        Raises:
            BridgeError: one of them is missing, or others than its owner may read the key.
        """
        home = expanded(folder)
        found = cls(home / "ca.pem", home / f"{name}.pem", home / f"{name}.key")
        for file in (found.authority, found.certificate, found.key):
            if not os.path.isfile(file):
                text = f"there is no {file}; make it: uoarm certificates --help"
                raise BridgeError(text, FailureReason.NOT_FOUND)
        if os.name == "posix" and found.key.stat().st_mode & _OTHERS:
            text = f"others may read the private key {found.key}: chmod 600 it"
            raise BridgeError(text, FailureReason.REFUSED)
        return found

    def settings(self, *, listen: bool) -> dict[str, object]:
        """Return Zenoh's settings for the end that listens, or for one that joins."""
        side = "listen" if listen else "connect"
        return {
            "transport/link/tls": {
                "root_ca_certificate": str(self.authority),
                f"{side}_certificate": str(self.certificate),
                f"{side}_private_key": str(self.key),
                "enable_mtls": True,
                "verify_name_on_connect": True,
                "close_link_on_expiration": True,
            }
        }


def certified(folder: str | Path) -> frozenset[str]:
    """Return the machines whose certificates are in a folder, a thousand at most."""
    found = sorted(file.stem for file in expanded(folder).glob("*.pem"))
    # A name becomes part of a key, where `*` and `/` would open the keys of other machines.
    names = [name for name in found if name not in {_AUTHORITY, MANAGER} and _NAME.fullmatch(name)]
    return frozenset(names[:_MOST_CERTIFIED])


def access_list(machines: Iterable[str] | None) -> Mapping[str, object]:
    """Return Zenoh's settings under which each machine reaches its own keys, and no other.

    Args:
        machines: their names, as in their certificates; None where there are none, as on a
            loopback without TLS: a client that connects may touch the keys of every machine.
    """
    if machines is None:
        rules = [_rule("any-client", f"{keys.MACHINES}/**")]
        subjects: list[dict[str, object]] = [{"id": "any-client"}]
    else:
        names = sorted(machines)
        rules = [_rule(name, f"{keys.MACHINES}/{name}/**") for name in names]
        subjects = [{"id": name, "cert_common_names": [name]} for name in names]
    return {
        "access_control": {
            "enabled": True,
            # Both ways: a machine neither gets what is sent to another, nor sends in its name.
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": [
                {"rules": [subject["id"]], "subjects": [subject["id"]]} for subject in subjects
            ],
        }
    }


def _rule(name: str, key: str) -> dict[str, object]:
    return {
        "id": name,
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": list(_MESSAGES),
        "key_exprs": [key],
    }


@final
class ZenohTransport(Transport):
    """One end of a Zenoh session.

    Args:
        address: a Zenoh endpoint, `tls/...` or `tcp/...`.
        listen: whether this end waits for the other one; it must be there first.
        timeout: seconds for the connection to stand, where this end connects, or connects again;
            `close` waits as long for such a try.
        lease: seconds without a sign of life after which the other end is taken for gone. The
            heartbeat notices a host that hangs, so this may be long.
        more: further settings of the session, by name.

    Raises:
        BridgeError: the session could not be opened.
    """

    def __init__(
        self,
        address: str,
        *,
        listen: bool,
        timeout: float = 10.0,
        lease: float = 10.0,
        more: Mapping[str, object] = NO_MORE,
    ) -> None:
        super().__init__()
        with _wrapped(f"opening the link at {address}"):
            settings = configuration(
                address, listen=listen, timeout=timeout, lease=lease, more=more
            )
            self._session = zenoh.open(settings)
        self._prefix = ""
        # What was declared and not ended. Changed in single steps, from any thread: of an `end` and
        # a `close` that come at once, one takes an entry.
        self._kept: list[Any] = []

    def part(self, prefix: str) -> ZenohTransport:
        """Return a transport over the same session that sees every key behind a prefix.

        Closing it ends what was declared through it; the session stays.
        """
        # All parts use one session at once: Zenoh lets any thread call it.
        part = copy.copy(self)
        part._prefix = f"{self._prefix}{prefix}/"  # noqa: SLF001 - one of this kind
        part._kept = []  # noqa: SLF001 - likewise
        return part

    def ask(self, key: str, request: Any, *, timeout: float = ANSWER_SECONDS) -> Any:
        """Send a request and return the answer."""
        begun = time.monotonic()
        key = self._prefix + key
        # Zenoh ends the replies when the limit is over, and at once where no one answers at the
        # key: only the time that has passed distinguishes them.
        with _wrapped(f"asking {key}"):
            getting = self._session.get(
                key, payload=pack(request), timeout=timeout, priority=_AHEAD
            )
            replies = list(getting)
        late = time.monotonic() - begun >= timeout
        if late and (not replies or replies[0].ok is None):
            raise BridgeTimeoutError(f"no answer at {key} within {timeout:g} s")
        if not replies:
            raise LinkLostError(f"there is no answer at {key}")
        return _answer_in(replies[0], key)

    def ask_later(self, key: str, take: Callable[[Any], None], *, timeout: float) -> None:
        """Send a bare request, and have the answer handed to `take` in Zenoh's thread."""
        key = self._prefix + key

        # In a thread that also brings signs of life: `take` must not wait for anything.
        def handle(reply: zenoh.Reply) -> None:
            try:
                answer = _answer_in(reply, key)
            except UoarmError as error:
                _log.debug("%s", error)
            else:
                take(answer)

        with _wrapped(f"asking {key}"):
            self._session.get(
                key, _directly(handle), payload=pack(None), timeout=timeout, priority=_AHEAD
            )

    def answer(self, key: str, take: Callable[[Any, Reply], None]) -> Callable[[], None]:
        """Have requests at a key handed to `take`, in Zenoh's thread."""

        def handle(query: zenoh.Query) -> None:
            payload = query.payload
            answer_to(take, None if payload is None else payload.to_bytes(), _reply_to(query))

        with _wrapped(f"answering at {key}"):
            return self._keep(
                self._session.declare_queryable(self._prefix + key, _directly(handle))
            )

    def publish(
        self,
        key: str,
        payload: bytes,
        header: bytes,
        *,
        must_arrive: bool = False,
        priority: zenoh.Priority = zenoh.Priority.DATA,
    ) -> None:
        """Send one frame; with `must_arrive`, a link that stays full for 5 s is broken."""
        with _wrapped(f"sending to {key}"):
            self._session.put(
                self._prefix + key,
                payload,
                attachment=header,
                congestion_control=_BLOCK if must_arrive else _DROP,
                priority=priority,
            )

    def subscribe(
        self, key: str, length: int, take: Callable[[Frame, bytes], object], name: str
    ) -> Callable[[], None]:
        """Have frames at a key handed to `take`, in a thread of their own."""
        with _wrapped(f"subscribing to {key}"):
            # Where `take` is slow the oldest are overwritten. Nothing is said of it here: the
            # receiving end of a flow counts the gap in the numbers.
            ring: Any = zenoh.handlers.RingChannel(length)
            subscriber = self._session.declare_subscriber(self._prefix + key, ring)
        undeclare = self._keep(subscriber)
        # Looked at after each wait: what was in the ring as `end` was called is not handed over. A
        # thread of its own, as `take` may block and Zenoh's threads serve all subscriptions.
        ended = threading.Event()

        def run() -> None:
            while not ended.is_set():
                try:
                    sample = subscriber.handler.recv()
                except zenoh.ZError:  # it has ended
                    return
                header = sample.attachment
                if not ended.is_set():
                    take(sample.payload.to_bytes(), b"" if header is None else header.to_bytes())

        def end() -> None:
            ended.set()
            undeclare()

        threading.Thread(target=run, name=name, daemon=True).start()
        return end

    def notify(self, key: str, header: bytes) -> None:
        """Send a header to who listens at a key."""
        self.publish(key, b"", header, must_arrive=True, priority=_AHEAD)

    def listen(self, key: str, take: Callable[[bytes], None]) -> Callable[[], None]:
        """Have headers that are sent to a key handed to `take`, in Zenoh's thread."""

        def handle(sample: zenoh.Sample) -> None:
            header = sample.attachment
            if header is not None:
                take(header.to_bytes())

        with _wrapped(f"listening at {key}"):
            taking = _directly(handle)
            return self._keep(self._session.declare_subscriber(self._prefix + key, taking))

    def show_alive(self, key: str) -> None:
        """Declare a token that goes when this end dies."""
        with _wrapped("declaring the token"):
            # Last of all that an end declares which is asked: who sees the token may ask at once.
            self._keep(self._session.liveliness().declare_token(self._prefix + key))

    def watch_alive(self, key: str, seen: Callable[[bool], None]) -> None:
        """Have the coming and going of a token reported, in Zenoh's thread."""
        self.watch_tokens(key, lambda _, alive: seen(alive))

    def watch_tokens(self, keys: str, seen: Callable[[str, bool], None]) -> Callable[[], None]:
        """Have the coming and going of every token that matches reported, each with its key.

        Those that are there are reported first. Returns what ends it.
        """

        def handle(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr).removeprefix(self._prefix)
            seen(key, sample.kind == zenoh.SampleKind.PUT)

        with _wrapped("watching for tokens"):
            tokens = self._session.liveliness()
            address = self._prefix + keys
            # With those that are there: one that came just before would be missed for ever.
            subscriber = tokens.declare_subscriber(address, _directly(handle), history=True)
        return self._keep(subscriber)

    def close(self) -> None:
        """End everything of this end, or of this part of it. Idempotent."""
        if self._prefix:
            while self._kept:
                with suppress(zenoh.ZError, IndexError):  # closed before, or ended just now
                    self._kept.pop().undeclare()
            return
        # With the session all that was declared ends; the other end sees the tokens go.
        self._kept.clear()
        with _wrapped("closing the link"):
            self._session.close()  # type: ignore[no-untyped-call] # zenoh's stub says no more

    def _keep(self, declared: Any) -> Callable[[], None]:
        self._kept.append(declared)

        def end() -> None:
            try:
                self._kept.remove(declared)
            except ValueError:  # it was ended before
                return
            with _wrapped("ending a subscription"):
                declared.undeclare()

        return end


def _directly(handle: Callable[[Any], None]) -> Any:
    """Have a handler called in Zenoh's thread; else each one gets a thread that no exit ends."""
    return zenoh.handlers.Callback(handle, indirect=False)


def _answer_in(reply: zenoh.Reply, key: str) -> Any:
    """Return what the other end answered at a key, or raise what it answered with."""
    if reply.err is not None:
        text = reply.err.payload.to_string()
        raise LinkLostError(f"asking {key}: {text}")
    assert reply.ok is not None, "a reply that is no error holds a sample"
    return read_answer(reply.ok.payload.to_bytes(), key)


def _reply_to(query: zenoh.Query) -> Reply:
    key = str(query.key_expr)

    def reply(value: Any) -> None:
        try:
            query.reply(key, answer_of(value))
            # The other end waits until this one lets go of the query, which the last reference to
            # it might do much later.
            query.drop()  # type: ignore[no-untyped-call] # zenoh's stub says no more
        except zenoh.ZError as error:
            _log.debug("no one waits for the answer at %s any more: %s", key, error)

    return reply


class _wrapped:  # noqa: N801 - as those of contextlib; each message enters one
    """Raises as a LinkLostError what Zenoh raises in a step, which the text names."""

    __slots__ = ("_step",)

    def __init__(self, step: str) -> None:
        self._step = step

    def __enter__(self) -> None:
        pass

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, zenoh.ZError):
            text = _PLACE_IN_ZENOH.sub("", str(error)).rstrip(".")
            text = f"{self._step} failed: {text}"
            raise LinkLostError(text) from error


def configuration(
    address: str,
    *,
    listen: bool,
    timeout: float,
    lease: float,
    more: Mapping[str, object] = NO_MORE,
) -> zenoh.Config:
    """Return settings under which nothing is found by itself and nothing listens elsewhere."""
    full_microseconds = int(_FULL_SECONDS * 1e6)
    settings: dict[str, object] = {
        "mode": "router" if listen else "client",
        "listen/endpoints": [address] if listen else [],
        "connect/endpoints": [] if listen else [address],
        "connect/timeout_ms": int(timeout * 1000),
        "connect/retry": {
            "period_init_ms": _RETRY_MILLISECONDS,
            "period_max_ms": _RETRY_MILLISECONDS,
        },
        "scouting/delay": 0,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/unicast/open_timeout": int(timeout * 1000),
        "transport/link/tx/lease": int(lease * 1000),
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": full_microseconds,
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": (
            full_microseconds
        ),
        **more,
    }
    configuration: zenoh.Config = zenoh.Config()
    for name, value in settings.items():
        configuration.insert_json5(name, json.dumps(value))
    return configuration
