"""`uoarm discover` shows what bridges see; `uoarm suggest` writes the configuration for it."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from attrs import evolve

from uoarm import RobotManager
from uoarm._whole_file import write_whole
from uoarm.bridge import Registry
from uoarm.cli._shared import BRIDGE, json_option, print_json, reporting
from uoarm.cli._width import fitted
from uoarm.config import load, merge
from uoarm.config import suggest as suggestion_for
from uoarm.errors import UsageError
from uoarm.model import BridgeFindings, BridgeSpec, Robot, to_json

__all__ = [
    "STANDARD",
    "discover",
    "looking",
    "rows",
    "standard_file",
    "suggest",
    "with_every_plugin",
]

STANDARD = "robot.yaml"

_file_option = click.option(
    "-f",
    "--file",
    "file",
    envvar="UOARM_CONFIG",
    type=click.Path(dir_okay=False),
    help="Configuration file; also UOARM_CONFIG. Without one robot.yaml, if it is there.",
)
_timeout_option = click.option(
    "--timeout",
    type=click.FloatRange(min=0.1, max=600),
    default=10.0,
    show_default=True,
    help="Seconds for each bridge, its start included.",
)


@click.command()
@_file_option
@click.option("--watch", is_flag=True, help="Look again until Ctrl-C, and tell what is different.")
@click.option(
    "--every",
    type=click.FloatRange(min=0.1),
    default=2.0,
    show_default=True,
    help="Seconds between two looks of --watch.",
)
@_timeout_option
@json_option
def discover(file: str | None, *, watch: bool, every: float, timeout: float, as_json: bool) -> None:
    """Show every component and port that bridges see now.

    Beside each stands who in the configuration has it. Plugins that the file does not mention are
    asked too, with their default options. Exit code 4 when no bridge could answer.
    """
    with looking(file or standard_file()) as (robot, _):
        findings = robot.discover(timeout=timeout)
        if as_json:
            _print_json(findings, in_one_line=watch)
        else:
            click.echo(fitted("\n".join(map(str, findings))) or "no bridge plugin is installed")
        while watch:
            time.sleep(every)
            before, findings = findings, robot.discover(timeout=timeout)
            if findings == before:
                continue
            if as_json:
                _print_json(findings, in_one_line=True)
            else:
                _print_differences(before, findings)
        sys.exit(0 if any(not one.cause for one in findings) else BRIDGE)


@click.command()
@_file_option
@_timeout_option
@click.option(
    "--merge",
    "into",
    type=click.Path(dir_okay=False, exists=True),
    help="Add the lines to this file, which stays as it is otherwise; with no -f it is read, too.",
)
def suggest(file: str | None, *, into: str | None, timeout: float) -> None:
    """Write the configuration of what bridges see.

    That is, of what FILE does not name yet. Inputs are fed by what was proven to fit; where several
    would do, they are listed.
    """
    file = file or into or standard_file()
    before = Path(into).read_bytes() if into is not None else b""
    with looking(file) as (robot, given):
        findings = robot.discover(timeout=timeout)
        for one in findings:
            if one.cause:
                click.echo(f"{one.bridge}: {one.cause}", err=True)
        lines = suggestion_for(given, findings, configured=given.bridges)
        if into is None:
            click.echo(lines, nl=False)
        else:
            _merge_into(Path(into), before, lines)
        sys.exit(0 if any(not one.cause for one in findings) else BRIDGE)


def standard_file() -> str | None:
    """Return the configuration that is meant where none is named, if it is there."""
    return STANDARD if Path(STANDARD).exists() else None


def _merge_into(path: Path, before: bytes, lines: str) -> None:
    """Add suggested lines to a file, unless somebody else changed it meanwhile."""
    merged = merge(before.decode(), lines).encode()
    if path.read_bytes() != before:
        raise UsageError(f"{path} was changed meanwhile: nothing was added")
    if merged == before:
        click.echo(f"{path}: it has everything already")
        return
    write_whole(path, merged)
    click.echo(f"{path}: {len(merged.splitlines()) - len(before.splitlines())} lines added")


@contextmanager
def looking(file: str | None) -> Iterator[tuple[RobotManager, Robot]]:
    """Give a manager with a bridge for each plugin, and the configuration as the file has it."""
    registry = Registry()
    with reporting():
        given = Robot({}, {}) if file is None else load(file, registry.types)
        with RobotManager(with_every_plugin(given, registry), registry=registry) as robot:
            yield robot, given


def with_every_plugin(robot: Robot, registry: Registry) -> Robot:
    """Return the configuration, with a bridge for each plugin that it does not mention."""
    plugins = {one.plugin for one in robot.bridges.values()}
    more = {
        name: BridgeSpec(name, name)
        for name in registry.types
        if name not in plugins and name not in robot.bridges
    }
    return evolve(robot, bridges={**robot.bridges, **more})


def _print_json(findings: tuple[BridgeFindings, ...], *, in_one_line: bool) -> None:
    if in_one_line:
        click.echo(json.dumps(to_json(findings)))
    else:
        print_json(findings)


def _print_differences(
    before: tuple[BridgeFindings, ...], after: tuple[BridgeFindings, ...]
) -> None:
    old, new = dict.fromkeys(rows(before)), dict.fromkeys(rows(after))
    for row in old:
        if row not in new:
            click.secho(fitted(f"- {row}"), fg="red")
    for row in new:
        if row not in old:
            click.secho(fitted(f"+ {row}"), fg="green")


def rows(findings: Iterable[BridgeFindings]) -> Iterable[str]:
    """Yield what is seen as lines of which each can be read alone."""
    for each in findings:
        if each.cause:
            yield f"{each.bridge}  {each.cause}"
        for one in each.components:
            yield f"{each.bridge}  {one.name}"
            for port in one.ports:
                yield f"{each.bridge}  {one.name}  {evolve(port, rate=None)}"
