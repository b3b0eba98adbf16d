"""The command `uoarm-rocos`: simulated devices on a real line."""

from __future__ import annotations

import math
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import click

from uoarm.bridge import reason_of
from uoarm.cli import main as run_command
from uoarm.errors import BridgeError, FailureReason
from uoarm.plugins import Command, hookimpl
from uoarm_rocos._catalogue_xml import load_catalogue
from uoarm_rocos._framing import LengthFramer, StuffedFramer
from uoarm_rocos.simulate import (
    FORMATS,
    BloodPressureMonitor,
    LineEnd,
    LineFaults,
    Oximeter,
    Person,
    ProfileServer,
    PtyEnd,
    Scenario,
    Simulated,
    SimulatedRobot,
    TcpEnd,
    run,
)

F = TypeVar("F", bound=Callable[..., Any])


class BoundedNumber(click.FloatRange):
    """A number from a least to a greatest one, which NaN is not."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number.

        Raises:
            click.BadParameter: it is none, or out of range.
        """
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{value} is not in the range {self._describe_range()}.", param, ctx)
        return number


_CHANCE = BoundedNumber(0, 1)
_SECONDS = BoundedNumber(0, 86_400)


@click.group()
@click.version_option(package_name="uoarm-rocos", prog_name="uoarm-rocos")
def rocos() -> None:
    """Devices with an XML catalogue, for uoarm."""


def main() -> None:
    """Run the command `uoarm-rocos`, which is `uoarm rocos`."""
    run_command(["rocos", *sys.argv[1:]])


@rocos.group()
def simulate() -> None:
    """Be a device on a line of this machine, until Ctrl-C.

    The line is a pseudo-terminal or a TCP port.
    """


def _line_options(command: F) -> F:
    options = (
        click.option("--pty", is_flag=True, help="On a new pseudo-terminal; its path is printed."),
        click.option("--link", default="", help="With --pty: a path that always points to it."),
        click.option("--tcp", type=click.IntRange(0, 65_535), help="On this port; 0: a free one."),
        click.option("--drop", type=_CHANCE, default=0.0, help="Chance to lose a frame."),
        click.option("--garble", type=_CHANCE, default=0.0, help="Chance to damage a frame."),
        click.option("--delay", type=_SECONDS, default=0.0, help="Seconds that frames are late."),
        click.option("--disconnect", type=_SECONDS, help="Pull the cable after so many seconds."),
        click.option("--seed", type=int, default=0, help="Of the faults; the same ones again."),
    )
    for option in reversed(options):
        command = option(command)
    return command


def _number(flag: str, least: float, most: float, default: float, text: str) -> Callable[[F], F]:
    kind = BoundedNumber(least, most)
    return click.option(flag, type=kind, default=default, show_default=True, help=text)


@simulate.command()
@_line_options
@click.option("--catalogue", default="", help="A catalogue file instead of the robot's own.")
def robot(catalogue: str, **line: Any) -> None:
    """A robot on two wheels that speaks the plain-XML profile."""
    model = SimulatedRobot(load_catalogue(catalogue) if catalogue else None)
    end = _end(line)
    framer = LengthFramer if end.framed else StuffedFramer
    _serve(ProfileServer(model, framer), end, end.where, line)


@simulate.command()
@_line_options
@click.option(
    "--format",
    "kind",
    type=click.Choice(FORMATS),
    default="contec",
    show_default=True,
    help="Of which maker its frames are.",
)
@_number("--pulse", 30, 220, 72.0, "Beats a minute.")
@_number("--spo2", 50, 100, 97.0, "Oxygen saturation, percent.")
@click.option("--apnoea", type=_SECONDS, default=0.0, help="Seconds from one apnoea to the next.")
@click.option("--finger-in", type=_SECONDS, default=0.0, help="When the finger is put in.")
@click.option("--finger-out", type=_SECONDS, help="When the finger is taken out.")
def oximeter(
    *,
    kind: str,
    pulse: float,
    spo2: float,
    apnoea: float,
    finger_in: float,
    finger_out: float | None,
    **line: Any,
) -> None:
    """A pulse oximeter that sends its maker's frames."""
    person = Person(pulse=pulse, spo2=spo2, apnoea=apnoea)
    scenario = Scenario(finger_in=finger_in, finger_out=finger_out)
    end = _end(line)
    _serve(Oximeter(kind, person, scenario), end, _raw(end), line)


@simulate.command("blood-pressure")
@_line_options
@_number("--interval", 0.1, 86_400, 10.0, "Seconds from one measurement to the next.")
@_number("--systolic", 60, 230, 118.0, "Upper pressure, mmHg.")
@_number("--diastolic", 30, 150, 76.0, "Lower pressure, mmHg.")
def blood_pressure(*, interval: float, systolic: float, diastolic: float, **line: Any) -> None:
    """A blood-pressure monitor that measures now and then.

    It keeps what no host has acknowledged.
    """
    if systolic <= diastolic:
        raise click.UsageError("--systolic must be above --diastolic")
    person = Person(systolic=systolic, diastolic=diastolic)
    end = _end(line)
    _serve(BloodPressureMonitor(person, interval), end, _raw(end), line)


def _end(line: dict[str, Any]) -> LineEnd:
    if line["pty"] == (line["tcp"] is not None):
        raise click.UsageError("say where: --pty, or --tcp PORT")
    if line["link"] and not line["pty"]:
        raise click.UsageError("--link goes with --pty")
    if line["tcp"] is not None:
        return TcpEnd(line["tcp"])
    try:
        return PtyEnd(line["link"])
    except OSError as error:
        # A link is made beside its place, under another name.
        reason = reason_of(error, error.filename2 or error.filename)
        text = f"{line['link'] or 'a tty'} cannot be opened: {reason}"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error


def _raw(end: LineEnd) -> str:
    """Return the URL for octets without the profile's frames."""
    return end.where.replace("tcp://", "socket://")


def _serve(device: Simulated, end: LineEnd, url: str, line: dict[str, Any]) -> None:
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=stop.set).start())
    click.echo(url)
    names = ("drop", "garble", "delay", "disconnect", "seed")
    run(device, end, stop, LineFaults(**{name: line[name] for name in names}))


@hookimpl
def uoarm_commands() -> list[Command]:
    """Return `uoarm rocos`, which is the same command."""
    return [Command("rocos", _run, contract=1)]


def _run(words: list[str]) -> int:
    # Not standalone: what is wrong is shown by `uoarm`, with its code of errors.
    return rocos.main(words, prog_name="uoarm rocos", standalone_mode=False) or 0
