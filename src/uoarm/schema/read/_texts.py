"""Texts of plain schemas: equal ones are read once, in both documents of a check.

A plain schema is made of JSON values alone, is neither large nor deep, and says no keyword that
gives a schema another place or depends on its place. So what it means follows from its text.
"""

from __future__ import annotations

import marshal
from math import isfinite
from typing import Any

from uoarm.schema._meter import Meter
from uoarm.schema._values import SCALARS
from uoarm.schema.read._resources import PLACING, POSITIONAL

__all__ = ["Texts", "is_plain"]

_MAX_PARTS = 50_000
_MAX_LEVELS = 40
_NAMES = frozenset({str})
_ALWAYS = SCALARS - {float}
_OF_TEXT = 200
"""About the octets that a text takes besides its own."""


def is_plain(schema: object, meter: Meter) -> bool:
    """Say whether a whole schema is plain, looking at each of its parts once."""
    level: list[Any] = [schema]
    parts = 0
    placing = POSITIONAL  # the draft that the whole names is known already
    for _ in range(_MAX_LEVELS):
        below: list[Any] = []
        meter.spend(len(level) // 32)
        for item in level:
            kind = item.__class__
            if kind in _ALWAYS:
                continue
            if kind is dict:
                if not (placing.isdisjoint(item) and _NAMES.issuperset(map(type, item))):
                    return False
                within = item.values()
            elif kind is list:
                within = item
            elif kind is float and isfinite(item):
                continue
            else:
                return False
            parts += len(within)
            if parts > _MAX_PARTS:
                return False
            if not _ALWAYS.issuperset(map(type, within)):
                below.extend(within)
        if not below:
            return True
        level, placing = below, PLACING
    return False


_OF_STEP = 2_000
"""Octets of a text that take a step's time."""


class Texts:
    """The first schema of each text that was met in the plain documents of one check."""

    def __init__(self, meter: Meter) -> None:
        self._meter = meter
        self._first: dict[bytes, dict[str, Any]] = {}

    def first(self, schema: dict[str, Any]) -> dict[str, Any]:
        """Return the first schema of the same text, itself where it is that; part of a plain one.

        The text tells numbers from booleans and floats from integers, and has the order of names.
        """
        text = marshal.dumps(schema, 0)
        found = self._first.setdefault(text, schema)
        if found is schema:
            self._meter.hold(_OF_TEXT + len(text))
            self._meter.spend(1 + len(text) // _OF_STEP)
        return found
