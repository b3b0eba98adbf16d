"""What bridges see now, and what can be had: all are asked at once, each within a limit.

When they are asked again, as candidates are looked for, is here, too.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from typing import TypeAlias, TypeVar

from attrs import define, evolve, field

from uoarm._interrupts import wait_until
from uoarm._raised import LimitedLog, sentence_of
from uoarm._resolve._catalogue import StructureCache, Unavailable
from uoarm._support import deadlines
from uoarm._support.workers import WorkerExecutor, WorkerPool
from uoarm.bridge import Bridge, Description, Discovered
from uoarm.errors import ResolutionError, UoarmError
from uoarm.model import (
    Availability,
    BridgeFindings,
    BridgeSpec,
    Component,
    Endpoint,
    FoundComponent,
    FoundPort,
    FunctionStatus,
    Options,
    Plan,
    Robot,
    Role,
    message_octets,
)

_REST = 4.0  # times what an answer, a round, or the question for one component took
_EVERY_SECONDS = 2.0
# Frameworks learn of each other after their start, ROS 2 within a second or two.
_SETTLE_SECONDS = 3.0
_SETTLE_EVERY = 0.25
_MOST_PORTS = 10_000
_MOST_OCTETS = 2_000_000
_log = logging.getLogger("uoarm")

T = TypeVar("T")
_Place: TypeAlias = tuple[str, Role, tuple[str, ...]]
_Known: TypeAlias = dict[_Place, list[tuple[T, Options]]]


# Never raised, so that they hold no frames: what is known of a bridge that sees nothing.
_CANNOT = UoarmError("cannot list components", error_code="UOA-403")
_NOT_YET = UoarmError("has not answered yet", error_code="UOA-408")


@define(eq=False)
class _Question:
    """What one bridge is asked, again and again.

    Attributes:
        answer: the last one: what it sees, why it sees nothing, or None before the first.
        missed: how many were no better than the one that is kept.
        begun: when it was asked last; once it has started, since then.
        rests_until: when it may be asked again.
    """

    spec: BridgeSpec
    answer: tuple[Discovered, ...] | UoarmError | None = None
    missed: int = 0
    is_under_way: bool = False
    begun: float = 0.0
    rests_until: float = -math.inf


class Discovery:
    """Asks bridges what they see; one that is slow holds up no caller that does not wait for it.

    A bridge is asked once at a time. One that was too slow for a look is listed as it answered
    last, and what it answers then is in a later look. With a grace, a bridge rests after each
    answer for four times as long as that took, and its start is not given up before the limit
    of starts: one that takes longer than an answer may would else be begun again and again. For
    one thread at a time, but for `close`.

    Args:
        kept: for how many answers a bridge that fails is listed as it answered last.

    Attributes:
        is_whole: whether every bridge had answered once at least by the end of the last look, or
            had had the time for it, which begins anew once it has started.
    """

    def __init__(self, get: Callable[[str], Bridge], kept: int = 0) -> None:
        self._records = LimitedLog(_log)
        self._get = get
        self._kept = kept
        self.is_whole = True
        self._questions: dict[str, _Question] = {}
        # Guards the questions: answers come in threads of the pool, each of which wakes the look
        # that waits.
        self._changed = threading.Condition()
        self._pool = WorkerPool("uoarm-discovery")

    def look(
        self, robot: Robot, timeout: float, grace: float | None = None
    ) -> tuple[BridgeFindings, ...]:
        """Return what each bridge of the configuration sees, in its order.

        Args:
            robot: the configuration.
            timeout: seconds for each bridge; without a grace its start is included.
            grace: seconds that the others have after the first answer, or from now where some
                bridge rests; None: all are waited for.
        """
        with self._changed:
            self._questions = {
                name: self._question(name, spec) for name, spec in robot.bridges.items()
            }
            asked = [
                question
                for name, question in self._questions.items()
                if question.is_under_way
                or self._ask(name, question, timeout, rests=grace is not None)
            ]

            def has_begun() -> bool:  # whether there is something to list
                return len(asked) < len(self._questions) or not all(
                    question.is_under_way for question in asked
                )

            if asked:
                wait_until(self._changed, has_begun, None if grace is None else timeout)
                wait_until(
                    self._changed,
                    lambda: not any(question.is_under_way for question in asked),
                    grace,
                )
            answers = {name: question.answer for name, question in self._questions.items()}
            now = time.monotonic()
            self.is_whole = all(
                question.answer is not None or now >= question.begun + timeout
                for question in self._questions.values()
            )
        users = _users(robot)
        return tuple(
            _findings(name, robot.bridges[name].plugin, answer, users)
            for name, answer in answers.items()
        )

    def close(self) -> None:
        """Ask no bridge any more; what is under way goes on, within its limit. Idempotent."""
        self._pool.close()

    def _question(self, name: str, spec: BridgeSpec) -> _Question:
        known = self._questions.get(name)
        return known if known is not None and known.spec == spec else _Question(spec)

    def _ask(self, name: str, question: _Question, timeout: float, *, rests: bool) -> bool:
        """Ask a bridge, unless it may rest and does; say whether it is asked."""

        def ask() -> tuple[Discovered, ...] | None:
            if rests:
                self._get(name)
            return deadlines.run(f"discovery by bridge {name!r}", timeout, see)

        def see() -> tuple[Discovered, ...] | None:
            bridge = self._get(name)
            question.begun = time.monotonic()
            return _seen_by(bridge, timeout)

        def done(found: tuple[Discovered, ...] | None, error: BaseException | None) -> None:
            with self._changed:
                self._take(question, found, error)
                ended = time.monotonic()
                question.rests_until = ended + _REST * (ended - question.begun)
                question.is_under_way = False
                self._changed.notify_all()

        question.begun = time.monotonic()
        if not rests or question.begun >= question.rests_until:
            question.is_under_way = self._pool.submit(ask, done=done)
        return question.is_under_way

    def _take(
        self,
        question: _Question,
        found: tuple[Discovered, ...] | None,
        error: BaseException | None,
    ) -> None:
        if error is None:
            question.answer = _CANNOT if found is None else found
            question.missed = 0
            return
        if not isinstance(error, UoarmError):
            self._records.write(logging.ERROR, "discovery failed", error)
        question.missed += 1
        if isinstance(question.answer, UoarmError | None) or question.missed > self._kept:
            error_code = error.error_code if isinstance(error, UoarmError) else "UOA-409"
            text = sentence_of(error)
            question.answer = UoarmError(text, error_code=error_code)


def _users(robot: Robot) -> _Known[str]:
    users: _Known[str] = {}
    for component in robot.components():
        services = () if component.service is None else (component.service,)
        for port in (*component.inputs, *component.outputs, *services):
            users.setdefault(_place(port.endpoint), []).append(
                (component.name, component.parameters)
            )
    return users


def _listed(
    endpoints: Iterable[Endpoint], places: Container[_Place]
) -> dict[_Place, list[Options]]:
    """Return with which parameters frameworks list what is at these places."""
    listed: dict[_Place, list[Options]] = {}
    for endpoint in endpoints:
        if _place(endpoint) in places:
            listed.setdefault(_place(endpoint), []).append(endpoint.parameters)
    return listed


def _in_full(known: _Known[T], endpoints: Iterable[Endpoint]) -> _Known[T]:
    """Return what is known by the places that frameworks list.

    An address may leave out its last part, such as the type: it is the only listed one with that.
    """
    listed = {_place(endpoint) for endpoint in endpoints}
    longer: dict[_Place, list[_Place]] = {}
    for bridge, role, address in listed:
        longer.setdefault((bridge, role, address[:-1]), []).append((bridge, role, address))
    made: _Known[T] = {}
    for place, items in known.items():
        fitting = [] if place in listed else longer.get(place, [])
        made.setdefault(fitting[0] if len(fitting) == 1 else place, []).extend(items)
    return made


def _those_at(
    endpoint: Endpoint, listed: Mapping[_Place, list[Options]], known: _Known[T]
) -> Iterator[T]:
    """Yield what is known of an endpoint that is seen.

    Args:
        endpoint: one of several that may be at one place, with parameters that differ.
        listed: these parameters.
        known: of the configuration; what has the parameters of another entry is about that one.
    """
    place = _place(endpoint)
    for item, parameters in known.get(place, ()):
        if parameters == endpoint.parameters or parameters not in listed[place]:
            yield item


def _seen_by(bridge: Bridge, timeout: float) -> tuple[Discovered, ...] | None:
    if not bridge.capabilities.discover:
        return None
    return bridge.discover(timeout=timeout)


def _findings(
    bridge: str,
    plugin: str,
    found: tuple[Discovered, ...] | UoarmError | None,
    users: _Known[str],
) -> BridgeFindings:
    if found is None or isinstance(found, UoarmError):
        none = found or _NOT_YET
        return BridgeFindings(bridge, plugin, cause=str(none), error_code=none.error_code)
    components: list[FoundComponent] = []
    left, too_large = _MOST_PORTS, 0
    ends = [end for discovered in found for end, _ in discovered.endpoints]
    users = _in_full(users, ends)
    listed = _listed(ends, users)
    for discovered in sorted(found, key=lambda item: item.name):
        taken = discovered.endpoints[: max(0, left)]
        left -= len(discovered.endpoints)
        bounded = [(end, said) for end, said in taken if not _is_too_large(said)]
        too_large += len(taken) - len(bounded)
        ports = tuple(
            FoundPort(
                endpoint,
                said.message,
                said.request,
                said.reply,
                tuple(dict.fromkeys(_those_at(endpoint, listed, users))),
                _stated(discovered, endpoint),
            )
            for endpoint, said in bounded
        )
        if ports or not discovered.endpoints:
            components.append(FoundComponent(discovered.name, ports, discovered.detail))
    return BridgeFindings(bridge, plugin, tuple(components), left_out=max(0, -left) + too_large)


def _is_too_large(said: Description) -> bool:
    """Say whether a port's structures are more than a robot's configuration may be made of."""
    reports = [item.schema for item in (said.message, said.request, said.reply) if item is not None]
    return message_octets(reports, most=_MOST_OCTETS) > _MOST_OCTETS


def _stated(component: Discovered, endpoint: Endpoint) -> float | None:
    rate = component.rates.get(endpoint.port) if endpoint.role is Role.OUTPUT else None
    return rate if rate is not None and 0 < rate < math.inf else None


def with_rates(
    findings: tuple[BridgeFindings, ...], rates: Mapping[str, float], robot: Robot
) -> tuple[BridgeFindings, ...]:
    """Return findings with the rates at which what is open gives messages now.

    Args:
        findings: what bridges see.
        rates: messages a second, by component and output, `head_camera.default`.
        robot: the configuration in force, which says where these are.
    """
    if not rates:
        return findings
    measured: _Known[float] = {}
    for component in robot.components():
        for output in component.outputs:
            if (rate := rates.get(f"{component.name}.{output.name}")) is not None:
                known = measured.setdefault(_place(output.endpoint), [])
                known.append((rate, component.parameters))
    seen = (component for finding in findings for component in finding.components)
    ends = [port.endpoint for component in seen for port in component.ports]
    measured = _in_full(measured, ends)
    listed = _listed(ends, measured)

    def port_with(port: FoundPort) -> FoundPort:
        rate = next(_those_at(port.endpoint, listed, measured), None)
        return port if rate is None else evolve(port, rate=rate, is_measured=True)

    return tuple(
        evolve(
            finding,
            components=tuple(
                evolve(component, ports=tuple(map(port_with, component.ports)))
                for component in finding.components
            ),
        )
        for finding in findings
    )


def _place(endpoint: Endpoint) -> _Place:
    return endpoint.bridge, endpoint.role, endpoint.address


_AT_ONCE = 16


def check_availability(
    robot: Robot, structures: StructureCache, resolve: Callable[[str], Plan]
) -> tuple[FunctionStatus, ...]:
    """Ask for every component, several at once, and resolve every function.

    Blocks as long as the slowest bridge takes to answer; each answer has its limit.
    """

    def ask(component: Component) -> Availability:
        answer = structures.structures(component)
        found = component.name, component.bridge, component.priority
        if isinstance(answer, Unavailable):
            return Availability(*found, answer.sentence)
        return Availability(*found, notes=answer.warnings)

    with WorkerExecutor("uoarm-availability", _AT_ONCE) as pool:
        found = {
            availability.component: availability
            for availability in pool.map(ask, robot.components())
        }
    return tuple(
        _judge(name, tuple(found[item.name] for item in function.components), resolve)
        for name, function in robot.functions.items()
    )


def _judge(
    name: str, candidates: tuple[Availability, ...], resolve: Callable[[str], Plan]
) -> FunctionStatus:
    try:
        plan = resolve(name)
    except ResolutionError as error:
        return FunctionStatus(name, None, candidates, str(error))
    return FunctionStatus(name, plan.provider.component.name, candidates)


@define(eq=False)
class DiscoveryRounds:
    """When bridges are asked, and when all of that is known which can be expected.

    Attributes:
        matched: the configuration that has its candidates.
    """

    matched: Robot | None = None
    _settling: Robot | None = field(default=None, init=False)
    _settles_at: float = field(default=0.0, init=False)

    def ended(
        self, base: Robot, begun: float, now: float, *, is_whole: bool, has_all: bool
    ) -> float:
        """Note a round; return the seconds until the next one.

        Args:
            base: the configuration that it was for.
            begun: when it began.
            now: when it ended.
            is_whole: whether every bridge has answered, now or before.
            has_all: whether every function with needs has a candidate.
        """
        if self._settling is not base or not is_whole:  # the last one may have just started
            self._settling, self._settles_at = base, now + _SETTLE_SECONDS
        is_settled = is_whole and (now >= self._settles_at or has_all)
        if not is_settled:
            return _SETTLE_EVERY  # requests wait, and rounds in which hosts start are long
        self.matched = base
        return max(_EVERY_SECONDS, _REST * (now - begun))


class UndescribedComponents:
    """Components whose structures were not to be had lately: each is asked again after a rest.

    For one that is not there a bridge waits as long as it may, and no round ends meanwhile. As
    rounds do, asking for one component takes a fifth of the time at most.
    """

    def __init__(self) -> None:
        self._base: Robot | None = None
        self._found: dict[str, tuple[Unavailable, float]] = {}

    def known(self, base: Robot, name: str, now: float) -> Unavailable | None:
        """Return why a component's structures were not to be had, until it is to be asked again."""
        if base is not self._base:
            self._base, self._found = base, {}
        found, due = self._found.get(name, (None, now))
        return found if now < due else None

    def note(self, name: str, found: Unavailable, begun: float, now: float) -> None:
        """Note why a component's structures were not to be had; it was asked at `begun`."""
        self._found = {key: kept for key, kept in self._found.items() if now < kept[1]}
        self._found[name] = found, now + _REST * (now - begun)
