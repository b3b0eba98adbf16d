"""`uoarm apply` and `history`: the configuration of a robot that runs behind `uoarm serve`."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import click

from uoarm import errors
from uoarm.cli._shared import BRIDGE, json_option, needing, reporting

__all__ = ["apply", "asked", "history", "token_option", "url_option"]

_MOST_OCTETS = 1_000_000


url_option = click.option(
    "--url", required=True, help="Of a running `uoarm serve`, ws://127.0.0.1:9080/."
)
token_option = click.option(
    "--token", envvar="UOARM_TOKEN", help="Shown to the server; also UOARM_TOKEN."
)


@click.command()
@click.argument("file", default="robot.yaml", type=click.Path(dir_okay=False))
@url_option
@token_option
@click.option("--rollback", type=click.IntRange(0), help="In place of FILE, this revision again.")
@click.option("--dry-run", is_flag=True, help="Say only what would happen.")
@click.option("--force", is_flag=True, help="Connections that find no other plan may end for it.")
@click.option("--revision", type=click.IntRange(0), help="Refuse unless this one is in force.")
@json_option
def apply(
    file: str,
    *,
    url: str,
    token: str | None,
    rollback: int | None,
    dry_run: bool,
    force: bool,
    revision: int | None,
    as_json: bool,
) -> None:
    """Give FILE to a robot that runs, as its configuration from now on.

    The token's role needs `configure: ["*"]`. Exit codes: 0 applied, 1 another revision is in
    force, 3 the file has mistakes or connections would end, 4 the server cannot be reached or
    refused.
    """
    text = _text(file) if rollback is None else ""

    async def change_it(robot: Any) -> Mapping[str, Any]:
        how = {"dry_run": dry_run, "force": force, "revision": revision}
        change: Mapping[str, Any] = (
            await robot.configure(text, **how)
            if rollback is None
            else await robot.rollback(rollback, **how)
        )
        return change

    change = asked(url, token, change_it)
    click.echo(json.dumps(change, indent=2) if as_json else change["text"])


@click.command()
@url_option
@token_option
@json_option
def history(*, url: str, token: str | None, as_json: bool) -> None:
    """Show the last hundred revisions of the configuration of a robot that runs.

    The token's role needs `configure: ["*"]`. Exit code 4 when the server cannot be reached or
    refused.
    """

    async def ask(robot: Any) -> Any:
        return await robot.revisions()

    revisions = asked(url, token, ask)
    if as_json:
        click.echo(json.dumps(revisions, indent=2))
        return
    for one in revisions:
        when = datetime.fromtimestamp(one["time"], timezone.utc).isoformat(timespec="seconds")
        click.secho(f"revision {one['revision']}  {when}", bold=True)
        for line in (*one["differences"], *one["connections"]):
            click.echo(f"  {line}")


def asked(url: str, token: str | None, work: Callable[[Any], Awaitable[Any]]) -> Any:
    """Return what a server answers; exits with 4 where it cannot be reached or refuses."""
    with reporting(), needing("server"):
        from uoarm.client import connect  # noqa: PLC0415 - needs an extra

    async def ask() -> Any:
        async with connect(url, token=token) as robot:
            return await work(robot)

    with reporting():
        try:
            return asyncio.run(ask())
        except (errors.UoarmError, KeyboardInterrupt):
            raise
        except Exception as error:  # noqa: BLE001 - sockets and handshakes fail in many ways
            click.echo(f"error: {url}: {type(error).__name__}: {error}", err=True)
            sys.exit(BRIDGE)


def _text(file: str) -> str:
    with reporting():
        try:
            with Path(file).open("rb") as opened:
                data = opened.read(_MOST_OCTETS + 1)
            if len(data) > _MOST_OCTETS:
                raise errors.ConfigurationError(f"{file}: more than {_MOST_OCTETS:,} octets")
            return data.decode()
        except (OSError, UnicodeDecodeError) as error:
            raise errors.ConfigurationError(f"{file}: {error}") from error
