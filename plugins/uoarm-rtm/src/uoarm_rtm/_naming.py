# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""One naming service: reading its whole tree, finding and binding names.

Every call has the time limit given, and every list an end: a service may be hung, or hold
contexts that contain each other.
"""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable, Iterable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import CosNaming
from attrs import frozen
from omniORB import CORBA, URI

from uoarm.bridge import Log, reason_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm_rtm._orb import MOST_CONNECTIONS, Orb, corba_errors, limit, narrowed

_log = Log("uoarm.rtm")
_BATCH = 200
_MOST_NAMES = 10_000
_MOST_CONTEXTS = 1_000
_DEEPEST = 16
_LAST_PORT = 65_535
_UNUSABLE = 0x4F4D0002  # of CORBA's TRANSIENT: no profile of a reference can be used
_PLACE = re.compile(r"corbaloc:(?:iiop)?:(?:[\d.]+@)?(\[[^\]]*\]|[^:/,]+)")
_MOST_SECONDS = 60.0  # for all of it: each answer may come just within its own limit
_HOST = re.compile(r"[\w.\-]+(:\d{1,5})?|\[[0-9a-fA-F:]+\](:\d{1,5})?")


Asked = ParamSpec("Asked")
Answer = TypeVar("Answer")


@frozen
class Name:
    """One object bound in a naming service, as `context.kind/NAME.rtc`."""

    path: str
    reference: Any


def corbaloc(address: str) -> str:
    """Return the corbaloc of a naming service given as that, as an IOR or as `host:port`.

    Raises:
        ValueError: it is none of these.
    """
    if "ssliop" in address:
        text = "GIOP over TLS (ssliop) is not spoken here: expected corbaloc::HOST:PORT/NameService"
        raise ValueError(f"{text}, on loopback or a network of its own; got {address!r}")
    if address.startswith(("corbaloc:", "corbaname:", "IOR:")):
        return address
    found = _HOST.fullmatch(address)
    if found is None or int((found[1] or found[2] or ":1")[1:]) > _LAST_PORT:
        raise ValueError(f"expected corbaloc::HOST:PORT/NameService or HOST:PORT, got {address!r}")
    if not re.search(r":\d{1,5}$", address):
        address += ":2809"
    return f"corbaloc:iiop:{address}/NameService"


def path_of(name: Any) -> str:
    """Return a CORBA name as text; dots and slashes inside a step are escaped.

    Components in C++ send the octets of UTF-8 as if each were a character of Latin-1.
    """
    text = str(URI.nameToString(name))
    try:
        return text.encode("latin-1").decode()
    except UnicodeError:
        return text


def _afresh(ask: Callable[Asked, Answer]) -> Callable[Asked, Answer]:
    """Have a method ask again where a connection turns out to be stale.

    A connection to a service that was restarted fails with the first call through it, and then
    gives way to a new one; a service that is gone refuses the new one, which is no COMM_FAILURE.
    """

    @wraps(ask)
    def asked(*arguments: Asked.args, **named: Asked.kwargs) -> Answer:
        for _ in range(MOST_CONNECTIONS):
            try:
                return ask(*arguments, **named)
            except BridgeError as error:
                if not isinstance(error.__cause__, CORBA.COMM_FAILURE):
                    raise
        return ask(*arguments, **named)

    return asked


class NamingService:
    """A naming service at one address; nothing is called before it is used.

    Every method raises BridgeError when the service is gone, BridgeTimeoutError when it hangs.
    What they ask may be asked twice, and is, where the service has been restarted meanwhile.

    Args:
        address: corbaloc, IOR or `host:port`.
        seconds: limit of one call.
    """

    def __init__(self, orb: Orb, address: str, seconds: float) -> None:
        self.address = address
        self._orb = orb
        self._corbaloc = corbaloc(address)
        self._seconds = seconds
        self._what = f"naming service {address}"
        self._is_cut = False

    @_afresh
    def names(self, before: Iterable[Name] = ()) -> list[Name]:
        """Return every object bound below the root, contexts aside.

        Args:
            before: what was there, and is still where a context of another naming service is gone.
        """
        found: list[Name] = []
        gone: list[str] = []
        self._walk(self._root(), (), found, [], gone, time.monotonic() + _MOST_SECONDS)
        there = {name.path for name in found} if gone else set()
        found += [
            name for name in before if name.path.startswith(tuple(gone)) and name.path not in there
        ]
        is_cut = len(found) >= _MOST_NAMES
        if is_cut and not self._is_cut:
            _log.warning("%s: only %s of its names are seen", self._what, f"{_MOST_NAMES:,}")
        self._is_cut = is_cut
        return found[:_MOST_NAMES]

    @_afresh
    def resolve(self, path: str) -> Any:
        """Return the object bound at a path, None when there is none.

        Raises:
            BridgeError: BAD_ENDPOINT when the path cannot be read.
        """
        name = self._name(path)
        with corba_errors(f"{self._what}: resolving {path!r}"):
            try:
                return limit(self._root().resolve(name), self._seconds)
            except (CosNaming.NamingContext.NotFound, CosNaming.NamingContext.CannotProceed):
                return None
            except CORBA.DATA_CONVERSION:
                return None  # not a character of Latin-1: a name as it is shown, not as it is sent
            except CosNaming.NamingContext.InvalidName:
                text = f"{self._what}: {path!r} is not a name"
                raise BridgeError(text, FailureReason.BAD_ENDPOINT) from None

    @_afresh
    def bind(self, path: str, reference: Any) -> None:
        """Bind an object, in place of whatever is bound there; contexts on the way are made."""
        name = self._name(path)
        with corba_errors(f"{self._what}: binding {path!r}"):
            context = self._root()
            for step in name[:-1]:
                context = self._inner(context, step)
            context.rebind(name[-1:], reference)

    @_afresh
    def unbind(self, path: str, reference: Any) -> None:
        """Remove a name, if it still stands for this object."""
        name = self._name(path)
        with corba_errors(f"{self._what}: unbinding {path!r}"):
            try:
                root = self._root()
                bound = root.resolve(name)
                if bound is not None and bound._is_equivalent(reference):
                    root.unbind(name)
            except CosNaming.NamingContext.NotFound:
                return

    def _root(self) -> Any:
        # Resolved anew each time: a service that came back empty has another root.
        reference = self._orb.reference(self._corbaloc)
        try:
            return narrowed(reference, CosNaming.NamingContext, self._seconds, self._what)
        except BridgeError as error:
            if not isinstance(error.__cause__, CORBA.TRANSIENT):
                raise
            text = self._unknown_host(error.__cause__.minor)
            text = text or f"{error}; does one run there, such as `uoarm rtm nameserver`?"
            raise BridgeError(text, error.reason) from error.__cause__

    def _unknown_host(self, minor: int) -> str:
        """Say that there is no such host, of which CORBA says that no profile can be used."""
        found = _PLACE.match(self._corbaloc)
        if minor != _UNUSABLE or found is None:
            return ""
        try:
            socket.getaddrinfo(found[1].strip("[]"), None)
        except OSError as error:
            return f"{self._what}: {reason_of(error)}"
        return ""

    def _name(self, path: str) -> Any:
        try:
            return URI.stringToName(path)
        except CORBA.Exception:
            text = f"{self._what}: {path!r} is not a name such as host.host_cxt/Camera0.rtc"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT) from None

    def _inner(self, context: Any, step: Any) -> Any:
        try:
            inner = context.bind_new_context([step])
        except CosNaming.NamingContext.AlreadyBound:
            inner = context.resolve([step])
        what = f"{self._what}: context {path_of([step])!r}"
        return narrowed(inner, CosNaming.NamingContext, self._seconds, what)

    def _walk(
        self,
        context: Any,
        path: tuple[Any, ...],
        found: list[Name],
        seen: list[Any],
        gone: list[str],
        until: float,
    ) -> None:
        # Contexts that contain no name, and always new ones, would not end by the number of names.
        is_over = len(path) >= _DEEPEST or len(seen) >= _MOST_CONTEXTS
        if is_over or any(known._is_equivalent(context) for known in seen):
            return
        seen.append(context)
        for binding in self._bindings(context, until):
            if len(found) >= _MOST_NAMES:
                return
            self._require_time(until)
            name = (*path, *binding.binding_name)
            with corba_errors(f"{self._what}: resolving {path_of(list(name))!r}"):
                try:
                    reference = context.resolve(binding.binding_name)
                except CosNaming.NamingContext.NotFound:
                    continue
            if binding.binding_type == CosNaming.nobject:
                found.append(Name(path_of(list(name)), limit(reference, self._seconds)))
                continue
            what = f"{self._what}: context {path_of(list(name))!r}"
            try:
                inner = narrowed(reference, CosNaming.NamingContext, self._seconds, what)
                self._walk(inner, name, found, seen, gone, until)
            except BridgeError:
                # A context of another naming service may be gone. Where this one is, or hangs, it
                # says nothing of what is bound there.
                self._require_time(until)
                self._root()
                gone.append(f"{path_of(list(name))}/")

    def _bindings(self, context: Any, until: float) -> list[Any]:
        with corba_errors(f"{self._what}: listing names"):
            bindings, rest = context.list(_BATCH)
            while rest is not None:
                limit(rest, self._seconds)
                more, batch = rest.next_n(_BATCH)
                bindings += batch
                # One that has more, and gives none, would be asked for ever.
                if not (more and batch) or len(bindings) >= _MOST_NAMES:
                    rest.destroy()
                    break
                self._require_time(until)
        return list(bindings)

    def _require_time(self, until: float) -> None:
        if time.monotonic() > until:
            text = f"{self._what}: listing its names takes longer than {_MOST_SECONDS:g} s"
            raise BridgeTimeoutError(text)
