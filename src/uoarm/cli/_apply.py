"""`uoarm apply` changes the configuration of a robot that runs behind `uoarm serve`."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from uoarm import errors
from uoarm.cli._shared import BRIDGE, json_option, needing, reporting

__all__ = ["apply"]

_MOST_OCTETS = 1_000_000


@click.command()
@click.argument("file", default="robot.yaml", type=click.Path(dir_okay=False))
@click.option("--url", required=True, help="Of a running `uoarm serve`, ws://127.0.0.1:9080/.")
@click.option("--token", envvar="UOARM_TOKEN", help="Shown to the server; also UOARM_TOKEN.")
@click.option("--dry-run", is_flag=True, help="Say only what would happen.")
@click.option("--force", is_flag=True, help="Connections that find no other plan may end for it.")
@click.option("--revision", type=click.IntRange(0), help="Refuse unless this one is in force.")
@json_option
def apply(
    file: str,
    *,
    url: str,
    token: str | None,
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
    text = _text(file)
    with reporting(), needing("server"):
        from uoarm.client import connect  # noqa: PLC0415 - needs an extra

    async def work() -> Mapping[str, Any]:
        async with connect(url, token=token) as robot:
            return await robot.configure(text, dry_run=dry_run, force=force, revision=revision)

    with reporting():
        try:
            change = asyncio.run(work())
        except (errors.UoarmError, KeyboardInterrupt):
            raise
        except Exception as error:  # noqa: BLE001 - sockets and handshakes fail in many ways
            click.echo(f"error: {url}: {type(error).__name__}: {error}", err=True)
            sys.exit(BRIDGE)
    click.echo(json.dumps(change, indent=2) if as_json else change["text"])


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
