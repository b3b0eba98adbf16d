"""The commands that run: `request` shows a flow live, `call` asks a service."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator

import click

from uoarm import Connection, ConnectionClosedError, ValidationMode
from uoarm.cli._shared import BRIDGE, configuration_option, json_option, open_robot, plain
from uoarm.model import ConnectionState, Message

__all__ = ["call", "request"]

_GLANCE_SECONDS = 0.25


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

    One message a line. On a terminal, a live table of the flows stands below them, lines are cut
    at its width, and of a fast flow forty messages a second are shown and the others counted;
    elsewhere, and with --json, every message is written in full. A function without an output has
    no messages to show and runs until the same end.
    """
    with open_robot(file) as robot, robot.request(name, validate=validate) as connection:
        if not connection.plan.provider.component.outputs:
            _stay(connection, duration)
        elif sys.stdout.isatty() and not as_json:
            from uoarm.cli._live_messages import show_live  # noqa: PLC0415 - slow import

            show_live(robot, connection, _messages(connection, count, duration))
        else:
            for message in _messages(connection, count, duration):
                click.echo(json.dumps(plain(message)))
        _fail_if_it_failed(connection)


@click.command()
@click.argument("name")
@click.argument("message", default="{}")
@configuration_option
@click.option("--timeout", type=click.FloatRange(min=0), default=10.0, show_default=True)
def call(name: str, message: str, file: str, *, timeout: float) -> None:
    """Call the service NAME with MESSAGE (JSON) and print its reply."""
    try:
        asked = json.loads(message)
    except (ValueError, RecursionError) as error:
        raise click.BadParameter(f"not JSON: {error}", param_hint="MESSAGE") from error
    with open_robot(file) as robot:
        click.echo(json.dumps(plain(robot.call(name, asked, timeout=timeout))))


def _messages(
    connection: Connection, count: int | None, duration: float | None
) -> Iterator[Message]:
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
            return
        seen += 1
        yield message


def _stay(connection: Connection, duration: float | None) -> None:
    """Wait until the time is up or the connection ends."""
    click.echo(f"{connection.plan.function} runs, and has no output to show", err=True)
    deadline = None if duration is None else time.monotonic() + duration
    while not connection.ended and (deadline is None or time.monotonic() < deadline):
        time.sleep(_GLANCE_SECONDS)


def _fail_if_it_failed(connection: Connection) -> None:
    if connection.state is ConnectionState.FAILED:
        click.echo(f"{click.style('error:', fg='red')} {connection.cause}", err=True)
        sys.exit(BRIDGE)
