"""`uoarm types`: types for applications, from the lock or else from the configuration."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from uoarm._lock import Lock, LockError, read_lock
from uoarm._types import read_functions, write_document, write_python, write_typescript
from uoarm._whole_file import write_whole
from uoarm.cli._file import takes_configuration
from uoarm.cli._lock import lock_of, open_unlocked
from uoarm.cli._shared import REFUSED, print_warning, reporting

__all__ = ["types"]

_WRITERS = {
    "python": write_python, "typescript": write_typescript, "jsonschema": write_document,
}  # fmt: skip


@click.command()
@takes_configuration()
@click.option("--python", "form", flag_value="python", help="A module of TypedDicts.")
@click.option("--typescript", "form", flag_value="typescript", help="Declarations for uoarm.js.")
@click.option("--jsonschema", "form", flag_value="jsonschema", help="One schema with $defs.")
@click.option("--lock", "path", help="The lock's file, which must be there.  [robot.lock if any]")
@click.option("-o", "--output", type=click.Path(dir_okay=False), help="Write this file instead.")
def types(file: str, form: str | None, path: str | None, output: str | None) -> None:
    """Write the types of what functions give and take.

    They are those of the lock beside the configuration; where there is none, of the structures that
    bridges describe now. Standard error says which.

    Exit codes: 0 written; 1 written, but a function has no plan, and so no types; 3 a file cannot
    be read or written; 4 a bridge failed.
    """
    if form is None:
        raise click.UsageError("say which: --python, --typescript or --jsonschema")
    with reporting():
        lock = _source(file, path)
        robot = read_functions(lock)
        text = _WRITERS[form](robot)
        if output is None:
            click.echo(text, nl=False)
        else:
            _write(Path(output), text)
    refused = [name for name, function in robot.functions.items() if function.refused]
    for name in refused:
        print_warning(f"{name} has no plan: no types")
    sys.exit(REFUSED if refused else 0)


def _source(file: str, path: str | None) -> Lock:
    beside = Path(file).with_name("robot.lock")
    if path is not None or beside.exists():
        place = beside if path is None else Path(path)
        lock = read_lock(place)
        click.echo(f"types of {place}", err=True)
        return lock
    with open_unlocked(file) as robot:
        lock = lock_of(robot)
    click.echo(f"types of what the bridges of {file} describe now: no {beside}", err=True)
    return lock


def _write(path: Path, text: str) -> None:
    try:
        write_whole(path, text.encode())
    except OSError as error:
        raise LockError(f"{path}: cannot be written: {error}") from error
