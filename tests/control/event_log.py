"""Events as a manager logged them: each line read back as the event that it was.

An error is read back as of its class, without the class's other attributes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, get_args

from uoarm._control.engine.events import Event
from uoarm._control.engine.placement import Kind, LinkEnd, Part
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import FailoverPolicy, FailureLimits, Health, Plan, PortRef, Role, ValidationMode

# All events, and no other class of any module: a line of a log can have nothing else made.
_EVENTS: Mapping[str, Callable[..., Event]] = {kind.__name__: kind for kind in get_args(Event)}

FindPlan = Callable[[str, tuple[str, ...]], Plan]
"""Returns the plan of a function that consists of these components, producers first."""


def read_event(line: str, find_plan: FindPlan) -> tuple[Event, float]:
    """Return the event of a line that `write_event` made, and its time.

    Raises:
        KeyError: there is no such event.
    """
    fields: dict[str, Any] = json.loads(line)
    now, kind = fields.pop("at"), fields.pop("event")
    readers: dict[str, Callable[[Any], object]] = {**_READERS, "plan": partial(_plan, find_plan)}
    values = {
        name: readers[name](value) if name in readers else value for name, value in fields.items()
    }
    # A log of an earlier version lacks fields that came later, and plays with their defaults.
    return _EVENTS[kind](**values), now


def _plan(find_plan: FindPlan, words: list[str] | None) -> Plan | None:
    return None if words is None else find_plan(words[0], tuple(words[1:]))


def _error(value: list[str] | str | None) -> BaseException | str | None:
    if not isinstance(value, list):  # of some events the text is all that was known
        return value
    name, text, *reason = value
    kind = _error_class(name)
    made = kind.__new__(kind)  # its own __init__ may want what the log does not have
    made.args = (text,)
    for word in reason:
        vars(made)["reason"] = FailureReason(word) if isinstance(made, BridgeError) else word
    return made


def _error_class(name: str) -> type[BaseException]:
    """Return the error of uoarm or of a plugin that has this name; a stand-in where there is none.

    Only what is imported already is found: no line of a log has anything imported.
    """
    kinds: list[type[BaseException]] = [UoarmError]
    for kind in kinds:
        if kind.__name__ == name:
            return kind
        kinds += kind.__subclasses__()
    return type(name, (Exception,), {})


def _part(value: list[str] | str) -> object:
    if isinstance(value, str):
        return value
    role, *rest = value
    return LinkEnd(Role(role), *rest) if len(rest) > 1 else (Role(role), *rest)


_READERS: Mapping[str, Callable[[Any], object]] = {
    "wanted": lambda value: PortRef(*value),
    "validate": ValidationMode,
    "health": Health,
    "error": _error,
    "part": _part,
    "done": lambda value: tuple(Part(Kind(kind), *rest) for kind, *rest in value),
    "spared": frozenset,
    "policy": lambda value: FailoverPolicy(
        **{**value, "failing": FailureLimits(**value["failing"])}
    ),
    "superseded": frozenset,
    "functions": frozenset,
    "names": tuple,
    "replaced": frozenset,
}
