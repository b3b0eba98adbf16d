"""What a person sees of a running connection: its messages, and below them its flows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from rich.console import Console
from rich.live import Live
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from uoarm import Connection, RobotManager
from uoarm.cli._shared import plain
from uoarm.cli._width import fitted
from uoarm.model import Message, RouteStatus, write_json

__all__ = ["show_live"]

_REFRESH_SECONDS = 0.25
_LINES = 10
_ITEMS = 100
_WHOLE = 10_000  # characters, of a table that nothing is cut from


class _Shown:
    """Which messages have a line of their own: so many in each period, and the others counted."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.messages = 0
        self.hidden = 0
        self._clock = clock
        self._begun = 0.0
        self._lines = 0

    def has_line(self) -> bool:
        """Count one message and say whether it is shown."""
        now = self._clock()
        if now - self._begun >= _REFRESH_SECONDS:
            self._begun, self._lines = now, 0
        self.messages += 1
        self._lines += 1
        if self._lines > _LINES:
            self.hidden += 1
        return self._lines <= _LINES

    def __str__(self) -> str:
        text = f"{self.messages:,} message{'s' if self.messages != 1 else ''}"
        if self.hidden:
            text += f", {self.hidden:,} of them not shown; --json writes all"
        return text


def show_live(robot: RobotManager, connection: Connection, messages: Iterable[Message]) -> None:
    """Print the plan, then messages as they come above a table of flows, until they end."""
    console = Console(highlight=False)
    console.print(str(connection.plan), markup=False, soft_wrap=True)
    shown = _Shown()

    def table() -> Table | Text:
        routes = _routes(robot, connection)
        table = _table(routes, str(shown))
        whole = Measurement.get(console, console.options.update(max_width=_WHOLE), table)
        return table if whole.maximum <= console.width else _lines(routes, str(shown))

    period = 1 / _REFRESH_SECONDS
    with Live(get_renderable=table, console=console, refresh_per_second=period):
        for message in messages:
            if shown.has_line():
                line = write_json(plain(message, _ITEMS))[: console.width + 1]
                console.print(Text(line), no_wrap=True, overflow="ellipsis")


def _routes(robot: RobotManager, connection: Connection) -> tuple[RouteStatus, ...]:
    """Return the flows of the robot, or, once the connection has ended, what its own counted."""
    routes = robot.status().routes
    if connection.ended:
        return (*connection.status().ended, *connection.routes())
    return routes


def _table(routes: Iterable[RouteStatus], caption: str) -> Table:
    table = Table("from", "to", "received", "delivered", "rate", "dropped", caption=caption)
    for route in routes:
        table.add_row(
            route.producer,
            route.consumer,
            str(route.received),
            str(route.delivered),
            _rate(route),
            _dropped(route),
        )
    return table


def _lines(routes: Iterable[RouteStatus], caption: str) -> Text:
    """Return what the table has for a terminal that is too narrow for it: lines for each flow."""
    lines: list[str] = []
    for route in routes:
        reports = [f"received {route.received}", f"delivered {route.delivered}"]
        reports += [rate] if (rate := _rate(route)) else []
        reports += [f"dropped {dropped}"] if (dropped := _dropped(route)) else []
        lines += [f"{route.producer} -> {route.consumer}", f"  {', '.join(reports)}"]
    return Text(fitted("\n".join([*lines, caption])))


def _rate(route: RouteStatus) -> str:
    if route.native:
        return "native"
    return "" if route.rate is None else f"{route.rate:.1f}/s"


def _dropped(route: RouteStatus) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in route.dropped)
