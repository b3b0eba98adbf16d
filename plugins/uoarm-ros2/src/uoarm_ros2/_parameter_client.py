"""Sets the parameters of a node by its services, after a look at what it says of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Message
from uoarm_ros2._parameters import holds, value_for

__all__ = ["ParameterClient"]

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
        # A node tells no values at all where one of them has none yet.
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
    """Return names in words, of many the first."""
    ordered = sorted(names)
    more = f" and {len(ordered) - _MOST_NAMED} more" if len(ordered) > _MOST_NAMED else ""
    return (", ".join(ordered[:_MOST_NAMED]) or "none") + more
