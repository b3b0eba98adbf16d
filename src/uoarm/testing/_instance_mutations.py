"""Near misses: one small change somewhere in a message."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uoarm.testing._choices import CHARACTERS, chance

if TYPE_CHECKING:
    from uoarm.testing._choices import Choices

_OTHERS: tuple[object, ...] = (None, True, False, 0, 1, -1, 0.5, "", "a", [], [0], {}, {"x": 0})


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
