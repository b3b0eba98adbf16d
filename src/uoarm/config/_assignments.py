"""Assignments: numbers that bridges of several installations share, handed out so that none meet.

An option of a plugin may carry `x-uoarm-assign` in the plugin's options schema:

    "domain_id": {"type": "integer", "x-uoarm-assign": {"from": 64, "to": 101}}

Bridges of one plugin that run with several installations of it, each in hosts of its own, then
get a number each, the same in every run: those whose configuration names none, one for each
installation, in the order of the file, from the first of the range that nobody has.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from typing import Any

from attrs import evolve, frozen

from uoarm.bridge import BridgeType
from uoarm.errors import ConfigurationError
from uoarm.model import BridgeSpec, Options, Robot

__all__ = ["ASSIGN", "Assignable", "assign", "assignables", "installation"]

ASSIGN = "x-uoarm-assign"
_OF_A_HOST = ("environment", "python")


@frozen
class Assignable:
    """An option whose value uoarm may choose.

    Attributes:
        option: its name.
        numbers: what it may be.
        variable: an environment variable whose value is somebody else's and is not given out.
    """

    option: str
    numbers: range
    variable: str = ""

    def free(self, taken: set[object]) -> int | None:
        """Return the first number that nobody has."""
        theirs = os.environ.get(self.variable, "") if self.variable else ""
        return next(
            (number for number in self.numbers if number not in taken and str(number) != theirs),
            None,
        )


def assignables(kind: BridgeType) -> Iterator[Assignable]:
    """Yield the options of a plugin that uoarm may choose."""
    schema: Any = kind.options_schema
    properties = schema.get("properties", {}) if isinstance(schema, Mapping) else {}
    for name, option in properties.items():
        wish = option.get(ASSIGN) if isinstance(option, Mapping) else None
        if wish is not None:
            numbers = range(int(wish["from"]), int(wish["to"]) + 1)
            yield Assignable(name, numbers, str(wish.get("except_variable", "")))


def installation(host: object) -> str:
    """Name the installation that a bridge runs with, from its `host:`; empty: our own."""
    if not isinstance(host, Mapping):
        return ""
    return " ".join(f"{name} {host[name]}" for name in _OF_A_HOST if host.get(name))


def assign(robot: Robot, types: Mapping[str, BridgeType]) -> Robot:
    """Return the robot with the options of its bridges filled in; see `BridgeSpec.assigned`.

    Raises:
        ConfigurationError: a range has fewer numbers than there are installations.
    """
    bridges = dict(robot.bridges)
    for plugin, kind in types.items():
        specs = [spec for spec in robot.bridges.values() if spec.plugin == plugin]
        if len({installation(spec.host) for spec in specs}) > 1:
            for assignable in assignables(kind):
                bridges |= {spec.name: spec for spec in _assigned(assignable, specs, bridges)}
    return evolve(robot, bridges=bridges)


def _assigned(
    one: Assignable, specs: list[BridgeSpec], bridges: Mapping[str, BridgeSpec]
) -> Iterator[BridgeSpec]:
    """Yield the bridges that get a number; others keep their default: in our process, elsewhere."""
    taken: set[object] = {spec.options.get(one.option) for spec in specs}
    chosen: dict[str, int] = {}
    for spec in specs:
        if spec.host is None or "machine" in spec.host or one.option in spec.options:
            continue
        place = installation(spec.host)
        if place not in chosen:
            number = one.free(taken)
            if number is None:
                raise ConfigurationError(
                    f"bridge {spec.name!r}: no {one.option} is left between {one.numbers[0]} and "
                    f"{one.numbers[-1]}; write one under `options`"
                )
            chosen[place] = number
            taken.add(number)
        yield _with(bridges[spec.name], {one.option: chosen[place]})


def _with(spec: BridgeSpec, chosen: Options) -> BridgeSpec:
    return evolve(spec, options={**spec.options, **chosen}, assigned={**spec.assigned, **chosen})
