"""The search for one value that meets every literal of a goal.

Goals are answered by generators that ask for sub-goals; `Solver.solve` runs them on an explicit
stack and remembers answers. A goal that is met again while it is being answered counts as empty:
a least value never contains itself (the least fixpoint). An emptiness that leaned on such a goal
holds only within it and is not remembered.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable
from collections.abc import Set as AbstractSet
from typing import Any, TypeAlias

from attrs import define, field

from uoarm.schema._branch import KINDS, Atom, Branch, Choice, Literal
from uoarm.schema._document import Document, Pool
from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._evaluate import accepts
from uoarm.schema._expand import expand
from uoarm.schema._node import Node
from uoarm.schema._results import EMPTY, Empty, Found, Result, Unknown
from uoarm.schema._tags import contradicts, tags_of
from uoarm.schema._values import Key, kind_of

__all__ = ["Asking", "BudgetError", "Goal", "Solver", "State"]

Goal: TypeAlias = "tuple[Literal, ...]"
Asking: TypeAlias = Generator[Goal, Result, Result]
GoalKey: TypeAlias = "frozenset[tuple[int, bool]]"


class BudgetError(Exception):
    """The budget ran out; the text says which part."""


@define
class _Frame:
    key: GoalKey
    work: Asking
    low: int
    unknown: Unknown | None = None


@define
class State:
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
        while waiting:
            one = waiting.pop()
            self.atoms.extend(one.atoms)
            self.choices.extend(one.choices)
            for node, sign in one.literals:
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

    def copy(self) -> State:
        """Return a state that can be changed on its own."""
        return State(
            self.kind,
            self.goal,
            list(self.atoms),
            list(self.choices),
            set(self.seen),
            dict(self.tags),
        )

    def _add_tags(self, node: Node) -> bool:
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
        pool: numbers contents, shared with the documents of the goals.
        steps: sub-goals and branches at most.
        seconds: at most.
    """

    def __init__(self, pool: Pool, steps: int, seconds: float) -> None:
        self._pool = pool
        self._steps = steps
        self._deadline = time.monotonic() + seconds
        self._memo: dict[GoalKey, Result] = {}
        self._made: dict[str, Node] = {}

    def solve(self, goal: Goal) -> Result:
        """Return a value that meets every literal of a goal.

        Raises:
            BudgetError: steps or seconds ran out.
        """
        from uoarm.schema._search import answer  # noqa: PLC0415 - the two call each other

        frames: list[_Frame] = []
        active: dict[GoalKey, int] = {}

        def push(asked: Goal, key: GoalKey) -> None:
            active[key] = len(frames)
            frames.append(_Frame(key, answer(self, asked), len(frames)))

        first = _key(goal)
        if first is None:
            return EMPTY
        push(goal, first)
        result: Result | None = None
        while frames:
            frame = frames[-1]
            try:
                asked = frame.work.send(result)  # type: ignore[arg-type] # None starts it
            except StopIteration as done:
                result = self._finish(frames, active, done.value)
                continue
            self.spend()
            key = _key(asked)
            if key is None:
                result = EMPTY
            elif key in self._memo:
                result = self._memo[key]
            elif key in active:
                frame.low = min(frame.low, active[key])
                result = EMPTY
            else:
                push(asked, key)
                result = None
                continue
            if isinstance(result, Unknown):
                frame.unknown = result
        assert result is not None
        return result

    def spend(self, steps: int = 1) -> None:
        """Count work; raises BudgetError when there was too much."""
        self._steps -= steps
        if self._steps < 0:
            raise BudgetError("the budget of steps ran out")
        if self._steps % 64 == 0 and time.monotonic() > self._deadline:
            raise BudgetError("the budget of time ran out")

    def make(self, name: str, schema: Any) -> Node:
        """Return the node of a schema that the search itself made up, one for each name."""
        node = self._made.get(name)
        if node is None:
            node = self._made[name] = Document(schema, self._pool).root
        return node

    def _finish(self, frames: list[_Frame], active: dict[GoalKey, int], result: Result) -> Result:
        frame = frames.pop()
        del active[frame.key]
        depth = len(frames)
        if isinstance(result, Empty) and frame.unknown is not None:
            result = frame.unknown
        if isinstance(result, Found) or frame.low >= depth:
            self._memo[frame.key] = result
        if frames:
            parent = frames[-1]
            if frame.low < depth:
                parent.low = min(parent.low, frame.low)
            if isinstance(result, Unknown):
                parent.unknown = result
        return result


def try_values(values: Iterable[Any], state: State) -> Result:
    """Return the first of some values that meets the whole goal."""
    for value in values:
        if kind_of(value) == state.kind and all(
            accepts(node, value) == sign for node, sign in state.goal
        ):
            return Found(value)
    return EMPTY


def possible_kinds(goal: Goal) -> list[str]:
    """Return the kinds that the positive literals leave, likely ones first."""
    kinds = list(KINDS)
    for node, sign in goal:
        if sign and node.kinds is not None and not node.unsupported:
            kinds = [one for one in kinds if one in node.kinds]
    return kinds


def _key(goal: Goal) -> GoalKey | None:
    """Return what names a goal in the memory; None when it contradicts itself."""
    key = frozenset((node.number, sign) for node, sign in goal)
    if any((number, not sign) in key for number, sign in key):
        return None
    return key
