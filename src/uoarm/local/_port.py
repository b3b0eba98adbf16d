"""Ports of a Python object: what is known of each, and what converts its messages."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from uoarm._hints.convert import reader, writer
from uoarm.model import Endpoint, Message, Role

if TYPE_CHECKING:
    from uoarm.local._target import Target

T = TypeVar("T")
_NOTHING = inspect.Parameter.empty


class _made_once(Generic[T]):  # noqa: N801 - read as a property is
    """What is made when it is first needed; perhaps by two threads, of which the last one counts.

    Not `functools.cached_property`: before CPython 3.12 all objects of a class share its lock, so
    that a hint that takes long to read would hold up every other port.
    """

    def __init__(self, make: Callable[[Any], T]) -> None:
        self._make = make

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, port: TargetPort, owner: type) -> T:
        made = vars(port)[self._name] = self._make(port)
        return made


class TargetPort:
    """What is known of a port and what converts its messages, each made when first needed."""

    def __init__(self, target: Target, endpoint: Endpoint) -> None:
        self._target = target
        self._endpoint = endpoint

    @_made_once
    def takes_messages(self) -> bool:
        """Whether the callable behind it is called with messages, or is a source."""
        target, endpoint = self._target, self._endpoint
        if target.is_class and endpoint.role is Role.OUTPUT:
            return target.source_name() is None
        return target.first_unfilled(target.method(endpoint), endpoint.parameters) is not None

    @_made_once
    def is_quick(self) -> bool:
        """Whether opening and closing it runs no code of the component.

        That is so for a function that takes messages and for a generator function. A class is
        built and closed, another callable is called to be iterated over, and parameters are made
        by what their hints say.
        """
        value = self._target.value
        return (
            not self._endpoint.parameters
            and inspect.isfunction(value)
            and (inspect.isgeneratorfunction(value) or self.takes_messages)
        )

    @_made_once
    def reader(self) -> Callable[[Message], Any] | None:
        """What makes the value that it takes of a message; None: the message is that.

        Raises:
            HintError: its hint cannot be converted.
        """
        target, endpoint = self._target, self._endpoint
        name = target.message_parameter(endpoint)
        return reader(target.hints(target.method(endpoint)).get(name, _NOTHING), target.name)

    @_made_once
    def writer(self) -> Callable[[Any], Message] | None:
        """What makes a message of what it gives, or of what answers what it takes.

        Raises:
            HintError: its hint cannot be converted.
        """
        target, endpoint = self._target, self._endpoint
        method = target.method(endpoint)
        hint = _NOTHING if method is None else target.return_hint(endpoint, target.hints(method))
        return writer(hint, target.name)

    def require_conversion(self) -> None:
        """Refuse hints that could not be converted when it opens.

        Raises:
            HintError: that is so.
        """
        _ = self._endpoint.role is Role.OUTPUT or self.reader
        _ = self.writer
