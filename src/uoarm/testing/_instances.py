"""Messages that a structure allows, biased to its edges: the input of property tests.

For JSON Schema 2020-12: bounds and the values beside them, lengths at their limits, members of
enumerations, optional fields present and absent, every branch of a union, near misses by mutation.
Each is checked by a validator before it is handed out, so the generation itself may be careless.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from jsonschema import Draft202012Validator

from uoarm.testing._choices import DrawnChoices, chance
from uoarm.testing._instance_builder import Builder, TooLargeError
from uoarm.testing._instance_mutations import mutate

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from hypothesis.strategies import DrawFn, SearchStrategy

    from uoarm.testing._choices import Choices

Schema: TypeAlias = "bool | Mapping[str, object]"

_ATTEMPTS = 6
_TOO_LARGE = 2
"""Candidates that may become too large before a schema is given up: the next ones would, too."""


def instances(
    schema: Schema, *, accepts: Callable[[object], bool] | None = None
) -> SearchStrategy[object]:
    """A hypothesis strategy for JSON values that are valid for ``schema``.

    ``accepts`` decides what is valid; by default the ``jsonschema`` package, which reads patterns
    with Python's rules and divides with floats. A schema that hardly any value satisfies makes
    hypothesis complain that too much was filtered; one that none satisfies makes it fail.
    """
    from hypothesis import reject, strategies  # noqa: PLC0415 - hypothesis is no dependency of uoarm

    valid = accepts or Draft202012Validator(schema).is_valid

    @strategies.composite
    def drawn(draw: DrawFn) -> object:
        value, found = find_instance(schema, DrawnChoices(draw), valid)
        return value if found else reject()

    return drawn()


def find_instance(
    schema: object, choices: Choices, accepts: Callable[[object], bool]
) -> tuple[object, bool]:
    """A valid value and True, or None and False when a handful of attempts gave none."""
    builder, too_large = Builder(schema, choices), 0
    for _ in range(_ATTEMPTS):
        try:
            value = builder.candidate()
        except TooLargeError:
            too_large += 1
            if too_large == _TOO_LARGE:
                break
            continue
        if chance(choices, 40):
            changed = mutate(choices, value)
            if accepts(changed):
                return changed, True
        if accepts(value):
            return value, True
    return None, False
