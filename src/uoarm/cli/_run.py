"""The commands that run: `request` and `call` of an application, `offer` of functions."""

from __future__ import annotations

import logging
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import click
from rich.console import Console
from rich.live import Live
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from uoarm import Connection, ConnectionClosedError, RobotManager, ValidationMode
from uoarm._interrupts import wait_for
from uoarm.cli._output import echo, leaving_out, output, saying_what_is_waited_for, styled
from uoarm.cli._remote import Remote, asked, remote_options
from uoarm.cli._shared import (
    BRIDGE,
    CONFIGURATION,
    Seconds,
    fail,
    fitted,
    function_argument,
    json_option,
    open_robot,
    plain,
    print_warning,
    reporting,
    takes_configuration,
)
from uoarm.errors import MessageError, UsageError
from uoarm.model import (
    ConnectionState,
    Health,
    Message,
    OfferState,
    OfferStatus,
    RouteStatus,
    StatusEvent,
    read_json,
    to_json,
    write_json,
)

_GLANCE_SECONDS = 0.25
_REQUEST_SECONDS = 60.0
# What the one connection does then says why, or its end does.
_DEATH = re.compile(r"component \S+ lost: |connection \S+ failed: ")
_OFFER = re.compile("offer ")
_FAILING = frozenset({"failed", "invalid", "unreadable"})


@click.command()
@function_argument(serves=False)
@takes_configuration("name")
@click.option("-n", "--count", type=click.IntRange(min=1), help="End after so many messages.")
@click.option("--duration", type=Seconds(min=0), help="End after so many seconds.")
@click.option(
    "--validate",
    type=click.Choice([mode.value for mode in ValidationMode]),
    default=ValidationMode.SAMPLED.value,
    show_default=True,
    help="How many messages are checked against their structure.",
)
@remote_options(always=False)
@json_option
def request(
    name: str,
    file: str,
    *,
    server: Remote | None,
    count: int | None,
    duration: float | None,
    validate: str,
    as_json: bool,
) -> None:
    """Open a function and show its messages.

    Until it ends or Ctrl-C, one message a line. On a terminal, a live table of the flows stands
    below them, lines are cut at its width, and of a fast flow forty messages a second are shown and
    the others counted; elsewhere, and with --json, every message is written in full. A function
    without an output has no messages to show and runs until the same end. While no message comes,
    components that raise are named on stderr; when the flow fails, or fewer messages came than
    asked for since others failed or did not match, the exit code is 4 and the last line says why.

    With --url the robot that runs there opens it, or shares what it has open; there is no table.
    """
    if server is not None:
        _request_there(server, name, count, duration, validate=validate, as_json=as_json)
        return
    with (
        leaving_out(_DEATH),  # until the manager is closed, which writes what is left
        open_robot(file) as robot,
        _requested(robot, name, validate) as connection,
    ):
        if connection.plan.provider.component.service is not None:
            raise UsageError(f"function {name!r} is a service: use call, not request")
        for warning in connection.plan.warnings:
            print_warning(warning)
        reading = _Reading(robot, connection, count, duration)
        if not connection.plan.provider.component.outputs:
            _stay(connection, duration)
        elif output().isatty() and not as_json:
            _show_live(robot, connection, reading)
        else:
            for message in reading:
                echo(_text_of(message))
        failure = reading.failure()
    if failure:
        fail(failure, BRIDGE, "UOA-805")


@click.command()
@function_argument(serves=True)
@click.argument("message", default="{}")
@takes_configuration("name", "message")
@click.option(
    "--timeout",
    type=Seconds(min=0),
    default=10.0,
    show_default=True,
    help="Seconds that the reply may take.",
)
@remote_options(always=False)
def call(name: str, message: str, file: str, *, server: Remote | None, timeout: float) -> None:
    """Call the service NAME and print its reply.

    MESSAGE is JSON, and so is what is printed. With --url, of the robot that runs there.
    """
    try:
        sent = read_json(message)
    except ValueError as error:
        raise click.BadParameter(f"not JSON: {error}", param_hint="MESSAGE") from error
    if server is not None:
        reply = asked(server, lambda robot: robot.call(name, sent, timeout=timeout))
        with reporting():
            echo(_text_of(reply))
        return
    with open_robot(file) as robot:
        echo(_text_of(robot.call(name, sent, timeout=timeout)))


def _requested(robot: RobotManager, name: str, validate: str) -> Connection:
    what = f"the components of {name!r} to start and open"
    with saying_what_is_waited_for(what, _REQUEST_SECONDS):
        return robot.request(name, validate=validate, timeout=_REQUEST_SECONDS)


def _request_there(
    server: Remote,
    name: str,
    count: int | None,
    duration: float | None,
    *,
    validate: str,
    as_json: bool,
) -> None:
    """Print messages of a function of a robot that is served; exits as `request` says."""
    is_live = output().isatty() and not as_json
    console, limit, said = Console(file=output(), highlight=False), _LineLimit(), set[str]()

    async def show(robot: Any) -> str:
        listed = {function["name"]: function for function in await robot.functions()}
        function = listed.get(name.partition(".")[0])
        if function is not None and function["service"]:
            raise UsageError(f"function {name!r} is a service: use call, not request")
        stream = await robot.request(name, validate=validate)
        for warning in stream.warnings:
            print_warning(warning)
        if function is not None and not function["outputs"]:
            echo(f"{name} runs, and has no output to show", err=True)
        deadline = None if duration is None else time.monotonic() + duration
        while count is None or limit.messages < count:
            left = 1.0 if deadline is None else min(1.0, deadline - time.monotonic())
            if left <= 0:
                break
            try:
                message = await stream.get(left)
            except TimeoutError:
                why = "; ".join(stream.trouble)
                if why and why not in said:
                    said.add(why)
                    print_warning(why)
                continue
            except ConnectionClosedError:
                break
            has_line = limit.has_line()
            if not is_live:
                echo(_text_of(message))
            elif has_line:
                _print_line(console, message)
        if stream.lost:
            print_warning(f"{stream.lost:,} messages were lost on the way here")
        return stream.cause if stream.state == "failed" else ""

    failure = asked(server, show)
    if is_live and limit.hidden:
        echo(str(limit), err=True)
    if failure:
        fail(failure, BRIDGE, "UOA-805")


def _text_of(message: Message, most: int | None = None) -> str:
    """Return a message as JSON, with buffers as `plain` has them.

    Raises:
        MessageError: it has no form there, as one that nothing checked may not.
    """
    try:
        return write_json(plain(message, most))
    except (TypeError, ValueError, RecursionError) as error:
        raise MessageError(f"a message cannot be written as JSON: {error}") from error


class _Reading:
    """The messages of a connection, until the count or the time is up or it ends.

    While none comes, what is wrong with its components is said on stderr, once each, unless a
    record of the log has said it.
    """

    def __init__(
        self,
        robot: RobotManager,
        connection: Connection,
        count: int | None,
        duration: float | None,
    ) -> None:
        self._robot = robot
        self._connection = connection
        self._count = count
        self._deadline = None if duration is None else time.monotonic() + duration
        self._seen = 0
        self._said: set[str] = set()

    def __iter__(self) -> Iterator[Message]:
        while self._count is None or self._seen < self._count:
            left = 1.0 if self._deadline is None else self._deadline - time.monotonic()
            if left <= 0:
                return
            try:
                message = self._connection.get(min(left, 1.0))
            except TimeoutError:
                self._say_what_is_wrong()
                continue
            except ConnectionClosedError:
                return
            self._seen += 1
            yield message

    def failure(self) -> str:
        """Return why it ended where that is a failure: empty, it is none.

        That is the end that its state says, and too few messages where some failed on their way:
        fewer than asked for, or where no number was asked for, none that got past who failed.
        """
        connection = self._connection
        if connection.state is ConnectionState.FAILED:
            return connection.cause
        if self._seen >= (self._count or 1):
            return ""
        wrong = [
            route
            for route in self._routes()
            if _FAILING & dict(route.dropped).keys() and (self._count or not route.delivered)
        ]
        if not wrong:
            return ""
        asked = f"{self._seen} of {self._count}" if self._count else str(self._seen)
        return f"it ended after {asked} messages: {'; '.join(map(_said_of, wrong))}"

    def _routes(self) -> Iterator[RouteStatus]:
        """Yield what its messages pass: its own routes, those that ended, those that it shares."""
        status = self._connection.status()
        yield from self._connection.routes()
        yield from status.ended
        for route in self._robot.status().routes:
            if route.consumer.rpartition(".")[0] in status.components:
                yield route

    def _say_what_is_wrong(self) -> None:
        status = self._connection.status()
        if status.state is ConnectionState.WAITING:
            self._say(f"it waits: {status.cause}")
        for component in self._robot.status().components:
            if component.name not in status.components or component.health is Health.OK:
                continue
            log = logging.getLogger(f"uoarm.component.{component.name}")
            if not (component.failed and log.isEnabledFor(logging.WARNING)):
                self._say(
                    f"component {component.name!r} is {component.health.value}: {component.cause}"
                )

    def _say(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            print_warning(text)


def _said_of(route: RouteStatus) -> str:
    if dict(route.dropped).get("failed"):
        return f"{route.consumer} raised {route.last_error}"
    wrong = "cannot be read" if "unreadable" in dict(route.dropped) else "do not match"
    return f"{route.producer} gave {route.invalid} that {wrong}: {route.last_error}"


def _stay(connection: Connection, duration: float | None) -> None:
    """Wait until the time is up or the connection ends."""
    echo(f"{connection.plan.function} runs, and has no output to show", err=True)
    deadline = None if duration is None else time.monotonic() + duration
    while not connection.ended and (deadline is None or time.monotonic() < deadline):
        time.sleep(_GLANCE_SECONDS)


_REFRESH_SECONDS = 0.25
_LINES = 10
_ITEMS = 100
_WHOLE = 10_000  # characters, of a table that nothing is cut from


class _LineLimit:
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


def _show_live(robot: RobotManager, connection: Connection, messages: Iterable[Message]) -> None:
    """Print the plan, then messages as they come above a table of flows, until they end."""
    console = Console(file=output(), highlight=False)
    console.print(str(connection.plan), markup=False, soft_wrap=True)
    shown = _LineLimit()

    def table() -> Table | Text:
        routes = _routes(robot, connection)
        table = _table(routes, str(shown))
        whole = Measurement.get(console, console.options.update(max_width=_WHOLE), table)
        return table if whole.maximum <= console.width else _lines(routes, str(shown))

    period = 1 / _REFRESH_SECONDS
    with Live(get_renderable=table, console=console, refresh_per_second=period):
        for message in messages:
            if shown.has_line():
                _print_line(console, message)


def _print_line(console: Console, message: Message) -> None:
    """Print what of a message one line of a terminal has room for."""
    line = _text_of(message, _ITEMS)[: console.width + 1]
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


_COLOURS = {OfferState.OPEN: "green", OfferState.FAILED: "red"}
_FINE = {OfferState.OPEN, OfferState.FINISHED}


@click.command()
@takes_configuration()
@json_option
@click.option("--once", is_flag=True, help="Try each offer once, close it again, and end.")
def offer(file: str, *, as_json: bool, once: bool) -> None:
    """Offer functions in frameworks, as `offer:` says.

    Until Ctrl-C or SIGTERM, or until the sources of all that is offered have finished.

    One line for each offer, and for each change after that. What cannot be opened is tried again.
    With --once the exit code is 4 where one could not be opened.
    """
    with leaving_out(_OFFER), open_robot(file) as robot:
        if not robot.config.offers:
            fail(f"{file} has no `offer:`", CONFIGURATION, "UOA-104")
        statuses = robot.offer()
        try:
            for status in statuses:
                echo(write_json(to_json(status)) if as_json else _line(status))
            if not once:
                _follow(robot, statuses, as_json=as_json)
                statuses = robot.status().offers
        except (KeyboardInterrupt, SystemExit):  # Ctrl-C and SIGTERM are how offering ends
            if once:
                raise
            sys.exit(0)
    if any(status.state not in _FINE for status in statuses):
        sys.exit(BRIDGE)


def _follow(robot: RobotManager, statuses: tuple[OfferStatus, ...], *, as_json: bool) -> None:
    """Print each change since these were printed, until the sources of all have finished."""
    over, unwritten = threading.Event(), list[OSError]()
    reports = {f"offer {status.name}": (status.state.value, status.cause) for status in statuses}

    def print_event(event: StatusEvent) -> None:
        is_over = True
        try:
            # What was printed may come as an event only now.
            if event.subject.startswith("offer ") and reports.pop(event.subject, None) != (
                event.change,
                event.cause,
            ):
                echo(write_json(to_json(event)) if as_json else event)
            is_over = _is_over(robot.status().offers)
        except OSError as error:  # what reads it has ended, or a disk is full
            unwritten.append(error)
        if is_over:
            over.set()

    robot.listen(print_event)
    if not _is_over(robot.status().offers):  # before the listener was there
        wait_for(over)
    if unwritten:
        raise unwritten[0]


def _line(status: OfferStatus) -> str:
    state = styled(status.state.value, fg=_COLOURS.get(status.state))
    where = ", ".join(map(" ".join, status.endpoints))
    return f"{status.name} {state} at {where}" + (f": {status.cause}" if status.cause else "")


def _is_over(statuses: tuple[OfferStatus, ...]) -> bool:
    return all(status.state is OfferState.FINISHED for status in statuses)
