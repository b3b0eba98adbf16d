"""What ends a check early: a schema that is none, what is not decided, and a budget used up."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

from uoarm._encodable import shown

Pointer: TypeAlias = "tuple[Pointer, str | int] | None"
"""A place in a schema, the place around it and a step; written as text only when it is shown."""


class BudgetError(Exception):
    """The budget ran out; the text says what of it, and which part of the check took longest."""


class OutOfScopeError(Exception):
    """The schema holds something that is not decided; the text says what."""


class SchemaError(ValueError):
    """A malformed schema: the text says which, where (JSON pointer), what was expected."""

    def __init__(self, pointer: str, expected: str, got: object) -> None:
        super().__init__(f"{pointer or '#'}: expected {expected}, got {shown(got)}")
        self.pointer = pointer


def write_pointer(pointer: Pointer) -> str:
    """Write a place as `#/properties/a`."""
    steps: list[str] = []
    while pointer is not None:
        pointer, step = pointer
        steps.append(f"/{step}")
    return "#" + "".join(reversed(steps))


_LOOKS = 32
"""Steps after which the clock is read; each is some ten microseconds of work."""


class Meter:
    """Counts steps, time and octets, and raises BudgetError when one of them ran out.

    Octets are those of what is kept: nodes, remembered answers, states, automata and values.
    """

    def __init__(
        self,
        steps: int,
        seconds: float,
        octets: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self._steps = steps
        self._octets = octets
        self._look = steps
        self._part = "reading the schemas"
        self._costs: dict[str, float] = {}
        self._since = clock()
        self._deadline = self._since + seconds

    def spend(self, steps: int = 1) -> None:
        self._steps -= steps
        if self._steps < self._look:
            self._check()

    def hold(self, octets: int) -> None:
        """Count memory that is kept."""
        self._octets -= octets
        if self._octets < 0:
            raise BudgetError(self._exhausted("memory"))

    def release(self, octets: int) -> None:
        """Take back memory that was counted and is kept no longer."""
        self._octets += octets

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the time that passes within as that of a part."""
        around = self._part
        self._turn(name)
        try:
            yield
        finally:
            self._turn(around)

    def _check(self) -> None:
        if self._steps < 0:
            raise BudgetError(self._exhausted("steps"))
        self._look = self._steps - _LOOKS
        if self._clock() > self._deadline:
            raise BudgetError(self._exhausted("time"))

    def _exhausted(self, of: str) -> str:
        self._turn(self._part)
        most = max(self._costs, key=lambda part: self._costs[part])
        return f"the budget of {of} ran out; what took longest was {most}"

    def _turn(self, part: str) -> None:
        now = self._clock()
        self._costs[self._part] = self._costs.get(self._part, 0.0) + now - self._since
        self._part, self._since = part, now
