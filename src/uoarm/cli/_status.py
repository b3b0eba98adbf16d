"""`uoarm status`: which functions can be had now, here or in a robot that runs elsewhere."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import click
from attrs import frozen

from uoarm import RobotManager
from uoarm._checks import plugin_facts
from uoarm._origin import install_command
from uoarm.cli._discover import looking
from uoarm.cli._output import clear, echo, output, styled
from uoarm.cli._remote import Remote, asked, remote_options
from uoarm.cli._shared import (
    BRIDGE,
    NO_FUNCTIONS,
    REFUSED,
    STANDARD,
    every_option,
    fitted,
    hold_apart,
    hold_to,
    json_option,
    open_robot,
    print_json,
    takes_configuration,
    terminal_width,
)
from uoarm.errors import PluginError
from uoarm.model import FunctionStatus, format_status


def show_live_status(server: Remote, *, watch: bool, every: float, as_json: bool) -> None:
    """Print the status map of a server, again and again with each event where `watch` says so.

    Exits with 4 when the server cannot be reached, or goes away.
    """
    show = partial(print_json, in_one_line=True) if as_json else _print_tables

    async def work(robot: Any) -> None:
        if not watch:
            show(await robot.status())
            return
        events = asyncio.ensure_future(_follow_events(robot, as_json=as_json))
        # It asks for events before the first status, so that none is missed.
        await asyncio.sleep(0)
        show(await robot.status())
        await asyncio.gather(events, _follow(robot, show))

    async def _follow(robot: Any, show: Callable[[Mapping[str, Any]], None]) -> None:
        while True:
            await asyncio.sleep(every)
            if not as_json:
                clear()
            show(await robot.status())

    asked(server, work, watches=watch)


async def _follow_events(robot: Any, *, as_json: bool) -> None:
    async for event in robot.watch():
        if as_json:
            print_json({"event": event}, in_one_line=True)
        else:
            echo(fitted(str(event)))


def _print_tables(status: Mapping[str, Any]) -> None:
    for line in format_status(status, terminal_width()).splitlines():
        echo(line if line.startswith(" ") else styled(line, bold=True))


_SECONDS = 10.0


@frozen
class Framework:
    """What is known of one framework.

    Attributes:
        bridge: that reaches it; empty where its plugin is broken.
        is_configured: whether the configuration has the bridge.
        is_reachable: whether the bridge answered.
        cause: why it did not.
        facts: what its plugin finds here, versions among it.
        components: that the bridge sees, by the framework's names.
        ports: how many these have.
        functions: that these provide, or may provide, in the configuration.
        error_code: of the cause.
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
    error_code: str = ""

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
            Framework(
                finding.bridge,
                finding.plugin,
                finding.bridge in given.bridges,
                not finding.cause,
                finding.cause,
                facts.get(finding.plugin, {}),
                tuple(component.name for component in finding.components),
                sum(len(component.ports) for component in finding.components),
                tuple(provided.get(finding.bridge, ())),
                finding.error_code,
            )
            for finding in findings
        ]
        found += [
            Framework(
                "",
                problem.name,
                False,
                False,
                problem.cause,
                facts.get(problem.name, {}),
                error_code=PluginError.error_code,
            )
            for problem in robot.registry.problems
        ]
    if as_json:
        print_json(found)
    else:
        echo(fitted("\n".join(map(str, found))) or "no bridge plugin is installed")
    sys.exit(0 if any(framework.is_reachable for framework in found) else BRIDGE)


@click.command()
@takes_configuration()
@click.option("--watch", is_flag=True, help="Ask again until Ctrl-C.")
@every_option
@remote_options(always=False)
@click.option("--bridges", is_flag=True, help="Show what is known of each framework.")
@click.option("--all", "managers", is_flag=True, help="Show each manager that the file imports.")
@json_option
@click.pass_context
def status(
    context: click.Context,
    file: str,
    *,
    watch: bool,
    every: float,
    server: Remote | None,
    bridges: bool,
    managers: bool,
    as_json: bool,
) -> None:
    """Show what can be had now, and from which component.

    Every bridge is asked, and nothing is opened. Exit code 0 when every function can be had, 1
    otherwise. With --url, show the live status of a robot that `uoarm serve` runs; with --watch,
    its events too. With --bridges, show what is known of each framework, configured or only
    installed; exit code 4 when none is reachable. With --all, show the live status of each other
    manager that the file imports from, as `uoarm fleet` does.
    """
    hold_apart("--all", "--bridges", "--watch")
    hold_apart("--all", "--bridges", "--url")
    hold_to("--watch", "--every")
    if managers:
        group = context.find_root().command
        assert isinstance(group, click.Group), "it is `uoarm`"
        fleet = group.get_command(context, "fleet")
        if fleet is None:
            command = install_command("uoarm-remote")
            raise PluginError(f"other managers need the plugin uoarm-remote: {command}")
        with redirect_stdout(output()):  # it is a plugin's, and writes where Python does
            context.invoke(fleet, arguments=(file, "--json") if as_json else (file,))
        return
    if bridges:
        show_frameworks(file, as_json=as_json)
        return
    if server is not None:
        show_live_status(server, watch=watch, every=every, as_json=as_json)
        return
    with open_robot(file) as robot:
        functions = _show(robot, as_json=as_json)
        try:
            while watch:
                time.sleep(every)
                if not as_json:
                    clear()
                functions = _show(robot, as_json=as_json)
        except KeyboardInterrupt:
            sys.exit(0)  # it is how watching ends
    sys.exit(REFUSED if any(function.provider is None for function in functions) else 0)


def _show(robot: RobotManager, *, as_json: bool) -> tuple[FunctionStatus, ...]:
    functions = robot.check_availability()
    if as_json:
        print_json(functions)
        return functions
    for bridge in robot.config.bridges.values():
        for option, value in bridge.assigned.items():
            echo(fitted(f"{bridge.name}  {option} {value}, chosen by uoarm"))
    for function in functions:
        head, _, candidates = str(function).partition("\n")
        colour = "red" if function.provider is None else "green"
        echo(styled(fitted(head), bold=True, fg=colour))
        if candidates:
            echo(fitted(candidates))
    if not functions:
        echo(NO_FUNCTIONS, err=True)
    for machine in robot.status().machines:
        echo(fitted(str(machine)))
    return functions
