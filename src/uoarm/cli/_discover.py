"""`uoarm discover` shows what bridges see, `uoarm status` which functions can be had now.

`uoarm suggest` writes the configuration for what is seen.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import click
from attrs import evolve, frozen

from uoarm import RobotManager
from uoarm._checks import plugin_facts
from uoarm._origin import install_command
from uoarm._raised import reason_of
from uoarm._support.files import stamp_of, write_whole, written_beside
from uoarm.bridge import Registry
from uoarm.cli._output import clear, echo, output, styled
from uoarm.cli._remote import Remote, asked, remote_options
from uoarm.cli._shared import (
    BRIDGE,
    NO_FUNCTIONS,
    REFUSED,
    STANDARD,
    DefaultConfiguration,
    Seconds,
    every_option,
    fail,
    fitted,
    hold_apart,
    hold_to,
    json_option,
    open_robot,
    print_json,
    reporting,
    takes_configuration,
    terminal_width,
    text_of_file,
)
from uoarm.config import is_blank, load, merge
from uoarm.config import suggest as suggestion_for
from uoarm.errors import ConfigurationError, PluginError, UsageError
from uoarm.model import BridgeFindings, BridgeSpec, FunctionStatus, Robot, format_status

_OWN_HEALTH = "status"  # a plugin whose component is the manager, not one of the robot

_timeout_option = click.option(
    "--timeout",
    type=Seconds(min=0.1, max=600),
    default=10.0,
    show_default=True,
    help="Seconds for each bridge, its start included.",
)


@click.command()
@takes_configuration(unnamed=DefaultConfiguration.IF_THERE)
@click.option("--watch", is_flag=True, help="Look again until Ctrl-C, and print what is different.")
@every_option
@_timeout_option
@json_option
def discover(file: str | None, *, watch: bool, every: float, timeout: float, as_json: bool) -> None:
    """Show every component and port that bridges see now.

    Beside each stands who in the configuration has it. Plugins that the file does not mention are
    asked too, with their default options. Exit code 4 when no bridge could answer.
    """
    hold_to("--watch", "--every")
    with looking(file) as (robot, _):
        findings = robot.discover(timeout=timeout)
        if as_json:
            print_json(findings, in_one_line=watch)
        else:
            echo(fitted("\n".join(map(str, findings))) or "no bridge plugin is installed")
        while watch:
            time.sleep(every)
            before, findings = findings, robot.discover(timeout=timeout)
            if findings == before:
                continue
            if as_json:
                print_json(findings, in_one_line=True)
            else:
                for mark, row in changed_rows(before, findings):
                    colour = "red" if mark == "-" else "green"
                    echo(styled(fitted(f"{mark} {row}"), fg=colour))
        sys.exit(0 if any(not found.cause for found in findings) else BRIDGE)


@click.command()
@takes_configuration(unnamed=DefaultConfiguration.NONE)
@_timeout_option
@click.option(
    "--merge",
    "into",
    type=click.Path(readable=False),
    help="Add the lines to this file, which stays as it is otherwise and is made where there is "
    "none; with no FILE it is read, too.",
)
def suggest(file: str | None, *, into: str | None, timeout: float) -> None:
    """Write the configuration of what bridges see.

    That is, of what FILE does not name yet: where none is named that of --merge, or robot.yaml, if
    it is there. It may be empty. Inputs are fed by what was proven to fit; where several would do,
    they are listed.
    """
    before = _text(into) if into is not None else ""
    if into is not None and file not in {None, into} and is_blank(before):
        raise click.UsageError(
            f"{into} has nothing yet, and would not have what is in {file}: leave {file} out, or "
            f"merge into {file}"
        )
    if into is not None:
        with _writing(into), written_beside(Path(into), b""):
            pass  # before the bridges look, which may take long
    named = file or into or STANDARD
    file = named if file is not None or Path(named).exists() else None
    registry = Registry()
    with looking(file, registry) as (robot, given):
        findings = robot.discover(timeout=timeout)
        for found in findings:
            if found.cause and found.bridge in given.bridges:
                echo(f"{found.bridge}: {found.cause}", err=True)
        if not given.bridges:
            _say_unasked(registry, named)
        lines = suggestion_for(given, findings, configured=given.bridges)
        if into is None:
            echo(lines, nl=False)
        else:
            _merge_into(Path(into), before, lines)
        sys.exit(0 if any(not found.cause for found in findings) else BRIDGE)


def _say_unasked(registry: Registry, file: str) -> None:
    """Say which plugins can look only once a file says where, and what to write there."""
    lines = [
        f"\n  {kind.line(name, lacking)}"
        for name, kind in registry.types.items()
        if (lacking := kind.lacking({}))
    ]
    if lines:
        text = f"to have more looked at, write under `bridges` of {file}, with your own values:"
        echo(f"{text}{''.join(lines)}", err=True)


def _text(path: str | Path) -> str:
    """Return what is in a file; nothing where there is none."""
    return text_of_file(path) if stamp_of(Path(path)) else ""


def _merge_into(path: Path, before: str, lines: str) -> None:
    """Add suggested lines to a file, unless it was changed meanwhile."""
    merged = merge(before, lines)
    if _text(path) != before:
        text = f"{path} was changed meanwhile: nothing was added"
        raise UsageError(text, error_code="UOA-003")
    if merged == before:
        echo(f"{path}: it has everything already")
        return
    with _writing(path):
        write_whole(path, merged.encode())
    echo(f"{path}: {len(merged.splitlines()) - len(before.splitlines())} lines added")


@contextmanager
def _writing(path: str | Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        fail(f"{path} cannot be written: {reason_of(error, path)}", REFUSED, "UOA-003")


@contextmanager
def looking(
    file: str | None, registry: Registry | None = None
) -> Iterator[tuple[RobotManager, Robot]]:
    """Give a manager with a bridge for each plugin, and the configuration as the file has it."""
    registry = registry or Registry()
    with reporting():
        given = Robot({}, {}) if file is None or _is_empty(file) else load(file, registry.types)
        with RobotManager(with_every_plugin(given, registry), registry=registry) as robot:
            yield robot, given


def _is_empty(file: str) -> bool:
    """Say whether a file has nothing yet, as one that a shell has just made for our output."""
    try:
        return is_blank(text_of_file(file))
    except ConfigurationError:  # what is wrong with it is said when it is read
        return False


def with_every_plugin(robot: Robot, registry: Registry) -> Robot:
    """Return the configuration, with a bridge for each plugin that it does not mention."""
    plugins = {bridge.plugin for bridge in robot.bridges.values()}
    more = {
        name: BridgeSpec(name, name)
        for name in registry.types
        if name not in plugins and name not in robot.bridges and name != _OWN_HEALTH
    }
    return evolve(robot, bridges={**robot.bridges, **more})


def changed_rows(
    before: Iterable[BridgeFindings], after: Iterable[BridgeFindings]
) -> Iterator[tuple[str, str]]:
    """Yield what is seen no more, each line with `-`, then what is new, with `+`."""
    old, new = dict.fromkeys(rows(before)), dict.fromkeys(rows(after))
    yield from (("-", row) for row in old if row not in new)
    yield from (("+", row) for row in new if row not in old)


def rows(findings: Iterable[BridgeFindings]) -> Iterator[str]:
    """Yield what is seen as lines of which each can be read alone."""
    for found in findings:
        if found.cause:
            yield f"{found.bridge}  {found.cause}"
        for component in found.components:
            yield f"{found.bridge}  {component.name}"
            for port in component.ports:
                yield f"{found.bridge}  {component.name}  {evolve(port, rate=None)}"


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
