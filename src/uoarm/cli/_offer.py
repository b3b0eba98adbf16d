"""`uoarm offer` puts functions into frameworks, for whoever there knows nothing of uoarm."""

from __future__ import annotations

import json
import sys
import threading

import click

from uoarm.cli._shared import (
    BRIDGE,
    CONFIGURATION,
    configuration_option,
    fail,
    json_option,
    open_robot,
)
from uoarm.model import OfferState, OfferStatus, StatusEvent, to_json

__all__ = ["offer"]

_COLOURS = {OfferState.OPEN: "green", OfferState.FAILED: "red"}
_FINE = {OfferState.OPEN, OfferState.FINISHED}


@click.command()
@configuration_option
@json_option
@click.option("--once", is_flag=True, help="Try each offer once, close it again, and end.")
def offer(file: str, *, as_json: bool, once: bool) -> None:
    """Offer functions in frameworks, as `offer:` says.

    Until Ctrl-C or SIGTERM, or until the sources of all that is offered have finished.

    One line for each offer, and for each change after that. What cannot be opened is tried again.
    With --once the exit code is 4 where one could not be opened.
    """
    with open_robot(file) as robot:
        if not robot.config.offers:
            fail(f"{file} has no `offer:`", CONFIGURATION)
        statuses = robot.offer()
        for status in statuses:
            click.echo(json.dumps(to_json(status)) if as_json else _line(status))
        if not once:
            over = threading.Event()

            def heard(event: StatusEvent) -> None:
                _tell(event, as_json=as_json)
                if _is_over(robot.status().offers):
                    over.set()

            robot.listen(heard)
            if not _is_over(robot.status().offers):  # before anybody listened
                over.wait()
    if any(status.state not in _FINE for status in statuses):
        sys.exit(BRIDGE)


def _line(status: OfferStatus) -> str:
    state = click.style(status.state.value, fg=_COLOURS.get(status.state))
    where = ", ".join(" ".join(one) for one in status.endpoints)
    return f"{status.name} {state} at {where}" + (f": {status.cause}" if status.cause else "")


def _is_over(statuses: tuple[OfferStatus, ...]) -> bool:
    return all(status.state is OfferState.FINISHED for status in statuses)


def _tell(event: StatusEvent, *, as_json: bool) -> None:
    if event.subject.startswith("offer "):
        click.echo(json.dumps(to_json(event)) if as_json else event)
