"""The status of a robot that runs elsewhere, behind `uoarm serve`: once, or as it changes."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Mapping
from typing import Any

import click

from uoarm.cli._remote import Remote, asked
from uoarm.cli._width import fitted, terminal_width
from uoarm.model import format_status, to_json, write_json

__all__ = ["show_live_status"]


def show_live_status(server: Remote, *, watch: bool, every: float, as_json: bool) -> None:
    """Print the status map of a server, again and again with each event where `watch` says so.

    Exits with 4 when the server cannot be reached, or goes away.
    """
    show = _print_json if as_json else _print_tables

    async def work(robot: Any) -> None:
        if not watch:
            show(await robot.status())
            return
        events = asyncio.ensure_future(_follow_events(robot, as_json=as_json))
        # It asks for events before the first status, so that none is missed.
        await asyncio.sleep(0)
        show(await robot.status())
        await asyncio.gather(events, _follow(robot, show))

    async def _follow(robot: Any, show: Callable[[Mapping[str, Any]], None]) -> None:
        while True:
            await asyncio.sleep(every)
            if sys.stdout.isatty() and not as_json:
                click.clear()
            show(await robot.status())

    asked(server, work, watches=watch)


async def _follow_events(robot: Any, *, as_json: bool) -> None:
    async for event in robot.watch():
        if as_json:
            click.echo(write_json({"event": to_json(event)}))
        else:
            click.echo(fitted(str(event)))


def _print_json(status: Mapping[str, Any]) -> None:
    click.echo(write_json(to_json(status)))


def _print_tables(status: Mapping[str, Any]) -> None:
    for line in format_status(status, terminal_width()).splitlines():
        click.echo(line if line.startswith(" ") else click.style(line, bold=True))
