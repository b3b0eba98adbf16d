"""`uoarm status`: which functions can be had now, from which component, and why not the others."""

from __future__ import annotations

import sys
import time

import click

from uoarm import RobotManager
from uoarm.cli._file import takes_configuration
from uoarm.cli._frameworks import show_frameworks
from uoarm.cli._live_status import show_live_status
from uoarm.cli._remote import Remote, remote_options
from uoarm.cli._shared import REFUSED, json_option, open_robot, print_json
from uoarm.cli._width import fitted
from uoarm.model import FunctionStatus

__all__ = ["status"]


@click.command()
@takes_configuration()
@click.option("--watch", is_flag=True, help="Ask again until Ctrl-C.")
@click.option(
    "--every",
    type=click.FloatRange(min=0.1),
    default=2.0,
    show_default=True,
    help="Seconds between two looks of --watch.",
)
@remote_options(always=False)
@click.option("--bridges", is_flag=True, help="Show what is known of each framework.")
@json_option
def status(
    file: str,
    *,
    watch: bool,
    every: float,
    server: Remote | None,
    bridges: bool,
    as_json: bool,
) -> None:
    """Show what can be had now, and from which component.

    Every bridge is asked, and nothing is opened. Exit code 0 when every function can be had, 1
    otherwise. With --url, show the live status of a robot that `uoarm serve` runs; with --watch,
    its events too. With --bridges, show what is known of each framework, configured or only
    installed; exit code 4 when none is reachable.
    """
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
                if sys.stdout.isatty() and not as_json:
                    click.clear()
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
            click.echo(fitted(f"{bridge.name}  {option} {value}, chosen by uoarm"))
    for function in functions:
        head, _, candidates = str(function).partition("\n")
        click.secho(fitted(head), bold=True, fg="red" if function.provider is None else "green")
        if candidates:
            click.echo(fitted(candidates))
    for machine in robot.status().machines:
        click.echo(fitted(str(machine)))
    return functions
