"""The commands that run: `request` shows a flow live, `call` asks a service."""

from __future__ import annotations

import json
import sys
import time
from typing import TYPE_CHECKING, Any

import click

from uoarm import Connection, ConnectionClosedError, RobotManager, ValidationMode
from uoarm.cli._shared import BRIDGE, configuration_option, json_option, open_robot
from uoarm.model import ConnectionState, Message, RouteStatus, to_json
from uoarm.resolve import tell_plan

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["call", "request"]

_REFRESH_SECONDS = 0.25
_SHOWN = 100


@click.command()
@click.argument("name")
@configuration_option
@click.option("-n", "--count", type=click.IntRange(min=1), help="End after so many messages.")
@click.option("--duration", type=click.FloatRange(min=0), help="End after so many seconds.")
@click.option(
    "--validate",
    type=click.Choice([mode.value for mode in ValidationMode]),
    default=ValidationMode.SAMPLED.value,
    show_default=True,
    help="How many messages are checked against their structure.",
)
@json_option
def request(
    name: str,
    file: str,
    *,
    count: int | None,
    duration: float | None,
    validate: str,
    as_json: bool,
) -> None:
    """Open a function and show its messages until it ends or Ctrl-C.

    On a terminal a live table is shown; elsewhere, and with --json, one message a line. A function
    without an output has no messages to show and runs until the same end.
    """
    with open_robot(file) as robot, robot.request(name, validate=validate) as connection:
        if not connection.plan.provider.component.outputs:
            _stay(connection, duration)
            return
        live = sys.stdout.isatty() and not as_json
        show = _show_live if live else _show_lines
        show(robot, connection, count, duration)


@click.command()
@click.argument("name")
@click.argument("message", default="{}")
@configuration_option
@click.option("--timeout", type=click.FloatRange(min=0), default=10.0, show_default=True)
def call(name: str, message: str, file: str, *, timeout: float) -> None:
    """Call the service NAME with MESSAGE (JSON) and print its reply."""
    try:
        asked = json.loads(message)
    except ValueError as error:
        raise click.BadParameter(f"not JSON: {error}", param_hint="MESSAGE") from error
    with open_robot(file) as robot:
        click.echo(json.dumps(_plain(robot.call(name, asked, timeout=timeout))))


def _show_lines(
    robot: RobotManager, connection: Connection, count: int | None, duration: float | None
) -> None:
    del robot
    for message in _messages(connection, count, duration):
        click.echo(json.dumps(_plain(message)))


def _show_live(
    robot: RobotManager, connection: Connection, count: int | None, duration: float | None
) -> None:
    from rich.live import Live  # noqa: PLC0415 - slow import

    click.echo(tell_plan(connection.plan))
    shown = 0.0
    with Live(_table(robot, None), transient=False) as live:
        for message in _messages(connection, count, duration):
            now = time.monotonic()
            if now - shown >= _REFRESH_SECONDS:
                shown = now
                live.update(_table(robot, message))
        live.update(_table(robot, None))


def _messages(connection: Connection, count: int | None, duration: float | None) -> Any:
    """Yield messages until the count or the time is up or the connection ends."""
    deadline = None if duration is None else time.monotonic() + duration
    seen = 0
    while count is None or seen < count:
        left = 1.0 if deadline is None else deadline - time.monotonic()
        if left <= 0:
            return
        try:
            message = connection.get(min(left, 1.0))
        except TimeoutError:
            continue
        except ConnectionClosedError:
            _fail_if_it_failed(connection)
            return
        seen += 1
        yield message


def _stay(connection: Connection, duration: float | None) -> None:
    """Wait until the time is up or the connection ends."""
    click.echo(f"{connection.plan.function} runs, and has no output to show", err=True)
    deadline = None if duration is None else time.monotonic() + duration
    while not connection.ended and (deadline is None or time.monotonic() < deadline):
        time.sleep(_REFRESH_SECONDS)
    _fail_if_it_failed(connection)


def _fail_if_it_failed(connection: Connection) -> None:
    if connection.state is ConnectionState.FAILED:
        click.echo(f"{click.style('error:', fg='red')} {connection.cause}", err=True)
        sys.exit(BRIDGE)


def _table(robot: RobotManager, message: Message) -> Table:
    from rich.table import Table  # noqa: PLC0415 - slow import

    table = Table("from", "to", "received", "delivered", "rate", "dropped")
    for route in robot.status().routes:
        table.add_row(*_row(route))
    if message is not None:
        text = json.dumps(_plain(message))
        table.caption = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
    return table


def _row(route: RouteStatus) -> tuple[str, ...]:
    rate = "" if route.rate is None else f"{route.rate:.1f}/s"
    dropped = ", ".join(f"{reason} {count}" for reason, count in route.dropped)
    if route.native:
        rate = "native"
    return (
        route.producer, route.consumer, str(route.received), str(route.delivered), rate, dropped
    )  # fmt: skip


def _plain(message: Message) -> Any:
    """Return a message as JSON values: octets as a note of their number, buffers as lists."""
    if isinstance(message, bytes | bytearray | memoryview):
        return f"<{len(message)} octets>"
    if hasattr(message, "tolist"):
        return message.tolist()
    if isinstance(message, dict):
        return {key: _plain(value) for key, value in message.items()}
    if isinstance(message, list | tuple):
        return [_plain(value) for value in message]
    return to_json(message)
