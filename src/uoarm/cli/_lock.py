"""`uoarm lock`: what plans rest on, as a file, and what a difference of it breaks."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import click
from attrs import evolve

from uoarm import RobotManager, environments
from uoarm._lock import (
    Lock,
    LockFinding,
    LockOutcome,
    compare,
    differing_packages,
    read_lock,
    read_schemas,
    record,
    uncompared_types,
    write_lock,
)
from uoarm._whole_file import write_whole
from uoarm.bridge import Registry
from uoarm.cli._file import takes_configuration
from uoarm.cli._findings import FORMS
from uoarm.cli._shared import REFUSED, print_warning, reporting
from uoarm.config import load
from uoarm.errors import ResolutionError
from uoarm.model import Plan

__all__ = ["lock", "lock_of", "open_unlocked"]


@click.command()
@takes_configuration()
@click.option("--lock", "path", help="The lock's file.  [robot.lock beside the configuration]")
@click.option("--check", is_flag=True, help="Write nothing; say what is different and breaks.")
@click.option(
    "--against",
    type=click.Path(exists=True),
    help="Compare with this lock, or with the definitions of this folder: JSON Schemas, and what "
    "plugins read; no bridge is asked.",
)
@click.option(
    "--environment", metavar="NAME",
    help="Compare with the definitions that this environment has installed; no bridge is asked.",
)  # fmt: skip
@click.option(
    "--format", "form", type=click.Choice(list(FORMS)), default="text",
    show_default=True, help="Of what --check says.",
)  # fmt: skip
def lock(
    file: str,
    path: str | None,
    form: str,
    *,
    check: bool,
    against: str | None,
    environment: str | None,
) -> None:
    """Write down what all plans rest on, or check it.

    Exit codes: 0 written, or everything still fits; 1 a function has no plan, or something does not
    fit as it is; 3 a file cannot be read; 4 a bridge failed, or there is no such environment.
    """
    if not check and (against is not None or environment is not None):
        raise click.UsageError("--against and --environment belong to --check")
    if against is not None and environment is not None:
        raise click.UsageError("say --against or --environment, one of them")
    place = Path(file).with_name("robot.lock") if path is None else Path(path)
    with reporting():
        if not check:
            sys.exit(_write(file, place))
        before = read_lock(place)
        if environment is not None:
            findings = _against(before, environments.installed(environment), is_installed=True)
        elif against is not None:
            findings = _against(before, Path(against))
        else:
            with open_unlocked(file) as robot:
                findings = _compared(before, lock_of(robot))
    text = FORMS[form](findings, place)
    if text:
        click.echo(text)
    sys.exit(0 if all(finding.outcome is LockOutcome.FITS for finding in findings) else REFUSED)


def _against(before: Lock, other: Path, *, is_installed: bool = False) -> list[LockFinding]:
    """Compare with what stands in files; standard error says which types do not."""
    if not other.is_dir():
        return _compared(before, read_lock(other))
    schemas = read_schemas(other, before, is_installed=is_installed)
    missing = uncompared_types(before, schemas)
    if missing:
        click.echo(f"not in {other}, and taken to be as they were: {', '.join(missing)}", err=True)
    return list(compare(before, schemas))


def _compared(before: Lock, after: Lock) -> list[LockFinding]:
    """Compare two locks; standard error says which packages are others, which breaks nothing."""
    for line in differing_packages(before.bridges, after.bridges):
        click.echo(line, err=True)
    return list(compare(before, after))


@contextmanager
def open_unlocked(file: str) -> Iterator[RobotManager]:
    """Make a manager that is not held to the lock which its configuration may ask for."""
    registry = Registry()
    robot = evolve(load(file, registry.types), lock=None)
    with RobotManager(robot, registry=registry) as manager:
        yield manager


def _write(file: str, path: Path) -> int:
    with open_unlocked(file) as robot:
        made = lock_of(robot)
    write_whole(path, write_lock(made).encode())
    refused = {
        name: function.refused for name, function in made.functions.items() if function.refused
    }
    for name, why in refused.items():
        print_warning(f"{name} has no plan: {why}")
    functions, structures = len(made.functions), len(made.structures)
    click.echo(f"{path}: functions: {functions}, structures: {structures}")
    return REFUSED if refused else 0


def lock_of(robot: RobotManager) -> Lock:
    """Return the lock of a robot, as its bridges describe themselves now."""
    plans: dict[str, Plan | str] = {}
    for name in robot.config.functions:
        try:
            plans[name] = robot.resolve(name)
        except ResolutionError as error:
            plans[name] = str(error)
    described = {}
    names = [component.name for component in robot.config.components()]
    names += [offer.name for offer in robot.config.offers]
    for name in names:
        with suppress(ResolutionError):  # what is not there is no candidate now
            described[name] = robot.structures(name)
    return record(robot.config, plans, described)
