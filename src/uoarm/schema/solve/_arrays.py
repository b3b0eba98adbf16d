"""Finding an array: its demands by position, a length, and two equal items where needed."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from itertools import product
from typing import Any, TypeAlias

from attrs import frozen

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._values import Keys, Repeated, key_of, kind_of
from uoarm.schema.read import SchemaNode
from uoarm.schema.solve._branch import (
    UNSATISFIABLE,
    Atom,
    Literal,
    Result,
    Unknown,
    Unsatisfiable,
    Witness,
)
from uoarm.schema.solve._evaluate import accepts
from uoarm.schema.solve._solver import Asking, Goal, SearchState, Solver


class Layout:
    """The demands on an array, arranged by position."""

    def __init__(self, atoms: Iterable[Atom]) -> None:
        self.least = 0
        self.most: int | None = None
        self.at: dict[int, list[Literal]] = {}
        self.tails: list[tuple[int, Literal]] = []
        self.some: list[tuple[int, Literal]] = []
        self.counts: list[tuple[SchemaNode, int, int | None]] = []
        self.unique = self.twice = False
        for atom in atoms:
            self._take(atom)

    def _take(self, atom: Atom) -> None:
        tag = atom[0]
        rest: Any = atom[1:]
        if tag == "least":
            self.least = max(self.least, rest[0])
        elif tag == "most":
            self.most = rest[0] if self.most is None else min(self.most, rest[0])
        elif tag == "at":
            self.at.setdefault(rest[0], []).append(rest[1])
        elif tag == "someat":
            self.at.setdefault(rest[0], []).append(rest[1])
            self.least = max(self.least, rest[0] + 1)
        elif tag == "tail":
            self.tails.append((rest[0], rest[1]))
        elif tag == "some":
            self.some.append((rest[0], rest[1]))
        elif tag == "contains":
            self.counts.append(rest)
        elif tag == "unique":
            self.unique = True
        elif tag == "twice":
            self.twice = True
        else:
            raise OutOfScopeError(f"internal: {tag!r} is no demand on the layout of an array")

    @property
    def generic(self) -> int:
        """The first position from which on all are alike."""
        return max([*(n + 1 for n in self.at), *(start for start, _ in self.tails), 0])

    def literals(self, position: int) -> Goal:
        """Return what the item at a position must meet."""
        tail = (literal for start, literal in self.tails if position >= start)
        return (*self.at.get(position, ()), *tail)

    def sign_vectors(self) -> Iterator[tuple[bool, ...]]:
        """Yield every way in which an item may meet or fail the counted schemas."""
        return product((True, False), repeat=len(self.counts))

    def signed(self, signs: tuple[bool, ...]) -> Goal:
        """Return what an item meets that meets and fails the counted schemas as given."""
        return tuple((node, sign) for (node, _, _), sign in zip(self.counts, signs, strict=True))

    def classes(self, position: int) -> Iterator[tuple[tuple[bool, ...], Goal]]:
        """Yield what an item at a position must meet, by what it counts for."""
        for signs in self.sign_vectors():
            yield signs, (*self.literals(position), *self.signed(signs))

    def count_on(self, counts: tuple[int, ...], signs: tuple[bool, ...]) -> tuple[int, ...] | None:
        """Return the counts after one more item, None when there are too many.

        Counts that no longer matter stay where they are.
        """
        after = []
        for (_, least, most), count, sign in zip(self.counts, counts, signs, strict=True):
            more = count + sign
            if most is not None and more > most:
                return None
            after.append(min(more, least) if most is None else more)
        return tuple(after)

    def enough(self, counts: tuple[int, ...]) -> bool:
        return all(n >= least for (_, least, _), n in zip(self.counts, counts, strict=True))


Verdict: TypeAlias = Generator[Goal, Result, "bool | None"]


class ArrayView:
    """The demands on an array, for quick verdicts on one more."""

    def __init__(self, atoms: Iterable[Atom]) -> None:
        self._layout = Layout(atoms)
        self._counts: dict[int, tuple[int, int | None]] = {}
        for node, least, most in self._layout.counts:
            low, high = self._counts.get(node.number, (0, None))
            if most is not None:
                high = most if high is None else min(most, high)
            self._counts[node.number] = max(low, least), high

    def judge(self, atom: Atom, *, many: bool) -> Verdict:
        """Return True when an atom holds already, False when it cannot, None otherwise."""
        tag = atom[0]
        rest: Any = atom[1:]
        if tag in {"least", "most"}:
            return self._judge_size(tag == "least", rest[0])
        if tag in {"at", "someat"}:
            return (yield from self._judge_item(rest[0], rest[1], some=tag == "someat", many=many))
        if tag in {"tail", "some"}:
            return (yield from self._judge_rest(rest[0], rest[1], some=tag == "some"))
        if tag == "contains":
            return self._judge_count(*rest)
        if tag not in {"unique", "twice"}:
            return None  # a list of values, which is no matter of length or items
        distinct = True if self._fewer_than(2) or self._layout.unique else None
        if self._layout.twice:
            distinct = False
        return distinct if tag == "unique" or distinct is None else not distinct

    def _fewer_than(self, size: int) -> bool:
        return self._layout.most is not None and self._layout.most < size

    def _judge_size(self, at_least: bool, size: int) -> bool | None:  # noqa: FBT001 - private
        if at_least:
            return (
                True if self._layout.least >= size else (False if self._fewer_than(size) else None)
            )
        if self._layout.least > size:
            return False
        return True if self._fewer_than(size + 1) else None

    def _judge_item(self, position: int, literal: Literal, *, some: bool, many: bool) -> Verdict:
        if self._fewer_than(position + 1):
            return not some
        known = self._layout.literals(position)
        there = self._layout.least > position
        if some or there:
            result = yield (*known, literal)
            if isinstance(result, Unsatisfiable):
                return False
        if many and (there or not some):
            result = yield (*known, (literal[0], not literal[1]))
            if isinstance(result, Unsatisfiable):
                return True
        return None

    def _judge_rest(self, start: int, literal: Literal, *, some: bool) -> Verdict:
        if self._fewer_than(start + 1):
            return not some
        if start < self._layout.generic:
            return None
        wanted = literal if some else (literal[0], not literal[1])
        result = yield (*self._layout.literals(start), wanted)
        return (not some) if isinstance(result, Unsatisfiable) else None

    def _judge_count(self, node: Any, least: int, most: int | None) -> bool | None:
        low, high = self._counts.get(node.number, (0, None))
        if self._layout.most is not None:
            high = self._layout.most if high is None else min(high, self._layout.most)
        if (high is not None and least > high) or (most is not None and most < low):
            return False
        if least <= low and (most is None or (high is not None and high <= most)):
            return True
        return None


_GROWTH = {
    "number": "exclusiveMinimum",
    "string": "minLength",
    "array": "minItems",
    "object": "minProperties",
}


class Matching:
    """Places, each with candidates, and a value for each that no other place has.

    `keys` lives as long as the candidates.
    """

    def __init__(self, keys: Keys) -> None:
        self._keys = keys
        self._candidates: list[Sequence[Any]] = []
        self._holder: dict[object, int] = {}
        self._values: dict[object, Any] = {}

    def copy(self) -> Matching:
        """Return a matching that can be changed on its own."""
        other = Matching(self._keys)
        other._candidates = list(self._candidates)
        other._holder = dict(self._holder)
        other._values = dict(self._values)
        return other

    def add(self, candidates: Sequence[Any]) -> bool:
        """Give one more place a value of its own, moving others along an augmenting path."""
        self._candidates.append(candidates)
        came: dict[object, tuple[int, object]] = {}
        waiting: list[tuple[int, object]] = [(len(self._candidates) - 1, None)]
        for place, via in waiting:
            for value in self._candidates[place]:
                key = self._keys.of(value)
                if key in came:
                    continue
                self._values[key] = value
                came[key] = (place, via)
                if key not in self._holder:
                    at: object = key
                    while at is not None:
                        self._holder[at], at = came[at]
                    return True
                waiting.append((self._holder[key], key))
        self._candidates.pop()
        return False

    def values(self) -> list[Any]:
        chosen = {place: self._values[key] for key, place in self._holder.items()}
        return [chosen[place] for place in range(len(self._candidates))]


def distinct(solver: Solver, goals: Sequence[Goal]) -> Generator[Goal, Result, Result]:
    """Return one value for each goal, all different."""
    candidates: dict[Goal, list[Any]] = {}
    matching = Matching(Keys(solver.spend))
    for goal in goals:
        if goal not in candidates:
            found = yield from several(solver, goal, len(goals))
            if isinstance(found, Unknown):
                return found
            candidates[goal] = found
        if not matching.add(candidates[goal]):
            return UNSATISFIABLE
    return Witness(matching.values())


def several(solver: Solver, goal: Goal, count: int) -> Generator[Goal, Result, list[Any] | Unknown]:
    """Return up to `count` different values that meet a goal."""
    found: dict[object, Any] = {}
    grown: set[str] = set()
    beyond: Literal | None = None
    while len(found) < count:
        result: Result = UNSATISFIABLE
        if beyond is not None:
            result = yield (*goal, beyond)
        if not isinstance(result, Witness):
            beyond = None
            values = list(found.values())
            others = solver.make(f"one of {list(found)}", {"enum": values})
            result = yield (*goal, (others, False))
        if isinstance(result, Unknown):
            return result
        if not isinstance(result, Witness):
            break
        key = key_of(result.value)
        if key in found:
            return Unknown("internal: a value that was excluded came again")
        if beyond is not None or kind_of(result.value) not in grown:
            beyond = _beyond(solver, result.value)
            grown.add(kind_of(result.value))
        found[key] = result.value
    return list(found.values())


def _beyond(solver: Solver, value: Any) -> Literal | None:
    """Return what only larger values of the same kind meet.

    It spares distinguishing a new value from each of those before.
    """
    kind = kind_of(value)
    if kind not in _GROWTH:
        return None
    size = value if kind == "number" else len(value) + 1
    schema = {"type": kind, _GROWTH[kind]: size}
    return solver.make(f"beyond {schema}", schema), True


_MAX_ITEMS = 130
_MAX_TRIES = 20_000


@frozen
class _Option:
    """One class of items that a position may hold: which counted schemas they meet."""

    signs: tuple[bool, ...]
    candidates: Sequence[Any]


Options: TypeAlias = "list[list[_Option]]"


def _build_distinct(solver: Solver, layout: Layout, longest: int) -> Asking:
    """Build an array of at most `longest` items, trying what each position may hold in turn."""
    if longest > _MAX_ITEMS:
        return Unknown(f"up to {longest:,} distinct items would have to be counted through")
    options: Options = []
    unknown: Unknown | None = None
    for position in range(longest):
        if position > layout.generic:
            options.append(options[-1])
            continue
        found = yield from _options(solver, layout, position, longest)
        unknown = found if isinstance(found, Unknown) else unknown
        options.append([] if isinstance(found, Unknown) else found)
    result = _choose(solver, layout, options)
    return result if isinstance(result, Witness) else unknown or result


def _options(
    solver: Solver, layout: Layout, position: int, longest: int
) -> Generator[Goal, Result, list[_Option] | Unknown]:
    options: list[_Option] = []
    for signs, goal in layout.classes(position):
        found = yield from several(solver, goal, longest)
        if isinstance(found, Unknown):
            return found
        if found:
            options.append(_Option(signs, found))
    return options


def _choose(solver: Solver, layout: Layout, options: Options) -> Result:
    """Go through the choices; positions that are alike take their options in order."""
    start = tuple(0 for _ in layout.counts)
    waiting: list[tuple[int, tuple[int, ...], int, Matching]] = [
        (0, start, 0, Matching(Keys(solver.spend)))
    ]
    tries = 0
    while waiting:
        position, counts, last, matching = waiting.pop()
        if position >= layout.least and layout.enough(counts):
            return Witness(matching.values())
        if position == len(options):
            continue
        first = last if position > layout.generic else 0
        for number in range(len(options[position]) - 1, first - 1, -1):
            tries += 1
            solver.spend()
            if tries > _MAX_TRIES:
                return Unknown("distinct items together with contains")
            option = options[position][number]
            after = layout.count_on(counts, option.signs)
            longer = matching.copy()
            if after is not None and longer.add(option.candidates):
                waiting.append((position + 1, after, number, longer))
    return UNSATISFIABLE


_MAX_COUNTED = 3_000


def build_counted(solver: Solver, layout: Layout, fixed: dict[int, Any]) -> Asking:
    """Build an array of which given numbers of items meet given schemas."""
    needed = sum(least for _, least, _ in layout.counts)
    longest = max(layout.least, layout.generic) + needed
    if layout.most is not None:
        longest = min(longest, layout.most)
    if layout.unique:
        return (yield from _build_distinct(solver, layout, longest))
    if longest > _MAX_COUNTED:
        return Unknown(f"arrays of up to {longest:,} items would have to be counted through")
    unknown: Unknown | None = None
    layers: list[dict[tuple[int, ...], tuple[tuple[int, ...], Goal]]] = [{}]
    start = tuple(0 for _ in layout.counts)
    reached: dict[tuple[int, ...], tuple[tuple[int, ...], Goal]] = {start: (start, ())}
    for length in range(longest + 1):
        if length >= layout.least and length > max(fixed, default=-1):
            for counts in reached:
                if layout.enough(counts):
                    return (yield from _assemble(layers, counts, length, fixed))
        if length == longest:
            break
        options: list[tuple[tuple[bool, ...], Goal]] = []
        for signs, goal in layout.classes(length):
            if length in fixed:
                holds = all(accepts(node, fixed[length]) == sign for node, sign in goal)
                result: Result = Witness(None) if holds else UNSATISFIABLE
            else:
                result = yield goal
            if isinstance(result, Witness):
                options.append((signs, goal))
            unknown = result if isinstance(result, Unknown) else unknown
        following: dict[tuple[int, ...], tuple[tuple[int, ...], Goal]] = {}
        for counts in reached:
            for signs, goal in options:
                solver.spend()
                after = layout.count_on(counts, signs)
                if after is not None:
                    following.setdefault(after, (counts, goal))
        layers.append(following)
        reached = following
    return unknown or UNSATISFIABLE


def _assemble(
    layers: list[dict[tuple[int, ...], tuple[tuple[int, ...], Goal]]],
    counts: tuple[int, ...],
    length: int,
    fixed: dict[int, Any],
) -> Asking:
    goals: list[Goal] = []
    for position in range(length, 0, -1):
        counts, goal = layers[position][counts]
        goals.append(goal)
    goals.reverse()
    items = []
    for position, goal in enumerate(goals):
        if position in fixed:
            items.append(fixed[position])
            continue
        result = yield goal
        if not isinstance(result, Witness):
            return result
        items.append(result.value)
    return Witness(items)


_MAX_LENGTH = 4_000_000
_MAX_WRITTEN = 100
_MAX_DISTINCT = 300
_MAX_COUNTS = 8


def array_leaf(solver: Solver, state: SearchState) -> Asking:
    """Answer a goal of which only atoms about an array are left."""
    layout = Layout(state.atoms)
    if layout.most is not None and layout.least > layout.most:
        return UNSATISFIABLE
    if len(layout.counts) > _MAX_COUNTS:
        return Unknown(f"more than {_MAX_COUNTS} contains meet")
    return (yield _place(solver, layout, layout.some))


def _place(solver: Solver, layout: Layout, demands: Sequence[tuple[int, Literal]]) -> Asking:
    """Choose a position for each demand that some item must meet."""
    if not demands:
        if layout.twice:
            return (yield _repeat(solver, layout))
        return (yield from _build(solver, layout, {}))
    (start, literal), rest = demands[0], demands[1:]
    unknown: Unknown | None = None
    last = max(layout.generic, start) + len(layout.some) - 1
    for position in range(start, last + 1):
        if layout.most is not None and position >= layout.most:
            break
        solver.spend()
        result = yield (*layout.literals(position), literal)
        if isinstance(result, Witness):
            before, least = layout.at.get(position, []), layout.least
            layout.at[position] = [*before, literal]
            layout.least = max(least, position + 1)
            result = yield _place(solver, layout, rest)
            layout.at[position], layout.least = before, least
            if not before:
                del layout.at[position]
        if isinstance(result, Witness):
            return result
        unknown = result if isinstance(result, Unknown) else unknown
    return unknown or UNSATISFIABLE


def _repeat(solver: Solver, layout: Layout) -> Asking:
    """Build an array with two equal items."""
    if layout.unique:
        return UNSATISFIABLE
    unknown: Unknown | None = None
    end = layout.generic + 2
    for second in range(1, end):
        if layout.most is not None and second >= layout.most:
            break
        for first, signs in product(range(second), layout.sign_vectors()):
            solver.spend()
            result = yield (
                *layout.literals(first),
                *layout.literals(second),
                *layout.signed(signs),
            )
            if isinstance(result, Witness):
                least = layout.least
                layout.least = max(least, second + 1)
                fixed = {first: result.value, second: result.value}
                result = yield from _build(solver, layout, fixed)
                layout.least = least
            if isinstance(result, Witness):
                return result
            unknown = result if isinstance(result, Unknown) else unknown
    return unknown or UNSATISFIABLE


def _build(solver: Solver, layout: Layout, fixed: dict[int, Any]) -> Asking:
    """Build the array, its demanded positions chosen and some items perhaps fixed."""
    if layout.counts:
        return (yield from build_counted(solver, layout, fixed))
    if layout.least > _MAX_LENGTH:
        return Unknown(f"the shortest array has {layout.least:,} items")
    if layout.unique and layout.least > 1:
        goals = [layout.literals(n) for n in range(min(layout.least, _MAX_DISTINCT))]
        found = yield from distinct(solver, goals)
        if isinstance(found, Witness) and layout.least > _MAX_DISTINCT:
            return Unknown(f"{layout.least:,} distinct items would be needed")
        return found
    items: list[Any] = []
    for position in range(min(layout.least, layout.generic + 1)):
        if position in fixed:
            items.append(fixed[position])
            continue
        result = yield layout.literals(position)
        if not isinstance(result, Witness):
            return result
        items.append(result.value)
    for position in sorted(fixed):
        if position >= len(items):
            items.extend([items[-1] if items else fixed[position]] * (position - len(items)))
            items.append(fixed[position])
    more = layout.least - len(items)
    if more > 0:
        result = yield layout.literals(layout.generic)
        if not isinstance(result, Witness):
            return result
        if more > _MAX_WRITTEN:
            return Witness(Repeated([*((item, 1) for item in items), (result.value, more)]))
        items.extend([result.value] * more)
    return Witness(items)
