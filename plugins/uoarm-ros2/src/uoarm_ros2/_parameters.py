"""Parameters of nodes: plain values, checked by a node's descriptors, set by its services."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from uoarm.bridge import shown
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Message, Options

_BOOL, _INTEGER, _DOUBLE, _STRING, _BYTES, _BOOLS, _INTEGERS, _DOUBLES, _STRINGS = range(1, 10)
# Names of rcl_interfaces/msg/ParameterValue; a list is read as the first of these that takes it.
_FIELDS = {
    _BOOL: "bool_value",
    _INTEGER: "integer_value",
    _DOUBLE: "double_value",
    _STRING: "string_value",
    _BYTES: "byte_array_value",
    _BOOLS: "bool_array_value",
    _INTEGERS: "integer_array_value",
    _DOUBLES: "double_array_value",
    _STRINGS: "string_array_value",
}
_EMPTY: Mapping[str, object] = {
    "bool_value": False,
    "integer_value": 0,
    "double_value": 0.0,
    "string_value": "",
    **{_FIELDS[kind]: [] for kind in (_BYTES, _BOOLS, _INTEGERS, _DOUBLES, _STRINGS)},
}
_WORDS = {
    _BOOL: "a boolean",
    _INTEGER: "an integer of 64 bits",
    _DOUBLE: "a number",
    _STRING: "a text",
    _BYTES: "a list of integers from 0 to 255",
    _BOOLS: "a list of booleans",
    _INTEGERS: "a list of integers of 64 bits",
    _DOUBLES: "a list of numbers",
    _STRINGS: "a list of texts",
}
_OF_ONE = {_BOOLS: _BOOL, _INTEGERS: _INTEGER, _DOUBLES: _DOUBLE, _STRINGS: _STRING}
# A parameter of any type may have a range, which says nothing of a text.
_RANGES = {
    _INTEGER: "integer_range",
    _INTEGERS: "integer_range",
    _DOUBLE: "floating_point_range",
    _DOUBLES: "floating_point_range",
}
_is_near = partial(math.isclose, rel_tol=1e-6)  # as rclpy takes it
_MOST = 1000
_MOST_ELEMENTS = 100_000
_DEEPEST = 16


def flattened(parameters: Options) -> dict[str, object]:
    """Return parameters by their full names: `{camera: {fps: 30}}` is `camera.fps`.

    Raises:
        ValueError: a value is none that a parameter can have, or there are too many.
    """
    found = dict(_leaves(parameters, "", 0))
    if len(found) > _MOST:
        raise ValueError(f"there are {len(found)} parameters, of which {_MOST} may be")
    for name, value in found.items():
        if _kind_of(value) is None and value != []:
            expected = "a boolean, a number, a text or a list of one of these"
            raise ValueError(f"parameter {name}: expected {expected}, got {shown(value)}")
    return found


def mistakes(parameters: Options) -> dict[str, str]:
    """Return what is wrong with parameters before any node is asked, by the name as written."""
    found = {}
    for name, value in parameters.items():
        try:
            flattened({name: value})
        except ValueError as error:
            found[name] = str(error)
    return found


def value_for(value: object, descriptor: Mapping[str, Any]) -> Message:
    """Return a value as the message that sets a parameter.

    Args:
        value: of `flattened`.
        descriptor: what the node says of the parameter, rcl_interfaces/msg/ParameterDescriptor.

    Raises:
        ValueError: it is of another type, or outside the range.
    """
    stated = 0 if descriptor["dynamic_typing"] else int(descriptor["type"])
    kind = stated or _kind_of(value)
    if kind is None:
        raise ValueError("of an empty list the node does not say what it would hold")
    value = _listed(value)
    if not _TAKES[kind](value):
        raise ValueError(f"expected {_WORDS[kind]}, got {shown(value)}")
    _in_range(kind, value, descriptor)
    return {"type": kind, **_EMPTY, _FIELDS[kind]: _as_sent(kind, value)}


def holds(current: Mapping[str, Any], wanted: Mapping[str, Any]) -> bool:
    """Whether a parameter has a value already; both rcl_interfaces/msg/ParameterValue."""
    if current["type"] != wanted["type"]:
        return False
    field = _FIELDS[wanted["type"]]
    given, asked = current[field], wanted[field]
    return bool(list(given) == asked if isinstance(asked, list) else given == asked)


def _leaves(value: Mapping[str, object], prefix: str, depth: int) -> Iterator[tuple[str, object]]:
    if depth >= _DEEPEST:
        raise ValueError(f"parameter {prefix.rstrip('.')}: names are nested too deeply")
    for name, item in value.items():
        if isinstance(item, Mapping):
            yield from _leaves(item, f"{prefix}{name}.", depth + 1)
        else:
            yield f"{prefix}{name}", _listed(item)


def _listed(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def _kind_of(value: object) -> int | None:
    """Return the type that a value has where the node does not say one."""
    kinds = (_BOOL, _INTEGER, _DOUBLE, _STRING, _BOOLS, _INTEGERS, _DOUBLES, _STRINGS)
    return next((kind for kind in kinds if value != [] and _TAKES[kind](value)), None)


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and -(2**63) <= value < 2**63


def _is_number(value: object) -> bool:
    return isinstance(value, float) or _is_integer(value)


def _is_octet(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**8


def _each(check: Callable[[object], bool]) -> Callable[[object], bool]:
    def is_list_of(value: object) -> bool:
        return isinstance(value, list) and len(value) <= _MOST_ELEMENTS and all(map(check, value))

    return is_list_of


_SINGLE: dict[int, Callable[[object], bool]] = {
    _BOOL: lambda value: isinstance(value, bool),
    _INTEGER: _is_integer,
    _DOUBLE: _is_number,
    _STRING: lambda value: isinstance(value, str) and "\0" not in value,
}
_TAKES = {
    **_SINGLE,
    _BYTES: _each(_is_octet),
    **{several: _each(_SINGLE[item]) for several, item in _OF_ONE.items()},
}


def _as_sent(kind: int, value: Any) -> object:
    if kind == _DOUBLE:
        return float(value)
    return [float(item) for item in value] if kind == _DOUBLES else value


def _in_range(kind: int, value: Any, descriptor: Mapping[str, Any]) -> None:
    """Raise ValueError for a number outside the range of its type.

    Steps of floats, and whether one is near enough to the end of its range, are left to the node.
    """
    for stated in descriptor[_RANGES[kind]] if kind in _RANGES else ():
        low, high, step = stated["from_value"], stated["to_value"], stated["step"]
        for item in value if isinstance(value, list) else [value]:
            near = isinstance(low, float) and any(_is_near(item, end) for end in (low, high))
            if not low <= item <= high and not near:
                raise ValueError(f"expected {low:g} to {high:g}, got {item:g}")
            whole = isinstance(step, int) and step > 1 and item != high
            if whole and (item - low) % step:
                raise ValueError(f"expected {low} to {high} in steps of {step}, got {item}")


_SECONDS = 5.0
_MOST_NAMED = 30


class ParameterClient:
    """The parameters of one node, as its services show them.

    Args:
        node: its full name.
        ask: calls one of its services by name and type, within so many seconds.
    """

    def __init__(self, node: str, ask: Callable[[str, str, Message, float], Any]) -> None:
        self._node = node
        self._ask = ask

    def set(
        self, parameters: Mapping[str, object], *, some_are_unknown: bool = False
    ) -> dict[str, object]:
        """Set those that have other values, all at once; return those that are not declared.

        Raises:
            BridgeError: one does not fit what the node says of it, or is not declared although
                `some_are_unknown` is false: nothing is set then; or the node refuses.
        """
        listed = self._call("list_parameters", "ListParameters", {"prefixes": [], "depth": 0})
        known = set(listed["result"]["names"])
        unknown = {name: value for name, value in parameters.items() if name not in known}
        if unknown and not some_are_unknown:
            raise self._refused(next(iter(unknown)), f"it declares {_some(known)}")
        changes = self._changes({n: value for n, value in parameters.items() if n in known})
        if changes:
            asked = {"parameters": changes}
            report = self._call("set_parameters_atomically", "SetParametersAtomically", asked)
            if not report["result"]["successful"]:
                names = _some(str(change["name"]) for change in changes)
                raise self._refused(names, f"the node says {report['result']['reason']!r:.300}")
        return unknown

    def _changes(self, parameters: Mapping[str, object]) -> list[dict[str, object]]:
        if not parameters:
            return []
        names = {"names": list(parameters)}
        descriptors = self._call("describe_parameters", "DescribeParameters", names)["descriptors"]
        # A node returns no values at all where one of them has none yet.
        values = self._call("get_parameters", "GetParameters", names)["values"]
        changes: list[dict[str, object]] = []
        if len(descriptors) != len(parameters):
            raise self._refused(_some(parameters), "it does not describe them")
        for place, (name, wanted) in enumerate(parameters.items()):
            try:
                value = value_for(wanted, descriptors[place])
            except ValueError as error:
                raise self._refused(name, str(error)) from None
            if len(values) == len(parameters) and holds(values[place], value):
                continue
            if descriptors[place]["read_only"]:
                raise self._refused(name, "it is read-only, and has another value")
            changes.append({"name": name, "value": value})
        return changes

    def _refused(self, name: str, why: str) -> BridgeError:
        text = f"parameter {name} of node {self._node}: {why}"
        return BridgeError(text, FailureReason.REFUSED)

    def _call(self, service: str, kind: str, request: Message) -> Any:
        return self._ask(service, f"rcl_interfaces/srv/{kind}", request, _SECONDS)


def _some(names: Iterable[str]) -> str:
    """Return names as a text, of many the first."""
    ordered = sorted(names)
    more = f" and {len(ordered) - _MOST_NAMED} more" if len(ordered) > _MOST_NAMED else ""
    return (", ".join(ordered[:_MOST_NAMED]) or "none") + more
