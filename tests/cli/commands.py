"""The commands in a group, those of `uoarm` imported."""

from __future__ import annotations

import click

from uoarm.cli import main
from uoarm.cli._main import COMMANDS


def members(group: click.Group) -> dict[str, click.Command]:
    """Return the commands in a group by name, without those that plugins bring."""
    names = COMMANDS if group is main else group.commands
    found = {name: group.get_command(click.Context(group), name) for name in sorted(names)}
    return {name: command for name, command in found.items() if command is not None}
