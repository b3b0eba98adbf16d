"""`uoarm discover` shows what bridges see; `uoarm suggest` writes the configuration for it."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from attrs import evolve

from uoarm import RobotManager
from uoarm._raised import reason_of
from uoarm._support.files import stamp_of, write_whole, written_beside
from uoarm.bridge import Registry
from uoarm.cli._output import echo, styled
from uoarm.cli._shared import (
    BRIDGE,
    REFUSED,
    STANDARD,
    DefaultConfiguration,
    Seconds,
    every_option,
    fail,
    fitted,
    hold_to,
    json_option,
    print_json,
    reporting,
    takes_configuration,
    text_of_file,
)
from uoarm.config import is_blank, load, merge
from uoarm.config import suggest as suggestion_for
from uoarm.errors import ConfigurationError, UsageError
from uoarm.model import BridgeFindings, BridgeSpec, Robot

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
