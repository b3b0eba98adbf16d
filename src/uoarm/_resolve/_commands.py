"""Inputs that move something: their stop message and their limits, held against the structure."""

from __future__ import annotations

from collections.abc import Iterator

from uoarm._adapt import number_problem
from uoarm._dataplane import make_check
from uoarm._resolve._protocols import Structures
from uoarm.errors import MessageError
from uoarm.model import (
    CommandPolicy,
    Component,
    Edge,
    Input,
    MessageStructure,
    Output,
    Reason,
    ValidationMode,
)

__all__ = ["command_mistakes", "lifetime_warnings"]


def command_mistakes(component: Component, structures: Structures) -> tuple[Reason, ...]:
    """Return why inputs of a component could not be stopped or limited as they should."""
    return tuple(
        reason
        for port in component.inputs
        if port.endpoint.command is not None
        for reason in _mistakes(
            f"input {port.name!r}", port.endpoint.command, structures.by_port[f"input.{port.name}"]
        )
    )


def lifetime_warnings(edge: Edge, output: Output, port: Input) -> tuple[str, ...]:
    """Warn of commands that expire before the output that feeds them is due to renew them."""
    command = port.endpoint.command
    if command is None or command.lifetime is None or output.expect is None:
        return ()
    period = 1 / output.expect.rate
    if period < command.lifetime:
        return ()
    place = f"{edge.producer}.{edge.output} -> {edge.consumer}.{edge.input}"
    lives = f"commands live for {command.lifetime:g} s, and the next one comes after {period:g} s"
    return (f"{place}: {lives}: the stop message will follow each",)


def _mistakes(place: str, command: CommandPolicy, structure: MessageStructure) -> Iterator[Reason]:
    if command.stop is not None:
        check = make_check(structure, ValidationMode.ALWAYS, f"the stop message of its {place}")
        assert check is not None, "it is not off"
        try:
            check(command.stop.message)
        except MessageError as error:
            yield Reason(str(error))
    for limit in command.limits:
        problem = number_problem(structure, limit.path)
        if problem:
            yield Reason(f"limits of its {place}: {problem}", path=limit.path)
