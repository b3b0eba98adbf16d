"""Messages that a structure allows, biased to its edges: the input of property tests.

For JSON Schema 2020-12: bounds and the values beside them, lengths at their limits, members of
enumerations, optional fields present and absent, every branch of a union, near misses by mutation.
Each is checked by a validator before it is handed out, so the generation itself may be careless.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from jsonschema import Draft202012Validator

from uoarm.testing._instance_builder import CHARACTERS, Builder, DrawnChoices, TooLargeError, chance

_OTHERS: tuple[object, ...] = (None, True, False, 0, 1, -1, 0.5, "", "a", [], [0], {}, {"x": 0})
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from hypothesis.strategies import DrawFn, SearchStrategy

    from uoarm.testing._instance_builder import Choices

Schema: TypeAlias = "bool | Mapping[str, object]"
_ATTEMPTS = 6
_TOO_LARGE = 2
"""Candidates that may become too large before a schema is given up: the next ones would, too."""


def mutate(choices: Choices, value: object) -> object:
    """A copy of ``value`` with one change: at this place, or one level deeper and so on."""
    if isinstance(value, dict) and value:
        return _mutate_object(choices, value)
    if isinstance(value, list) and value:
        return _mutate_array(choices, value)
    if chance(choices, 25):
        return choices.item(_OTHERS)
    if isinstance(value, bool) or value is None:
        return choices.item((True, False, None, 0, 1))
    if isinstance(value, int):
        return value + choices.item((1, -1, 0.5)) if abs(value) < 2**53 else value + 1
    if isinstance(value, float):
        return choices.item((value + 1, -value, round(value)))
    if isinstance(value, str):
        return _mutate_string(choices, value)
    return choices.item(_OTHERS)


def _mutate_string(choices: Choices, value: str) -> str:
    change = choices.item(("append", "drop", "replace"))
    if change == "append" or not value:
        return value + choices.item(CHARACTERS)
    place = choices.integer(0, len(value) - 1)
    replacement = "" if change == "drop" else choices.item(CHARACTERS)
    return value[:place] + replacement + value[place + 1 :]


def _mutate_array(choices: Choices, value: list[object]) -> object:
    change = choices.item(("drop", "repeat", "append", "rotate", "inside"))
    place = choices.integer(0, len(value) - 1)
    if change == "drop":
        return value[:place] + value[place + 1 :]
    if change == "repeat":
        return [*value, value[place]]
    if change == "append":
        return [*value, choices.item(_OTHERS)]
    if change == "rotate":
        return [*value[1:], value[0]]
    return [*value[:place], mutate(choices, value[place]), *value[place + 1 :]]


def _mutate_object(choices: Choices, value: dict[str, object]) -> object:
    change = choices.item(("drop", "add", "rename", "inside", "inside"))
    name = choices.item(list(value))
    changed = dict(value)
    if change == "drop":
        del changed[name]
    elif change == "add":
        changed[choices.item(("x", "", name + "_", name.upper()))] = choices.item(_OTHERS)
    elif change == "rename":
        changed[name + "x"] = changed.pop(name)
    else:
        changed[name] = mutate(choices, value[name])
    return changed


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
