"""Targets: finding the Python object behind `module:attribute`, and its message structures."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from attrs import frozen

from uoarm.bridge import Description
from uoarm.errors import BridgeError, FailureReason
from uoarm.local._hints import HintError, schema_of
from uoarm.local._modules import Modules, written_name
from uoarm.model import Endpoint, MessageStructure, Options, Role, Schema

__all__ = ["Target", "find", "structure"]

F = TypeVar("F", bound=Callable[..., Any])
_DECLARED = "__uoarm_structures__"


def structure(
    *,
    input: Schema | None = None,  # noqa: A002 - the port's own name
    output: Schema | None = None,
    request: Schema | None = None,
    reply: Schema | None = None,
) -> Callable[[F], F]:
    """Declare the message structures of a component instead of hinting them."""
    given = {"input": input, "output": output, "request": request, "reply": reply}

    def mark(target: F) -> F:
        setattr(target, _DECLARED, {key: one for key, one in given.items() if one is not None})
        return target

    return mark


@frozen
class Target:
    """A Python object that can be a component: a function, a generator function or a class."""

    name: str
    value: Any

    @property
    def is_class(self) -> bool:
        """Whether an instance is built for each component."""
        return inspect.isclass(self.value)

    def method(self, endpoint: Endpoint) -> Any:
        """Return the callable behind a port, unbound.

        Raises:
            BridgeError: there is none.
        """
        if not self.is_class:
            return self.value
        if endpoint.role is Role.OUTPUT:
            name = "__iter__" if hasattr(self.value, "__iter__") else "__call__"
        else:
            name = "__call__" if endpoint.port == "default" else endpoint.port
        found = getattr(self.value, name, None)
        if found is None:
            text = f"{self.name} has no method {name!r} for the port {endpoint.port!r}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return found

    def describe(self, endpoint: Endpoint) -> Description:
        """Return the structures of a port, from its declaration or its hints.

        Raises:
            BridgeError: it has no such port, or a hint without a structure.
        """
        method = self.method(endpoint)
        declared: Mapping[str, Schema] = getattr(self.value, _DECLARED, {})
        declared = {**declared, **getattr(method, _DECLARED, {})}
        given = endpoint.parameters
        if endpoint.role is Role.SERVICE:
            return Description(
                request=self._structure(declared.get("request"), method, given, taken=True),
                reply=self._structure(declared.get("reply"), method, given, taken=False),
            )
        if endpoint.role is Role.INPUT:
            return Description(self._structure(declared.get("input"), method, given, taken=True))
        if endpoint.port != "default":
            return Description()
        return Description(self._structure(declared.get("output"), method, given, taken=False))

    def takes_messages(self, endpoint: Endpoint) -> bool:
        """Say whether the callable behind a port is called with messages, or is a source."""
        if self.is_class and endpoint.role is Role.OUTPUT and hasattr(self.value, "__iter__"):
            return False
        method = self.method(endpoint)
        return message_parameter(method, endpoint.parameters, bound=self.is_class) is not None

    def _structure(
        self, declared: Schema | None, method: Any, given: Options, *, taken: bool
    ) -> MessageStructure | None:
        if declared is not None:
            return MessageStructure(declared)
        hint = self._taken_hint(method, given) if taken else _return_hint(method)
        if hint is inspect.Parameter.empty:
            return None
        try:
            return MessageStructure(schema_of(hint), native_type=getattr(hint, "__name__", ""))
        except HintError as error:
            raise HintError(f"{self.name}: {error}") from error

    def _taken_hint(self, method: Any, given: Options) -> Any:
        name = message_parameter(method, given, bound=self.is_class)
        if name is None:
            text = f"{self.name} takes no message: every parameter has a value"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return get_type_hints(method, include_extras=True).get(name, inspect.Parameter.empty)


def find(address: Sequence[str], modules: Modules) -> Target:
    """Import the object that an address names.

    Args:
        address: one string, `module:attribute`.
        modules: those of the bridge.

    Raises:
        BridgeError: NOT_FOUND for a module or attribute that is not there, UNAVAILABLE when a
            package that the module needs is not installed, BAD_ENDPOINT for anything else.
    """
    name = address[0] if len(address) == 1 else ""
    module_name, colon, attribute = name.partition(":")
    if not colon or not module_name or not attribute:
        text = f"expected one string 'module:attribute', got {list(address)}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    value: Any = _import(module_name, modules)
    for part in attribute.split("."):
        if not hasattr(value, part):
            close = difflib.get_close_matches(part, dir(value), n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            text = f"module {module_name!r} has no {attribute!r}{hint}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        value = getattr(value, part)
    if not callable(value):
        text = f"{name} is a {type(value).__name__}: expected a function or a class"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    return Target(name, value)


def message_parameter(method: Any, given: Options, *, bound: bool) -> str | None:
    """Return the name of the parameter that takes the message: the first that nothing fills."""
    parameters = list(inspect.signature(method).parameters.values())[1 if bound else 0 :]
    for one in parameters:
        positional = one.kind in {one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD}
        if positional and one.default is one.empty and (bound or one.name not in given):
            return one.name
    return None


def _return_hint(method: Any) -> Any:
    hint = get_type_hints(method, include_extras=True).get("return", inspect.Parameter.empty)
    origin = get_origin(hint)
    if inspect.isclass(origin) and issubclass(origin, Iterator):
        return get_args(hint)[0]
    arguments = get_args(hint)
    if type(None) in arguments and len(arguments) == 2:  # noqa: PLR2004 - X | None: None is silence
        return next(one for one in arguments if one is not type(None))
    return hint


def _import(name: str, modules: Modules) -> Any:
    try:
        return modules.load(name)
    except ModuleNotFoundError as error:
        missing = written_name(error.name or name)
        if name == missing or name.startswith(f"{missing}."):
            text = f"there is no module {name!r} (looked in {modules})"
            raise BridgeError(text, FailureReason.NOT_FOUND) from error
        text = f"module {name!r} needs the package {missing!r}, which is not installed"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    except ImportError as error:
        raise BridgeError(f"module {name!r}: {error}", FailureReason.UNAVAILABLE) from error
