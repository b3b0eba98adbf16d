"""`uoarm new-bridge`: a plugin project that passes the conformance kit as generated."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from importlib.abc import Traversable

__all__ = ["new_bridge"]

_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")
_SKIPPED = {"__pycache__"}


@click.command("new-bridge")
@click.argument("name")
@click.option(
    "--into",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path(),
    help="Folder in which uoarm-NAME is made; the current one unless given.",
)
def new_bridge(name: str, into: Path) -> None:
    """Make a bridge plugin to start from, with its tests.

    The project is called uoarm-NAME.
    """
    if not _NAME.fullmatch(name):
        raise click.BadParameter(
            f"{name!r}: use small letters, digits and _, a letter first, 40 at most",
            param_hint="NAME",
        )
    project = into / f"uoarm-{name.replace('_', '-')}"
    if project.exists():
        raise click.ClickException(f"{project} is there already; nothing was changed")
    try:
        for place, text in _files(files("uoarm.cli").joinpath("template"), ""):
            target = project / _named(place, name)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(_named(text, name), encoding="utf-8")
    except OSError as error:
        shutil.rmtree(project, ignore_errors=True)
        raise click.ClickException(f"{project} cannot be made: {error}") from error
    click.echo(f"made {project}; next:\n")
    click.echo(f"  cd {project}\n  pip install -e '.[dev]'\n  pytest")


def _files(folder: Traversable, prefix: str) -> Iterator[tuple[str, str]]:
    for entry in sorted(folder.iterdir(), key=lambda path: path.name):
        if entry.name in _SKIPPED:
            continue
        if entry.is_dir():
            yield from _files(entry, f"{prefix}{entry.name}/")
        else:
            yield f"{prefix}{entry.name}", entry.read_text(encoding="utf-8")


def _named(text: str, name: str) -> str:
    """Put a name where the template says example; distributions are written with hyphens."""
    camel = "".join(part.title() for part in name.split("_"))
    text = text.replace("uoarm-example", f"uoarm-{name.replace('_', '-')}")
    return text.replace("Example", camel).replace("example", name)
