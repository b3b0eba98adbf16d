"""The status of a robot that runs elsewhere, behind `uoarm serve`: once, or as it changes."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import click

from uoarm.cli._shared import BRIDGE, needing, reporting
from uoarm.model import to_json

__all__ = ["show_live_status"]

_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "machines": ("name", "present", "clock_offset", "clock_error", "cause"),
    "bridges": ("name", "plugin", "health", "assigned", "cause"),
    "components": ("name", "function", "health", "cause"),
    "connections": ("id", "function", "state", "lost", "cause"),
    "routes": ("producer", "consumer", "received", "delivered", "rate", "dropped"),
}


def show_live_status(
    url: str, token: str | None, *, watch: bool, every: float, as_json: bool
) -> None:
    """Print the status map of a server, again and again with each event where `watch` says so.

    Exits with 4 when the server cannot be reached, or goes away.
    """
    with reporting(), needing("server"):
        from uoarm.client import connect  # noqa: PLC0415 - needs an extra
    show = _print_json if as_json else _print_tables

    async def work() -> None:
        async with connect(url, token=token) as robot:
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

    try:
        asyncio.run(work())
    except KeyboardInterrupt:
        sys.exit(0 if watch else 130)
    except Exception as error:  # noqa: BLE001 - sockets, handshakes and the server say no in many ways
        click.echo(f"error: {url}: {type(error).__name__}: {error}", err=True)
        sys.exit(BRIDGE)


async def _follow_events(robot: Any, *, as_json: bool) -> None:
    async for event in robot.watch():
        if as_json:
            click.echo(json.dumps({"event": to_json(event)}))
        else:
            cause = f": {event.cause}" if event.cause else ""
            click.echo(f"#{event.number} {event.subject} {event.change}{cause}")


def _print_json(status: Mapping[str, Any]) -> None:
    click.echo(json.dumps(to_json(status)))


def _print_tables(status: Mapping[str, Any]) -> None:
    for name, columns in _COLUMNS.items():
        rows = [
            [_shown(one.get(column), column) for column in columns] for one in status.get(name, ())
        ]
        if name == "machines" and not rows:
            continue
        click.echo(click.style(f"{name}: {len(rows) or 'none'}", bold=True))
        if rows:
            _print_table(columns, rows)


def _print_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    widths = [max(map(len, column)) for column in zip(columns, *rows, strict=True)]
    for row in (columns, *rows):
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        click.echo(f"  {'  '.join(cells)}".rstrip())


def _shown(value: object, column: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{1000 * value:.3f} ms" if column.startswith("clock_") else f"{value:.1f}"
    if isinstance(value, list):
        return ", ".join(f"{reason} {count}" for reason, count in value)
    return "" if value is None else str(value)
