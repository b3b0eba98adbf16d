# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""The components in all naming services of a bridge: by path, alive or not, with their structures.

`Directory` finds components, `DirectoryMonitor` reports which came and left, and `discovered`
lists what is visible now with endpoints and structures.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import TypeVar

from attrs import define, field
from omniORB import CORBA

from uoarm.bridge import Description, Discovered, WorkerExecutor, did_you_mean
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Endpoint, Health, Role
from uoarm_rtm._control import DESCRIPTIONS, limits
from uoarm_rtm._naming import Name, NamingService
from uoarm_rtm._orb import calls, corba_errors, limit
from uoarm_rtm._peer import PeerComponent, PeerPort, contexts_of, peer_at, state_of
from uoarm_rtm._services import described
from uoarm_rtm._types import Types
from uoarm_rtm._watch import Check

T = TypeVar("T")
Answer = TypeVar("Answer")

_AT_ONCE = 8
_SUFFIX = ".rtc"


class Directory:
    """Finds components. Used from any thread.

    Args:
        services: naming services, asked in this order; those that hung last, at the end.
        seconds: limit of one call.
    """

    def __init__(self, services: Sequence[NamingService], seconds: float) -> None:
        self.services = services
        self._seconds = seconds
        self._hung: set[NamingService] = set()

    def peer(self, path: str) -> PeerComponent:
        """Return the component at a path, or the only one whose path ends so.

        Raises:
            BridgeError: NOT_FOUND, also for two that are alive; UNAVAILABLE when it is dead or
                no naming service answers.
            BridgeTimeoutError: it hangs.
        """
        # One that hung takes a whole limit: it is asked where the others do not know the path.
        answering = [service for service in self.services if service not in self._hung]
        found: Name | None = None
        if 0 < len(answering) < len(self.services):
            with contextlib.suppress(BridgeError):
                found = self._find(path, answering)
        found = found or self._find(path, self.services)
        return peer_at(found.path, found.reference, self._seconds)

    def _find(self, path: str, services: Sequence[NamingService]) -> Name:
        failures = []
        for service in services:
            try:
                with self._noting(service):
                    reference = service.resolve(path)
            except BridgeError as error:
                if error.reason is FailureReason.BAD_ENDPOINT:
                    return self._below(path, services, error)  # a plain way of writing, perhaps
                failures.append(error)
                continue
            if reference is not None:
                return Name(path, reference)
        if len(failures) == len(services):
            raise failures[0]
        return self._below(path, services)

    @contextlib.contextmanager
    def _noting(self, service: NamingService) -> Iterator[None]:
        """Note whether a naming service hangs as it is asked; a refusal comes at once."""
        hangs = False
        try:
            yield
        except BridgeTimeoutError:
            hangs = True
            raise
        finally:
            (self._hung.add if hangs else self._hung.discard)(service)

    def _names(self, services: Sequence[NamingService]) -> dict[str, Name]:
        answers = self._at_once(self._asked, services)
        failures = [answer for answer in answers if isinstance(answer, BridgeError)]
        if len(failures) == len(services):
            raise failures[0]
        names: dict[str, Name] = {}
        for answer in answers:
            if not isinstance(answer, BridgeError):
                names = {**answer, **names}
        return names

    def names_in(self, service: NamingService, before: Iterable[Name] = ()) -> dict[str, Name]:
        """Return the name of every component in a naming service by its path.

        Args:
            service: that is asked.
            before: as of `NamingService.names`.

        Raises:
            BridgeError: it does not answer.
        """
        with self._noting(service):
            names = service.names(before)
        return {name.path: name for name in names if name.path.endswith(_SUFFIX)}

    def _asked(self, service: NamingService) -> dict[str, Name] | BridgeError:
        try:
            return self.names_in(service)
        except BridgeError as error:
            return error

    def _at_once(self, ask: Callable[[T], Answer], asked: Collection[T]) -> tuple[Answer, ...]:
        """Ask several: one that hangs holds up no other."""
        if len(asked) < 2:  # noqa: PLR2004
            return tuple(map(ask, asked))
        try:
            with WorkerExecutor("uoarm-rtm-look", _AT_ONCE) as pool:
                return tuple(pool.map(ask, asked))
        except RuntimeError as error:  # no thread can begin any more
            raise BridgeError("this process is ending", FailureReason.CLOSED) from error

    def _conditions(self, services: Sequence[NamingService]) -> list[tuple[Name, str]]:
        """Return every component's name with its condition; silent services are left out.

        Raises:
            BridgeError: no naming service answers.
        """
        names = self._names(services).values()
        return list(zip(names, self._at_once(self.condition, names), strict=True))

    def peers(self) -> tuple[tuple[PeerComponent, ...], tuple[tuple[str, str], ...]]:
        """Return the components that answer, and (path, what is wrong) of those that do not."""
        found: list[PeerComponent] = []
        silent = []
        for name, condition in self._conditions(self.services):
            if condition != "alive":
                silent.append((name.path, condition))
                continue
            try:
                found.append(peer_at(name.path, name.reference, self._seconds))
            except BridgeError as error:
                silent.append((name.path, str(error)))
        return tuple(found), tuple(silent)

    def condition(self, name: Name) -> str:
        """Return what stands behind a name, `alive`, `dead` or `hung`, which takes its time."""
        try:
            with calls:
                gone = limit(name.reference, self._seconds)._non_existent()
        except CORBA.TIMEOUT:
            return "hung"
        except CORBA.Exception:
            gone = True
        return "dead" if gone else "alive"

    def _below(
        self, path: str, services: Sequence[NamingService], unreadable: BridgeError | None = None
    ) -> Name:
        """Return the component of this name in any context, or at this path written plainly.

        CORBA writes a dot within a step with a backslash before it; people write `x.y.host_cxt`.
        """
        plain = path.replace("\\", "")
        every = self._conditions(services)
        seen = [
            (name, condition)
            for name, condition in every
            if name.path.split("/")[-1] == path or name.path.replace("\\", "") == plain
        ]
        alive = [name for name, condition in seen if condition == "alive"]
        if len(alive) == 1:
            return alive[0]
        where = ", ".join(service.address for service in self.services)
        if alive:
            paths = ", ".join(name.path for name in alive)
            text = f"component {path!r} is there several times: {paths}; give one whole path"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        for name, condition in seen:
            if condition == "hung":
                raise BridgeTimeoutError(f"component {name.path!r} does not answer")
        if seen:
            text = f"component {seen[0][0].path!r} is dead: only its name is left"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if unreadable is not None:
            raise unreadable
        meant = did_you_mean(path, [name.path for name, _ in every])
        text = f"there is no component {path!r} in {where}{meant}"
        raise BridgeError(text, FailureReason.NOT_FOUND)


_ROLES = {"DataOutPort": Role.OUTPUT, "DataInPort": Role.INPUT}


def discovered(
    bridge: str, directory: Directory, types: Types, seconds: float
) -> tuple[Discovered, ...]:
    """Return every component that has a name; those that do not answer have no endpoints."""
    peers, silent = directory.peers()
    found = [_component(bridge, peer, types, seconds) for peer in peers]
    for path, condition in silent:
        found.append(Discovered(path, (), condition))
    return tuple(sorted(found, key=lambda component: component.name))


def _component(bridge: str, peer: PeerComponent, types: Types, seconds: float) -> Discovered:
    endpoints: list[tuple[Endpoint, Description]] = []
    state, rate = _state(peer, seconds)
    remarks = [f"{peer.type_name}, {state}"]
    for port in peer.ports:
        role = _ROLES.get(port.kind)
        if role is None:
            continue
        address = (peer.path, port.name, port.data_type)
        description, remark = _description(port, types)
        remarks += [remark] if remark else []
        endpoints.append((Endpoint(bridge, peer.path, role, address, port=port.name), description))
    for port in peer.ports:
        for interface in port.interfaces:
            if interface.provided:
                address = (peer.path, port.name, interface.type)
                description, remark = _service(interface.type, types)
                remarks += [remark] if remark else []
                endpoint = Endpoint(bridge, peer.path, Role.SERVICE, address, port=port.name)
                endpoints.append((endpoint, description))
    with contextlib.suppress(BridgeError):  # it has none, or the state says why
        parameters = limits(peer, seconds)
        remarks += [f"parameters {parameters}"] if parameters else []
    for name, description in DESCRIPTIONS.items():
        endpoint = Endpoint(bridge, peer.path, Role.SERVICE, (peer.path, name), port=name)
        endpoints.append((endpoint, description))
    outputs = [port.name for port in peer.ports if _ROLES.get(port.kind) is Role.OUTPUT]
    rates = {} if rate is None else dict.fromkeys(outputs, rate)
    return Discovered(peer.path, tuple(endpoints), "; ".join(remarks), rates)


def _description(port: PeerPort, types: Types) -> tuple[Description, str]:
    if port.takes_events:
        return Description(), f"port {port.name!r} takes the events of a state machine"
    try:
        return Description(message=types.structure(port.data_type)), ""
    except BridgeError as error:
        return Description(), str(error)


def _service(type_name: str, types: Types) -> tuple[Description, str]:
    try:
        return described(*types.interface(type_name)), ""
    except BridgeError as error:
        return Description(), str(error)


def _state(peer: PeerComponent, seconds: float) -> tuple[str, float | None]:
    """Return the state in words, and how often a second its execution context runs it."""
    try:
        contexts = contexts_of(peer, seconds)
        text = f"{state_of(peer, seconds)}, {len(contexts)} execution context"
    except BridgeError as error:
        return str(error), None
    rate: float | None = None
    with contextlib.suppress(BridgeError), corba_errors(f"component {peer.path!r}: its rate"):
        rate = float(contexts[0].get_rate()) if contexts else None
    return text + "s"[: len(contexts) != 1], rate or None  # 0: when something happens


@define(eq=False)
class _WatchedName:
    """A name, and what was found behind it; None: it was not looked at yet.

    Attributes:
        is_known: whether it was there from the beginning, which is no news.
        is_dead: nothing was behind it at the last look.
        unconfirmed: naming services to be read before it counts as dead. One that leaves ends its
            name before itself: that it died is reported when the name is still there after that.
    """

    owner: DirectoryMonitor
    name: Name
    is_known: bool
    condition: str | None = None
    is_dead: bool = False
    unconfirmed: set[_WatchedService] = field(factory=set)

    def check(self) -> None:
        """Look at what is behind it, and report what has changed."""
        self.owner.look(self)


@define(eq=False)
class _WatchedService:
    """A naming service, and what it says; one that hangs holds up no other.

    Attributes:
        names: that it gave last; None: it was not asked yet.
        failure: why it does not answer, "" where it does.
    """

    owner: DirectoryMonitor
    service: NamingService
    names: Mapping[str, Name] | None = None
    failure: str = ""

    def check(self) -> None:
        """Read its names, and report what has changed."""
        self.owner.read(self)


@define(eq=False)
class DirectoryMonitor:
    """Which components are there, compared with before. Each is looked at on its own.

    Args:
        own: path to leave out: the bridge's own component.
        follow: has a check made next.
    """

    _directory: Directory
    _report: Callable[..., None]
    _own: str
    _follow: Callable[[Check], None]
    _services: list[_WatchedService] = field(init=False)
    # Guards all below, the names of each service, and the conditions of names, from checks in
    # other threads. Never held while a component is called, nor while something is reported:
    # one thread at a time reports, so that nothing is overtaken by what was true before it.
    _guard: threading.Lock = field(factory=threading.Lock, init=False)
    _names: dict[str, _WatchedName] | None = field(default=None, init=False)
    _is_unreachable: bool = field(default=False, init=False)
    _is_reporting: bool = field(default=False, init=False)
    _waiting: deque[tuple[Health, str, str]] = field(factory=deque, init=False)

    @_services.default
    def _all_services(self) -> list[_WatchedService]:
        return [_WatchedService(self, service) for service in self._directory.services]

    def checks(self) -> list[Check]:
        """Return the checks of a round: each naming service, and each name that is known."""
        with self._guard:
            names = [watched.check for watched in (self._names or {}).values()]
        return [*[watched.check for watched in self._services], *names]

    def read(self, watched: _WatchedService) -> None:
        """Read the names in a naming service; what is new is looked at next.

        What was there and has left is reported; the first time nothing is.
        """
        with self._guard:  # those that were dead before the names are read
            every = (self._names or {}).values()
            doubtful = [known for known in every if watched in known.unconfirmed]
        failure = ""
        try:
            before = (watched.names or {}).values()
            names: Mapping[str, Name] = self._directory.names_in(watched.service, before)
        except BridgeError as error:
            # A naming service that is gone says nothing of the components.
            failure, names = str(error), watched.names or {}
        with self._guard:
            is_first, watched.names, watched.failure = watched.names is None, names, failure
            self._judge_services(failure)
            fresh, changes = self._compare(is_known=is_first)
            for known in doubtful:
                known.unconfirmed.discard(watched)
                if known.is_dead and not known.unconfirmed:
                    path, was = known.name.path, known.condition
                    if (self._names or {}).get(path) is known:
                        known.condition = "dead"
                        changes.append((path, was, "dead"))
            for path, was, is_now in changes:
                if was != is_now:
                    self._note_change(path, was, is_now)
        for known in fresh:
            self._follow(known.check)
        self._say()

    def _judge_services(self, failure: str) -> None:
        """Note that no naming service answers, or that one does again."""
        is_unreachable = all(watched.failure for watched in self._services)
        if is_unreachable and not self._is_unreachable:
            self._waiting.append((Health.DEGRADED, failure, ""))
        elif self._is_unreachable and not is_unreachable:
            self._waiting.append((Health.OK, "a naming service answers again", ""))
        self._is_unreachable = is_unreachable

    def _compare(
        self, *, is_known: bool
    ) -> tuple[list[_WatchedName], list[tuple[str, str | None, str | None]]]:
        """Take the names of all services; return those to be looked at, and what has left."""
        names: dict[str, Name] = {}
        for service in self._services:
            names = {**(service.names or {}), **names}
        names.pop(self._own, None)
        before = self._names or {}
        self._names = {
            path: self._watched(name, before.get(path), is_known=is_known)
            for path, name in names.items()
        }
        fresh = [watched for watched in self._names.values() if watched.condition is None]
        left = sorted(before.keys() - names.keys())
        return fresh, [(path, before[path].condition, None) for path in left]

    def look(self, watched: _WatchedName) -> None:
        """Find out what is behind a name now, and report it where that has changed."""
        path = watched.name.path
        is_now = self._directory.condition(watched.name)
        with self._guard:
            if (self._names or {}).get(path) is not watched:
                return  # it has left, or is another component's now
            was, watched.is_dead = watched.condition, is_now == "dead"
            watched.unconfirmed.clear()
            if watched.is_dead and was in {"alive", "hung"}:
                holding = (service for service in self._services if path in (service.names or {}))
                watched.unconfirmed.update(holding)
            else:
                watched.condition = is_now
                if was != is_now and not (was is None and watched.is_known):
                    self._note_change(path, was, is_now)
            unconfirmed = tuple(watched.unconfirmed)
        for service in unconfirmed:
            self._follow(service.check)
        self._say()

    def _watched(self, name: Name, known: _WatchedName | None, *, is_known: bool) -> _WatchedName:
        """Return the entry of a name; another one where it stands for another component now."""
        if known is None:
            return _WatchedName(self, name, is_known)
        if known.name.reference._is_equivalent(name.reference):
            return known
        return _WatchedName(self, name, known.is_known, known.condition)

    def _note_change(self, path: str, was: str | None, is_now: str | None) -> None:
        if is_now == "alive":
            word = "answers again" if was == "hung" else "appeared"
            self._waiting.append((Health.OK, f"component {path} {word}", path))
        elif is_now == "hung":
            text = f"component {path} does not answer: it hangs"
            self._waiting.append((Health.LOST, text, path))
        elif was in {"alive", "hung"}:
            end = "left" if is_now is None else "died: only its name is left"
            self._waiting.append((Health.LOST, f"component {path} {end}", path))

    def _say(self) -> None:
        """Report what waits, in its order."""
        while True:
            with self._guard:
                if self._is_reporting or not self._waiting:
                    return
                self._is_reporting = True
                health, cause, component = self._waiting.popleft()
            try:
                self._report(health, cause, component=component or None)
            finally:
                with self._guard:
                    self._is_reporting = False
