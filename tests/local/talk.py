"""A component of the python bridge, asked without a manager."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from uoarm.bridge import Description
from uoarm.local import PythonBridge, PythonOptions
from uoarm.model import Endpoint, Message, MessageStructure, Role
from uoarm.testing import Collector, patience

ANY = MessageStructure(True)


@contextmanager
def bridge(**options: Any) -> Iterator[PythonBridge]:
    made = PythonBridge("p", PythonOptions.of(options))
    try:
        yield made
    finally:
        made.close(timeout=patience())


def at(name: str, role: Role, port: str = "default", **parameters: Any) -> Endpoint:
    address = (name if ":" in name else f"tests.local.typed_parts:{name}",)
    return Endpoint("p", name, role, address, port, parameters=parameters)


def describe(name: str, role: Role, **parameters: Any) -> Description:
    with bridge() as made:
        return made.describe(at(name, role, **parameters))


def call(name: str, message: Message, **parameters: Any) -> Message:
    with bridge() as made:
        return made.call(at(name, Role.SERVICE, **parameters), message, timeout=patience())


def through(name: str, message: Message, count: int = 1, **parameters: Any) -> list[Message]:
    """Return what a component gives for a message."""
    taken = Collector()
    with bridge() as made:
        made.open_source(
            at(name, Role.OUTPUT, **parameters), ANY, taken.deliver, timeout=patience()
        )
        sink = made.open_sink(at(name, Role.INPUT, **parameters), ANY, timeout=patience())
        sink.send(message)
        return taken.wait(count)


def given(name: str, count: int = 1, **parameters: Any) -> list[Message]:
    """Return the first messages of a source."""
    taken = Collector()
    with bridge() as made:
        made.open_source(
            at(name, Role.OUTPUT, **parameters), ANY, taken.deliver, timeout=patience()
        )
        return taken.wait(count)
