"""The search for one value that meets every literal of a goal.

Goals are answered by generators that ask for sub-goals, or for what another generator comes to, as
a function calls another; `Solver.solve` runs them on an explicit stack and remembers the answers to
goals. A goal that is met again while it is being answered counts as empty:
a least value never contains itself (the least fixpoint). An emptiness that leaned on such a goal
holds only within it and is not remembered.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from collections.abc import Set as AbstractSet
from typing import Any, TypeAlias

from attrs import define, field

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._values import Key, kind_of
from uoarm.schema.read import Pool, SchemaDocument, SchemaNode
from uoarm.schema.regex import TooLong, UnsupportedPatternError
from uoarm.schema.solve._branch import (
    KINDS,
    UNSATISFIABLE,
    Atom,
    Branch,
    Choice,
    Literal,
    Result,
    Unknown,
    Unsatisfiable,
    Witness,
    contradicts,
    tags_of,
)
from uoarm.schema.solve._evaluate import Judgements
from uoarm.schema.solve._expand import expand

Goal: TypeAlias = "tuple[Literal, ...]"
Asking: TypeAlias = Generator["Goal | Asking", Result, Result]
GoalKey: TypeAlias = "frozenset[tuple[int, bool]]"


_GIVEN_UP = (OutOfScopeError, UnsupportedPatternError, TooLong)
_LITERALS = 64
"""Literals after which the work on them is counted, two for a step."""
_OF_FRAME = 2_000
_OF_ANSWER = 300
"""About the octets of a goal under way, and of an answer that is remembered."""


@define
class _Frame:
    """A goal under way, or part of the work for the goal below it, which has no key."""

    key: GoalKey | None
    work: Asking
    low: int
    unknown: Unknown | None = None


@define
class SearchState:
    """What is demanded of a value of one kind so far."""

    kind: str
    goal: Goal
    atoms: list[Atom] = field(factory=list)
    choices: list[Choice] = field(factory=list)
    seen: set[tuple[int, bool]] = field(factory=set)
    tags: dict[str, AbstractSet[Key]] = field(factory=dict)

    def add(self, branch: Branch) -> bool:
        """Demand a branch as well; False when it contradicts what is demanded already.

        Raises:
            OutOfScopeError: it does not contradict, but holds something that is not decided.
        """
        waiting = [branch]
        cause = ""
        count = 0
        while waiting:
            demands = waiting.pop()
            self.atoms.extend(demands.atoms)
            self.choices.extend(demands.choices)
            for node, sign in demands.literals:
                count += 1
                if not count % _LITERALS:
                    node.document.meter.spend(_LITERALS // 2)
                key = (node.number, sign)
                if (node.number, not sign) in self.seen:
                    return False
                if key in self.seen:
                    continue
                self.seen.add(key)
                if node.unsupported:
                    cause = node.unsupported
                    continue
                if self.kind == "object" and sign and not self._add_tags(node):
                    return False
                if not sign and contradicts(self.tags, node):
                    continue
                more = expand((node, sign), self.kind)
                if more is None:
                    return False
                waiting.append(more)
        if cause:
            raise OutOfScopeError(cause)
        return True

    def octets(self) -> int:
        """Return about the memory that a copy takes."""
        return 8 * (len(self.atoms) + len(self.choices)) + 80 * (len(self.seen) + len(self.tags))

    def copy(self) -> SearchState:
        """Return a state that can be changed on its own."""
        return SearchState(
            self.kind,
            self.goal,
            list(self.atoms),
            list(self.choices),
            set(self.seen),
            dict(self.tags),
        )

    def _add_tags(self, node: SchemaNode) -> bool:
        """Learn what an object is tagged with; False when that contradicts what is known."""
        for name, keys in tags_of(node).items():
            known = self.tags.get(name)
            self.tags[name] = keys if known is None else known & keys
            if not self.tags[name]:
                return False
        return True


class Solver:
    """Answers goals within a budget.

    Args:
        pool: numbers contents, shared with the documents of the goals; its meter is spent.
        answer: makes the work for one goal.
    """

    def __init__(self, pool: Pool, answer: Callable[[Solver, Goal], Asking]) -> None:
        self._answer = answer
        self._pool = pool
        self.meter = pool.meter
        self.spend = pool.meter.spend
        self._memo: dict[GoalKey, Result] = {}
        self._made: dict[str, SchemaNode] = {}

    def solve(self, goal: Goal) -> Result:
        """Return a value that meets every literal of a goal.

        Raises:
            BudgetError: the budget ran out.
        """
        frames: list[_Frame] = []
        active: dict[GoalKey, int] = {}
        result = self._ask(goal, frames, active)
        failure: Exception | None = None
        while frames:
            frame = frames[-1]
            try:
                if failure is not None:
                    thrown, failure = failure, None
                    asked = frame.work.throw(thrown)
                else:
                    asked = frame.work.send(result)  # type: ignore[arg-type] # None starts it
            except StopIteration as done:
                result = self._finish(frames, active, done.value)
            except _GIVEN_UP as error:
                if frame.key is not None:
                    raise
                failure = error
                self._finish(frames, active, UNSATISFIABLE)
            else:
                result = self._ask(asked, frames, active)
        assert result is not None
        return result

    def _ask(
        self, asked: Goal | Asking, frames: list[_Frame], active: dict[GoalKey, int]
    ) -> Result | None:
        """Answer at once where that is possible; otherwise begin the work."""
        result: Result
        if not isinstance(asked, tuple):
            self._begin(frames, None, asked)
            return None
        self.spend(1 + len(asked) // 16)
        key = _key(asked)
        if key is None:
            return UNSATISFIABLE
        if key in self._memo:
            result = self._memo[key]
        elif key in active:
            frames[-1].low = min(frames[-1].low, active[key])
            result = UNSATISFIABLE
        else:
            active[key] = len(frames)
            self._begin(frames, key, self._answer(self, asked))
            return None
        if isinstance(result, Unknown):
            frames[-1].unknown = result
        return result

    def _begin(self, frames: list[_Frame], key: GoalKey | None, work: Asking) -> None:
        self.meter.hold(_OF_FRAME)
        frames.append(_Frame(key, work, len(frames)))

    def make(self, name: str, schema: Any) -> SchemaNode:
        """Return the node of a schema that the search itself made up, one for each name."""
        node = self._made.get(name)
        if node is None:
            node = self._made[name] = SchemaDocument(schema, self._pool).root
        return node

    def _finish(self, frames: list[_Frame], active: dict[GoalKey, int], result: Result) -> Result:
        frame = frames.pop()
        self.meter.release(_OF_FRAME)
        depth = len(frames)
        if frame.key is None:
            frames[-1].low = min(frames[-1].low, frame.low)
            frames[-1].unknown = frame.unknown or frames[-1].unknown
            return result
        del active[frame.key]
        if isinstance(result, Unsatisfiable) and frame.unknown is not None:
            result = frame.unknown
        if isinstance(result, Witness) or frame.low >= depth:
            self.meter.hold(_OF_ANSWER + 8 * len(frame.key))
            self._memo[frame.key] = result
        if frames:
            parent = frames[-1]
            if frame.low < depth:
                parent.low = min(parent.low, frame.low)
            if isinstance(result, Unknown):
                parent.unknown = result
        return result


def try_values(solver: Solver, values: Iterable[Any], state: SearchState) -> Result:
    """Return the first of some values that meets the whole goal."""
    judgements = Judgements(solver.spend)
    for value in values:
        if kind_of(value) == state.kind and all(
            judgements.accepts(node, value) == sign for node, sign in state.goal
        ):
            return Witness(value)
    return UNSATISFIABLE


def possible_kinds(goal: Goal) -> list[str]:
    """Return the kinds that the positive literals leave, likely ones first."""
    kinds = list(KINDS)
    for node, sign in goal:
        if sign and node.kinds is not None and not node.unsupported:
            kinds = [kind for kind in kinds if kind in node.kinds]
    return kinds


def _key(goal: Goal) -> GoalKey | None:
    """Return what names a goal in the memory; None when it contradicts itself."""
    key = frozenset((node.number, sign) for node, sign in goal)
    if any((number, not sign) in key for number, sign in key):
        return None
    return key
