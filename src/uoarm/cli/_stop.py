"""`uoarm stop`: the emergency stop of a robot that runs behind `uoarm serve`, and its release."""

from __future__ import annotations

import sys
from typing import Any

import click

from uoarm.cli._remote import Remote, asked, remote_options
from uoarm.cli._shared import json_option
from uoarm.model import write_json

__all__ = ["stop"]


@click.command()
@remote_options(always=True)
@click.option("--release", is_flag=True, help="Let commands through again.")
@json_option
def stop(*, server: Remote, release: bool, as_json: bool) -> None:
    """Stop everything that moves of a running robot.

    Commands are refused until --release. The token's role needs `stop: all`, and `release: all`
    for --release. Exit codes: 0 every open input that moves something has stopped, 1 some have not,
    which are named, or the stop would not outlast a restart, 4 the server cannot be reached or
    refused.
    """

    async def act(robot: Any) -> Any:
        return await (robot.release() if release else robot.stop_all())

    report = asked(server, act)
    if release:
        click.echo("{}" if as_json else "commands are let through again")
        return
    click.echo(write_json(report, indent=2) if as_json else report["text"])
    sys.exit(0 if report["stopped"] and not report.get("unkept") else 1)
