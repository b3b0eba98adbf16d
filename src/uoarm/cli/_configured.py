"""What the configured bridges of a file are given by uoarm, for commands that list plugins."""

from __future__ import annotations

from collections.abc import Iterator

import click

from uoarm.bridge import Registry
from uoarm.cli._shared import reporting
from uoarm.config import assign, load

__all__ = ["assigned_options", "optional_configuration"]

optional_configuration = click.option(
    "-f",
    "--file",
    "file",
    envvar="UOARM_CONFIG",
    type=click.Path(dir_okay=False),
    help="Configuration file whose bridges are shown, too; also UOARM_CONFIG.",
)


def assigned_options(file: str | None, registry: Registry) -> Iterator[tuple[str, str]]:
    """Yield every option that uoarm chose, as `bridge.option` and its value."""
    if file is None:
        return
    with reporting():
        robot = assign(load(file, registry.types), registry.types)
    for bridge in robot.bridges.values():
        for option, value in bridge.assigned.items():
            yield f"{bridge.name}.{option}", str(value)
