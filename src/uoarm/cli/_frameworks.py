"""Frameworks: which are installed, in which versions, whether they are reachable, what is there."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import click
from attrs import frozen

from uoarm._checks import plugin_facts
from uoarm.bridge import Registry
from uoarm.cli._discover import looking
from uoarm.cli._file import STANDARD
from uoarm.cli._shared import BRIDGE, print_json
from uoarm.cli._width import fitted
from uoarm.model import BridgeFindings

__all__ = ["show_frameworks"]

_SECONDS = 10.0


@frozen
class Framework:
    """What is known of one framework.

    Attributes:
        bridge: that reaches it; empty where its plugin is broken.
        plugin: of the bridge.
        is_configured: whether the configuration has the bridge.
        is_reachable: whether the bridge answered.
        cause: why it did not.
        facts: what its plugin finds here, versions among it.
        components: that the bridge sees, by the framework's names.
        ports: how many these have.
        functions: that these provide, or may provide, in the configuration.
    """

    bridge: str
    plugin: str
    is_configured: bool
    is_reachable: bool
    cause: str
    facts: Mapping[str, str]
    components: tuple[str, ...] = ()
    ports: int = 0
    functions: tuple[str, ...] = ()

    def __str__(self) -> str:
        state = "reachable" if self.is_reachable else f"not reachable: {self.cause}"
        lines = [f"{self.bridge or self.plugin}  {self.plugin}  {state}"]
        lines += [f"  {name}: {fact}" for name, fact in self.facts.items()]
        if self.is_reachable:
            lines.append(f"  sees components: {len(self.components)}, ports: {self.ports}")
        if self.functions:
            lines.append(f"  for {', '.join(self.functions)}")
        return "\n".join(lines)


def show_frameworks(file: str, *, as_json: bool) -> None:
    """Print what is known of every framework; without the file, of those that are installed."""
    with looking(file if file != STANDARD or Path(file).exists() else None) as (robot, given):
        findings = robot.discover(timeout=_SECONDS)
        provided: dict[str, dict[str, None]] = {}
        for component in robot.config.components():
            provided.setdefault(component.bridge, {})[component.function] = None
        facts = plugin_facts(robot.registry)
        found = [
            _framework(
                finding,
                facts,
                finding.bridge in given.bridges,
                tuple(provided.get(finding.bridge, ())),
            )
            for finding in findings
        ]
        found += _broken(robot.registry, facts)
    if as_json:
        print_json(found)
    else:
        click.echo(fitted("\n".join(map(str, found))) or "no bridge plugin is installed")
    sys.exit(0 if any(framework.is_reachable for framework in found) else BRIDGE)


def _framework(
    one: BridgeFindings,
    facts: Mapping[str, Mapping[str, str]],
    is_configured: bool,  # noqa: FBT001 - a fact like the others
    functions: tuple[str, ...],
) -> Framework:
    return Framework(
        one.bridge,
        one.plugin,
        is_configured,
        not one.cause,
        one.cause,
        facts.get(one.plugin, {}),
        tuple(component.name for component in one.components),
        sum(len(component.ports) for component in one.components),
        functions,
    )


def _broken(registry: Registry, facts: Mapping[str, Mapping[str, str]]) -> Iterator[Framework]:
    for problem in registry.problems:
        yield Framework("", problem.name, False, False, problem.cause, facts.get(problem.name, {}))
