"""Events as lines of a log, and back: what happened in the field becomes a test by pasting it.

A plan is written as its function and its components, by which whoever reads the log finds it in the
robot's configuration. An error is written as the name of its class, its text and, where it has one,
its reason; it is read back as of that class, without the class's other attributes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any

import attrs

from uoarm._control.reconciler import events
from uoarm._control.reconciler.state import Kind, Part
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import FailoverPolicy, FailureLimits, Health, Plan, PortRef, Role, ValidationMode

__all__ = ["FindPlan", "read", "write"]

FindPlan = Callable[[str, tuple[str, ...]], Plan]
"""Returns the plan of a function that consists of these components, producers first."""


def write(event: events.Event, now: float) -> str:
    """Return an event as one line of JSON."""
    fields = {field.name: _plain(getattr(event, field.name)) for field in attrs.fields(type(event))}
    return json.dumps({"at": now, "event": type(event).__name__, **fields})


def read(line: str, find_plan: FindPlan) -> tuple[events.Event, float]:
    """Return the event of a line that `write` made, and its time.

    Raises:
        KeyError: there is no such event.
    """
    said: dict[str, Any] = json.loads(line)
    now, kind = said.pop("at"), said.pop("event")
    readers: dict[str, Callable[[Any], object]] = dict(_READERS)
    readers["plan"] = lambda told: _plan(told, find_plan)
    values = {name: readers.get(name, _same)(value) for name, value in said.items()}
    make: Callable[..., events.Event] = getattr(events, kind)
    return make(**values), now


def _plain(value: object) -> object:
    if isinstance(value, Plan):
        return [value.function, *(step.component.name for step in value.steps)]
    if isinstance(value, BaseException):
        reason = getattr(value, "reason", None)
        reports = [type(value).__name__, str(value)]
        return reports if reason is None else [*reports, _plain(reason)]
    if isinstance(value, PortRef):
        return [value.function, value.port]
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, frozenset):
        return [_plain(item) for item in sorted(value)]
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, FailoverPolicy):
        return attrs.asdict(value)
    return value


def _plan(told: list[str] | None, find_plan: FindPlan) -> Plan | None:
    return None if told is None else find_plan(told[0], tuple(told[1:]))


def _error(told: list[str] | str | None) -> BaseException | str | None:
    if not isinstance(told, list):
        return told
    name, text, *reason = told
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


def _part(told: list[str] | str) -> object:
    return told if isinstance(told, str) else (Role(told[0]), told[1])


def _same(value: object) -> object:
    return value


_READERS: Mapping[str, Callable[[Any], object]] = {
    "wanted": lambda told: PortRef(*told),
    "validate": ValidationMode,
    "health": Health,
    "error": _error,
    "part": _part,
    "done": lambda told: tuple(Part(Kind(kind), *rest) for kind, *rest in told),
    "spared": frozenset,
    "policy": lambda told: FailoverPolicy(**{**told, "failing": FailureLimits(**told["failing"])}),
    "superseded": frozenset,
    "functions": frozenset,
}
