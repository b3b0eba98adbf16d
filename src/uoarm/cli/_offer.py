"""`uoarm offer` puts functions into frameworks, for whoever there knows nothing of uoarm."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import click

from uoarm import RobotManager
from uoarm.cli._file import takes_configuration
from uoarm.cli._shared import (
    BRIDGE,
    CONFIGURATION,
    fail,
    json_option,
    open_robot,
)
from uoarm.model import OfferState, OfferStatus, StatusEvent, to_json, write_json

__all__ = ["offer"]

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
    with _without_record_of_offers(), open_robot(file) as robot:
        if not robot.config.offers:
            fail(f"{file} has no `offer:`", CONFIGURATION)
        statuses = robot.offer()
        try:
            for status in statuses:
                click.echo(write_json(to_json(status)) if as_json else _line(status))
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
    """Tell each change since these were told, until the sources of all have finished."""
    over = threading.Event()
    reports = {f"offer {status.name}": (status.state.value, status.cause) for status in statuses}

    def print_event(event: StatusEvent) -> None:
        # What was told may come as an event only now.
        if event.subject.startswith("offer ") and reports.pop(event.subject, None) != (
            event.change,
            event.cause,
        ):
            click.echo(write_json(to_json(event)) if as_json else event)
        if _is_over(robot.status().offers):
            over.set()

    robot.listen(print_event)
    if not _is_over(robot.status().offers):  # before anybody listened
        over.wait()


@contextmanager
def _without_record_of_offers() -> Iterator[None]:
    """Leave out of the log what is told on stdout: a terminal would show it twice."""

    def is_other(record: logging.LogRecord) -> bool:
        return not record.getMessage().startswith("offer ")

    log = logging.getLogger("uoarm")
    log.addFilter(is_other)
    try:
        yield
    finally:
        log.removeFilter(is_other)


def _line(status: OfferStatus) -> str:
    state = click.style(status.state.value, fg=_COLOURS.get(status.state))
    where = ", ".join(" ".join(endpoint) for endpoint in status.endpoints)
    return f"{status.name} {state} at {where}" + (f": {status.cause}" if status.cause else "")


def _is_over(statuses: tuple[OfferStatus, ...]) -> bool:
    return all(status.state is OfferState.FINISHED for status in statuses)
