"""The configuration in force, those before it, and what another one would mean for connections."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Container, Iterable, Iterator
from collections.abc import Set as AbstractSet
from contextlib import contextmanager

from attrs import evolve, field, frozen

from uoarm import _lock
from uoarm._adapt import check_edge
from uoarm._bridges import BridgeSet, StagedBridges
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.move import forget_earlier, recently
from uoarm._control.engine.state import ConnectionRecord, State
from uoarm._control.live.parts import StateOwner
from uoarm._dataplane import Clock
from uoarm._raised import LimitedLog, on_failure
from uoarm._resolve import (
    Hold,
    Resolver,
    StructureCache,
    Unavailable,
    carry_candidates,
    find_replacement,
    reachable_components,
    reachable_functions,
    without_candidates,
)
from uoarm._support.ordered import OrderedMap
from uoarm.config import ConfigurationDifference, compare
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    ConfigurationError,
    PluginError,
    ResolutionError,
    UoarmError,
    UsageError,
)
from uoarm.model import (
    Component,
    ConfigurationChange,
    ConnectionEffect,
    Effect,
    Offer,
    Plan,
    Robot,
)

_log = logging.getLogger("uoarm")
_records = LimitedLog(_log)

_KEPT = 100
_LEAST = 2  # the one in force, and the one to go back to
_KEPT_OCTETS = 32 * 2**20
_ENTRY_OCTETS = 3000  # of a bridge or a function with a component, as measured
_ANEW = (
    "other machines must join anew at the same address; without failover: {wait: SECONDS} it is "
    "not waited for them. `hosts` can have another address beside, and a machine whose "
    "certificate was in the folder when the manager began to listen can join at this one"
)


@frozen(eq=False)
class Revision:
    """One configuration, and what resolves in it.

    Attributes:
        number: how many changes led to it. Candidates that come and go are none.
        robot: the configuration with the candidates that were discovered.
        base: the configuration alone.
        guard: holds structures to the lock; None where the configuration asks for none.
        candidates: how many changes of candidates there were in this revision.
        needs_candidates: whether it has functions with needs.
    """

    number: int
    robot: Robot
    structures: StructureCache
    resolver: Resolver
    base: Robot
    guard: _lock.LockGuard | None = None
    candidates: int = 0
    needs_candidates: bool = field(init=False)
    # Filled by any thread; two that find the same do no harm.
    _reach: dict[str, frozenset[str]] = field(init=False, factory=dict)
    _named: dict[str, Component | Offer] = field(init=False, factory=dict)

    def __attrs_post_init__(self) -> None:
        needs = any(function.needs is not None for function in self.base.functions.values())
        object.__setattr__(self, "needs_candidates", needs)

    def named(self, name: str) -> Component | Offer | None:
        """Return the component or the offer of a name; None where there is none."""
        if not self._named:
            components = {item.name: item for item in self.robot.components()}
            offers = {item.name: item for item in self.robot.offers}
            self._named.update({**components, **offers})  # whole: others may look meanwhile
        return self._named.get(name)

    def service(self, name: str) -> Component | None:
        """Return the component of a name that is called; None where it is none."""
        found = self.named(name)
        return found if isinstance(found, Component) and found.service is not None else None

    def resolve(
        self,
        name: str,
        excluded: frozenset[str] = frozenset(),
        avoided: AbstractSet[str] = frozenset(),
    ) -> Plan:
        """Resolve without what is avoided; where there is nothing else, with it."""
        avoided = self.within(name, avoided) - excluded if avoided else frozenset()
        if avoided:
            try:
                return self.resolver.resolve(name, excluded=excluded | avoided)
            except ResolutionError:
                pass
        return self.resolver.resolve(name, excluded=excluded)

    def replacement(
        self,
        plan: Plan,
        output: str | None,
        excluded: Container[str],
        failed: OrderedMap[str, float],
        avoided: AbstractSet[str],
    ) -> Plan:
        """Return a plan that gives an application what its own gave; see `find_replacement`.

        Args:
            plan: the application's own.
            output: the output that it receives.
            excluded: components that may not be used.
            failed: when components failed lately, longest ago first.
            avoided: components to do without, where anything else can do.
        """
        # Thousands may have died with one bridge: of these only what matters here is looked at.
        function = plan.function
        return find_replacement(
            plan,
            output,
            self.within(function, excluded),
            tuple(sorted(self.within(function, failed), key=failed.place)),
            lambda name, without: self.resolve(name, without, avoided),
        )

    def has_others(self, plan: Plan, excluded: Iterable[str]) -> bool:
        """Whether a component that is not excluded may take the place of one of a plan's."""
        left_out = {*plan.names, *excluded}
        names = {step.component.function for step in plan.steps}
        return any(
            component.name not in left_out
            for function in filter(None, map(self.robot.functions.get, names))
            for component in function.components
        )

    def seek_replacement(self, action: act.FindReplacement) -> ev.ReplacementSought:
        """Look for a plan that gives the application what its own gave."""
        asked, group = (action.connection, action.attempt), action.switchover
        try:
            plan = self.replacement(
                action.plan, action.output, action.excluded, action.failed, action.avoided
            )
        except Exception as error:  # noqa: BLE001 - the state learns of it whatever it is
            if not isinstance(error, UoarmError):
                _records.write(logging.ERROR, "looking for a replacement failed", error)
            return ev.ReplacementSought(*asked, None, str(error), group)
        return ev.ReplacementSought(*asked, plan, "", group, self.candidates)

    def check_preferred(self, action: act.CheckPreferred) -> ev.PreferredChecked:
        """See whether a plan is what a request would get now."""
        wanted = action.plan.names
        self.forget(wanted)
        try:
            found = self.resolve(action.plan.function, avoided=action.avoided).names
        except Exception as error:  # noqa: BLE001 - the state learns of it whatever it is
            if not isinstance(error, UoarmError):
                _records.write(logging.ERROR, "looking for a preferred plan failed", error)
            found = ()
        return ev.PreferredChecked(action.connection, found == wanted)

    def within(self, function: str, components: Container[str]) -> frozenset[str]:
        """Return those of some components that plans of a function may have."""
        reach = self._reach.get(function)
        if reach is None:
            reach = self._reach[function] = reachable_components(self.robot.functions, function)
        return frozenset(name for name in reach if name in components)

    def has_needs(self, name: str) -> bool:
        """Whether a function, or one that may feed it, says what it needs of candidates."""
        reached = reachable_functions(self.robot.functions, name)
        return any(function.needs is not None for function in reached)

    def forget_within(self, function: str, components: Collection[str]) -> None:
        """Forget the structures of components, of which a function, where one is named, has few."""
        self.forget(self.within(function, components) if function else components)

    def forget(self, components: Collection[str]) -> None:
        """Ask for the structures of components again the next time."""
        for component in components:
            self.structures.forget(component)
        self.resolver.invalidate(frozenset(components))


@frozen(eq=False)
class StagedRevision:
    """A configuration that may be adopted; its new bridges run, for itself alone.

    It is not `is_new` where its text, all in it and its lock are those in force.
    """

    revision: Revision
    difference: ConfigurationDifference
    bridges: StagedBridges
    change: ConfigurationChange
    is_new: bool


class Revisions:
    """Holds the revision in force and says what another would do. Thread safe.

    Args:
        notify: called for what is not as in the lock, with the place and a sentence.

    Raises:
        LockError: the configuration asks for a lock that is not there or cannot be read.
    """

    def __init__(
        self,
        robot: Robot,
        bridges: BridgeSet,
        clock: Clock,
        notify: Callable[[str, str], None],
    ) -> None:
        self._bridges = bridges
        self._clock = clock
        self._notify = notify
        # Held for a whole change: each is made for the revision that the one before led to.
        self._changing = threading.Lock()
        guard = _guard(robot, notify)
        structures = StructureCache(bridges.get, _hold(guard))
        resolver = Resolver(robot, structures, check_edge, clock=clock)
        self.current = Revision(0, robot, structures, resolver, robot, guard)
        # Put by the thread of a change, which waits then, and taken by the owner of the state.
        self._staged: dict[int, StagedRevision] = {}
        first = ConfigurationChange(0, is_applied=True, time=time.time(), robot=robot)
        self._history = deque([first])

    @contextmanager
    def alone(self, timeout: float) -> Iterator[None]:
        """Have changes made one after another.

        Raises:
            BridgeTimeoutError: another one is not through in time.
        """
        if not self._changing.acquire(timeout=timeout):
            raise BridgeTimeoutError("another change of configuration is not through yet")
        try:
            yield
        finally:
            self._changing.release()

    def require(self, revision: int | None) -> None:
        """Refuse a change that was made for another revision than the one in force.

        Raises:
            UsageError: it was.
        """
        number = self.current.number
        if revision is not None and revision != number:
            raise UsageError(
                f"the change was made for revision {revision}, and revision {number} is in force: "
                "look at what has changed since, and make it anew"
            )

    def history(self) -> tuple[ConfigurationChange, ...]:
        """Return the last revisions, the one in force last.

        A hundred, fewer of large configurations, but the one before that in force always.
        """
        return tuple(self._history)

    def note_kept(self) -> None:
        """Note that the revision in force stands in the file."""
        self._history[-1] = evolve(self._history[-1], is_kept=True)

    def use_candidates(self, robot: Robot, superseded: Collection[str], number: int) -> None:
        """Have other candidates in the revision in force; what they do not concern stays known.

        Args:
            robot: the configuration in force with other candidates.
            superseded: candidates that are gone or are others.
            number: of these candidates.
        """
        before = self.current
        for name in superseded:
            before.structures.forget(name)
        # Then the number: what is found with them and said to be older is only sought once more.
        before.resolver.use(robot.functions)
        self.current = evolve(before, robot=robot, candidates=number)

    def stage(self, base: Robot, owner: StateOwner, *, is_new_code: bool = False) -> StagedRevision:
        """Find what a configuration would change; start the bridges that it needs for that.

        Candidates of the configuration in force stay, where their functions still have needs and
        their bridges are the same: a later round of discovery looks at them.

        Args:
            base: the configuration.
            owner: of the state, which is read when what the change needs has been asked for.
            is_new_code: whether Python components must be there with their new code that are
                there with the old one.

        Raises:
            ConfigurationError: some are not. Other machines cannot join at the address that it
                has for them, or the lock that it asks for cannot be read.
        """
        before = self.current
        base = without_candidates(base)
        guard = _guard(base, self._notify, before.guard)
        robot = carry_candidates(before.robot, base)
        difference = compare(before.robot, robot)
        try:
            bridges = self._bridges.stage(robot.bridges, robot.hosts)
        except (BridgeError, PluginError) as error:
            text = f"other machines cannot join as `hosts` of the new configuration says: {error}"
            raise ConfigurationError(text) from error
        with on_failure(bridges.close):
            cut = _cut(robot, bridges.joining.cut_bridges)
            structures = before.structures.carried_over(
                bridges.get, difference.superseded, _hold(guard)
            )
            resolver = Resolver(robot, structures, check_edge, clock=self._clock)
            revision = Revision(before.number + 1, robot, structures, resolver, base, guard)
            if is_new_code:
                self._require_code(revision, difference)
            effects = tuple(self._effects(revision, difference, owner.state, cut))
        change = ConfigurationChange(revision.number, difference.changes, effects, robot=base)
        is_new = (base, base.text) != (before.base, before.base.text) or guard is not before.guard
        return StagedRevision(revision, difference, bridges, change, is_new)

    def expect(self, staged: StagedRevision) -> None:
        """Have a revision ready, which `adopt` is called for by its number."""
        self._staged[staged.revision.number] = staged

    def adopt(self, number: int) -> None:
        """Let a revision be the one in force. Quick, and calls nothing foreign."""
        # The revision last: who finds it finds its bridges and its structures in place.
        staged = self._staged.pop(number)
        staged.revision.structures.use(self._bridges.get)
        self._bridges.adopt(staged.bridges)
        self.current = staged.revision
        applied = evolve(staged.change, is_applied=True, time=time.time())
        history = self._history
        history.append(applied)
        octets = sum(octets_of(change.robot) for change in history if change.robot is not None)
        while len(history) > _LEAST and (len(history) > _KEPT or octets > _KEPT_OCTETS):
            oldest = history.popleft().robot
            octets -= 0 if oldest is None else octets_of(oldest)

    def _require_code(self, revision: Revision, difference: ConfigurationDifference) -> None:
        wrong: list[str] = []
        old = {component.name: component for component in self.current.robot.components()}
        for component in revision.robot.components():
            if component.name not in old or component.name not in difference.superseded:
                continue
            if isinstance(self.current.structures.structures(old[component.name]), Unavailable):
                continue
            now = revision.structures.structures(component)
            if isinstance(now, Unavailable):
                wrong.append(f"  component {component.name!r}: {now.sentence}")
        if wrong:
            text = "\n".join(wrong)
            raise ConfigurationError(
                f"components cannot be had with their new code; the code that runs goes on:\n{text}"
            )

    def _effects(
        self,
        revision: Revision,
        difference: ConfigurationDifference,
        state: State,
        cut: frozenset[str],
    ) -> list[ConnectionEffect]:
        avoided = recently(state.avoided, self._clock()) - difference.superseded
        failed = forget_earlier(state.failed, self._clock())
        for name in difference.superseded:
            failed = failed.discard(name)
        effects = (
            self._effect(revision, difference, record, failed, avoided, cut)
            for record in state.connections.values()
            if record.is_active and record.current is not None
        )
        return [effect for effect in effects if effect is not None]

    def _effect(
        self,
        revision: Revision,
        difference: ConfigurationDifference,
        record: ConnectionRecord,
        failed: OrderedMap[str, float],
        avoided: frozenset[str],
        cut: frozenset[str],
    ) -> ConnectionEffect | None:
        before = record.placement.plan.names
        is_cut = not cut.isdisjoint(before)
        is_superseded = is_cut or not difference.superseded.isdisjoint(before)
        if record.wanted.function not in difference.functions and not is_superseded:
            return None
        if is_cut and revision.base.failover.wait > 0:  # which is how long the machine may take
            function = record.wanted.function
            return ConnectionEffect(record.id, function, Effect.MOVES, before, before)
        try:
            plan = revision.replacement(record.placement.plan, record.output, cut, failed, avoided)
        except ResolutionError as error:
            if not is_superseded:
                return None
            function, cause = record.wanted.function, str(error)
            if is_cut:
                cause = f"{_ANEW}: {cause}"
            return ConnectionEffect(record.id, function, Effect.ENDS, before, cause=cause)
        after = plan.names
        if after == before and not is_superseded:
            return None
        return ConnectionEffect(record.id, record.wanted.function, Effect.MOVES, before, after)


def octets_of(robot: Robot) -> int:
    """Return about how many octets a configuration takes in memory."""
    entries = len(robot.bridges) + len(robot.functions) + len(robot.offers)
    return _ENTRY_OCTETS * entries + len(robot.text)


def _guard(
    robot: Robot, notify: Callable[[str, str], None], before: _lock.LockGuard | None = None
) -> _lock.LockGuard | None:
    """Return the guard of a robot's lock; one that asks for no lock needs none of its modules."""
    return None if robot.lock is None else _lock.guard_of(robot, notify, before)


def _hold(guard: _lock.LockGuard | None) -> Hold | None:
    return None if guard is None else guard.hold


def _cut(robot: Robot, bridges: frozenset[str]) -> frozenset[str]:
    """Return the components of bridges."""
    return frozenset(
        component.name for component in robot.components() if component.bridge in bridges
    )
