"""`uoarm apply` and `history`: the configuration of a robot that runs behind `uoarm serve`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import click

from uoarm import errors
from uoarm.cli._file import takes_configuration
from uoarm.cli._remote import Remote, asked, remote_options
from uoarm.cli._shared import json_option, reporting
from uoarm.model import write_json

__all__ = ["apply", "history"]

_MOST_OCTETS = 1_000_000
_PLACE = re.compile(r"^.*?:(\d+:\d+: \$)", re.MULTILINE)


@click.command()
@takes_configuration()
@remote_options(always=True)
@click.option("--rollback", type=click.IntRange(0), help="In place of FILE, this revision again.")
@click.option("--dry-run", is_flag=True, help="Say only what would happen.")
@click.option("--force", is_flag=True, help="Connections that find no other plan may end for it.")
@click.option("--keep", is_flag=True, help="Write it to the robot's file, too.")
@click.option("--reload-code", is_flag=True, help="Read the code of Python components again.")
@click.option("--revision", type=click.IntRange(0), help="Refuse unless this one is in force.")
@json_option
def apply(
    file: str,
    *,
    server: Remote,
    rollback: int | None,
    reload_code: bool,
    as_json: bool,
    **how: Any,
) -> None:
    """Give a running robot another configuration.

    FILE is its configuration from now on. The token's role needs `configure: all`, and with
    --keep also `keep: all`; comments and order of the robot's own file stay. Exit codes: 0
    applied, 1 another revision is in force or somebody else has changed the robot's file, 3 the
    file has mistakes or connections would end, 4 the server cannot be reached or refused.
    """
    if reload_code and rollback is not None:
        raise click.UsageError("--rollback keeps the code as it is: leave --reload-code out")
    text = _text(file) if rollback is None else ""

    async def change_it(robot: Any) -> Mapping[str, Any]:
        try:
            change: Mapping[str, Any] = (
                await robot.configure(text, **how, reload_code=reload_code)
                if rollback is None
                else await robot.rollback(rollback, **how)
            )
        except errors.ConfigurationError as error:
            # The server took the text for that of its own file: the places in it are of this one.
            moved = _PLACE.sub(lambda item: f"{file}:{item[1]}", str(error))
            raise errors.ConfigurationError(moved) from error
        return change

    change = asked(server, change_it)
    click.echo(write_json(change, indent=2) if as_json else change["text"])


@click.command()
@remote_options(always=True)
@json_option
def history(*, server: Remote, as_json: bool) -> None:
    """Show the revisions of a running robot's configuration.

    The last hundred. The token's role needs `configure: all`. Exit code 4 when the server cannot
    be reached or refused.
    """

    async def ask(robot: Any) -> Any:
        return await robot.revisions()

    revisions = asked(server, ask)
    if as_json:
        click.echo(write_json(revisions, indent=2))
        return
    for revision in revisions:
        when = datetime.fromtimestamp(revision["time"], timezone.utc).isoformat(timespec="seconds")
        click.secho(f"revision {revision['revision']}  {when}", bold=True)
        for line in (*revision["differences"], *revision["connections"]):
            click.echo(f"  {line}")


def _text(file: str) -> str:
    with reporting():
        try:
            with Path(file).open("rb") as opened:
                data = opened.read(_MOST_OCTETS + 1)
            if len(data) > _MOST_OCTETS:
                raise errors.ConfigurationError(f"{file}: more than {_MOST_OCTETS:,} octets")
            return data.decode()
        except OSError as error:
            raise errors.ConfigurationError(f"{file}: {error.strerror or error}") from error
        except UnicodeDecodeError as error:
            raise errors.ConfigurationError(f"{file}: {error}") from error
