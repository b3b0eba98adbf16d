"""Arguments of the public functions: a wrong type is refused by name, before anything is done."""

from __future__ import annotations

import collections.abc
import functools
import inspect
import sys
import types
from collections.abc import Callable, Mapping
from os import PathLike
from typing import (
    Any,
    ParamSpec,
    TypeAlias,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from uoarm._encodable import shown
from uoarm._spelling import did_you_mean
from uoarm.errors import UsageError

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
_Kinds: TypeAlias = tuple[type, ...]

_SHOWN = 60


class _CallbackType(type):
    def __instancecheck__(cls, value: object) -> bool:
        return callable(value) and not _is_coroutine_function(value)


class _Callback(metaclass=_CallbackType):
    """What a hint such as `Callable[[T], None]` takes: what `async def` makes, nothing awaits."""


_WORDS: Mapping[Any, str] = {
    _Callback: "something that can be called",
    str: "a text",
    bytes: "octets",
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    type(None): "None",
    collections.abc.Callable: "something that can be called",
    collections.abc.Mapping: "a mapping",
    PathLike: "a path",
}


def arguments(**instead: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Have a function refuse arguments of other types than its hints say, with a UsageError.

    What is inside of a container is not looked at, nor what a hint leaves open. Hints are read at
    the first call.

    Args:
        instead: for a parameter by name, what else may have been meant, as a sentence; `more` is
            for what is beyond the parameters.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        checker = _Checker(function, instead)
        if inspect.iscoroutinefunction(function):

            @functools.wraps(function)
            async def checked_later(*args: P.args, **kwargs: P.kwargs) -> Any:
                checker.check(args, kwargs)
                return await function(*args, **kwargs)

            return cast("Callable[P, R]", checked_later)

        @functools.wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            checker.check(args, kwargs)
            return function(*args, **kwargs)

        return checked

    return decorate


def built_with_arguments(kind: type[T]) -> type[T]:
    """Have a class of attrs refuse arguments of other types; decorates what attrs made."""
    made: Any = kind
    made.__init__.__module__ = kind.__module__  # where its hints are read
    made.__init__ = arguments()(made.__init__)
    return kind


class _Checker:
    """Holds the arguments of calls against the hints of one function."""

    def __init__(self, function: Callable[..., Any], instead: Mapping[str, str]) -> None:
        self._function = function
        self._instead = instead
        self._kinds: dict[str, _Kinds] = {}
        self._known: tuple[str, ...] = ()
        self._takes_more = False, False  # by position, by name
        self._positional: list[str] | None = None  # written last: others then read all the rest

    def check(self, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> None:
        """Refuse a call with an argument of another type.

        Raises:
            UsageError: there is one; the text has what was expected and what came.
        """
        mistake = self._mistake(args, kwargs)
        if mistake:
            raise UsageError(f"{self._called_as(args)}: {mistake}")

    def _mistake(self, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> str:
        """Return what is wrong with a call, first of all; empty: nothing."""
        positional = self._positional
        if positional is None:
            positional = self._read()
        kinds = self._kinds
        if len(args) > len(positional) and not self._takes_more[0]:
            return self._beyond(args[len(positional)])
        for name, value in zip(positional, args, strict=False):
            if name in kinds and not _is(value, kinds[name]):
                return self._wrong(name, value)
        for name, value in kwargs.items():
            if name in kinds and not _is(value, kinds[name]):
                return self._wrong(name, value)
            if name not in self._known and not self._takes_more[1]:
                return f"there is no argument {name!r}{did_you_mean(name, self._known)}"
        return ""

    def _called_as(self, args: tuple[Any, ...]) -> str:
        """Return the function's name; of a method with the class that its caller knows."""
        owner, _, name = self._function.__qualname__.rpartition(".")
        if args and self._positional and self._positional[0] in {"self", "cls"}:
            of = args[0] if isinstance(args[0], type) else type(args[0])
            owner = of.__qualname__
        called = f"{owner}.{name}" if owner else name
        return called.removesuffix(".__init__")

    def _read(self) -> list[str]:
        parameters = inspect.signature(self._function).parameters.values()
        self._known = tuple(parameter.name for parameter in parameters)
        kinds = {parameter.kind for parameter in parameters}
        self._takes_more = (
            inspect.Parameter.VAR_POSITIONAL in kinds,
            inspect.Parameter.VAR_KEYWORD in kinds,
        )
        module = sys.modules[self._function.__module__]
        hints = get_type_hints(self._function, globalns=vars(module))
        for parameter in parameters:
            known = _kinds_of(hints.get(parameter.name, Any))
            if known and parameter.kind not in {parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD}:
                self._kinds[parameter.name] = known
        self._positional = [
            parameter.name
            for parameter in parameters
            if parameter.kind in {parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD}
        ]
        return self._positional

    def _beyond(self, value: object) -> str:
        assert self._positional is not None, "it was read"
        named = [name for name in self._known if name not in self._positional]
        taken = ", ".join(name for name in self._positional if name != "self") or "nothing"
        more = f", by name {', '.join(named)}" if named else ""
        hint = f"; {self._instead['more']}" if "more" in self._instead else ""
        return f"takes {taken} by position{more}; got {_shown(value)} too{hint}"

    def _wrong(self, name: str, value: object) -> str:
        words = [_WORDS.get(kind) or _article(kind.__name__) for kind in self._kinds[name]]
        expected = words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
        hint = f"; {self._instead[name]}" if name in self._instead else ""
        return f"{name}: expected {expected}, got {_shown(value)}{hint}"


def _is(value: object, kinds: _Kinds) -> bool:
    if value.__class__ is bool:  # which is a number to Python
        return bool in kinds or object in kinds
    if isinstance(value, kinds):
        return True
    # Scalars of numpy are numbers, and say so.
    return (float in kinds and hasattr(value, "__float__")) or (
        int in kinds and hasattr(value, "__index__")
    )


def _kinds_of(hint: Any) -> _Kinds:
    """Return the classes of which a value must be; none where the hint leaves that open."""
    origin = get_origin(hint)
    if origin in {Union, types.UnionType}:
        parts = [_kinds_of(part) for part in get_args(hint)]
        return tuple(kind for part in parts for kind in part) if all(parts) else ()
    if hint is None:
        return (type(None),)
    if origin is collections.abc.Callable and get_args(hint)[-1] in {None, types.NoneType}:
        return (_Callback,)
    kind = hint if origin is None else origin
    if kind in {object, Any} or not inspect.isclass(kind) or kind is type:
        return ()
    if getattr(kind, "_is_protocol", False) and not getattr(kind, "_is_runtime_protocol", False):
        return ()
    return (kind,)


def _is_coroutine_function(value: object) -> bool:
    # Of a function, or of the class that has it: what else is asked of an object may be answered by
    # its own code, which raises, or takes its time.
    while isinstance(value, functools.partial):
        value = value.func
    if isinstance(value, types.MethodType):
        value = value.__func__
    if not isinstance(value, types.FunctionType):
        value = inspect.getattr_static(type(value), "__call__", None)
    return isinstance(value, types.FunctionType) and inspect.iscoroutinefunction(value)


def _article(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


def _shown(value: object) -> str:
    if isinstance(value, str):
        text = value if len(value) <= _SHOWN else f"{value[:_SHOWN]}..."
        return f"the text {text!r}"
    if value is None or isinstance(value, bool | int | float):
        return shown(value)
    if inspect.isclass(value):
        return f"the class {value.__name__}"
    if _is_coroutine_function(value):
        return "a coroutine function, which nothing awaits: have a function make a task of it"
    return _article(type(value).__name__)
