"""The command that records: what functions give, into files, until it is ended."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import click

from uoarm.cli._output import echo, styled
from uoarm.cli._shared import (
    BRIDGE,
    REFUSED,
    FunctionArgument,
    Seconds,
    at_signals,
    json_option,
    open_robot,
    print_error,
    print_failure,
    print_json,
    reading_words,
    takes_configuration,
)
from uoarm.errors import UoarmError
from uoarm.model import format_reason, to_json
from uoarm.record import (
    ChannelCheck,
    Recording,
    RecordingCheck,
    RecordingStatus,
    RecordOptions,
    check_recording,
)

_PROGRESS_SECONDS = 1.0
_MEBI = 1024 * 1024


@click.command()
@click.argument("functions", cls=FunctionArgument, serves=False, nargs=-1)
@takes_configuration(listed="functions")
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The MCAP file; where one is there already, a number is added.",
)
@click.option("--duration", type=Seconds(min=0, min_open=True), help="End after seconds.")
@click.option("--max-size", metavar="SIZE", help="End when all files have so much, such as 2GB.")
@click.option("--split", metavar="SIZE|TIME", help="Begin a new file after 512MB, 10min or so.")
@click.option(
    "--compress",
    "compression",
    type=click.Choice(["zstd", "lz4", "none"]),
    help="Of the chunks (zstd).",
)
@click.option(
    "--ring",
    type=Seconds(min=0, min_open=True),
    metavar="SECONDS",
    help="Keep so much in memory; write it when something is lost or fails, or at SIGUSR1.",
)
@json_option
def record(
    functions: tuple[str, ...],
    file: str,
    *,
    output: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Record what functions give into a file.

    Until Ctrl-C or SIGTERM, or until all of them have ended. Without a NAME it is what `record:` of
    the configuration says. With --json there is a line of progress each second; the last line says
    what was recorded and what was lost. The exit code is 4 where the file could not be written on,
    a function failed, or nothing came of any.
    """
    given = {name: value for name, value in options.items() if value is not None}
    with reading_words():
        RecordOptions.of(**given)
    if len(set(functions)) < len(functions):
        raise click.UsageError("a function is named twice")
    with _dumping() as recordings, open_robot(file) as robot:
        settings = robot.config.record
        if not functions and settings is None:
            context = click.get_current_context()
            argument = next(
                item for item in context.command.params if isinstance(item, FunctionArgument)
            )
            raise argument.missing(context, file)
        if output is None and (functions or settings is None):
            raise click.UsageError("say into which file: -o run.mcap")
        if str(output) == "-":
            raise click.UsageError("-o -: a recording is no stream; name a file, such as run.mcap")
        with robot.record(*functions, path=output, **given) as recording:
            recordings.append(recording)
            with suppress(KeyboardInterrupt, SystemExit):  # Ctrl-C and SIGTERM are how it ends
                _follow(recording, as_json=as_json)
        status = recording.status()
    if as_json:
        print_json(status, in_one_line=True)
    else:
        echo(summary(status))
    failure, error_code = _failure(status)
    if failure:
        print_failure(failure, error_code, as_json=False)
        sys.exit(BRIDGE)
    sys.exit(0)


def _failure(status: RecordingStatus) -> tuple[str, str]:
    """Return why the recording is not what was asked for, and the code of that; or nothing."""
    failed = [f"{item.function}: {item.failure}" for item in status.channels if item.failure]
    if status.state == "failed":
        return f"the recording ended: {status.cause}", "UOA-810"
    if failed:
        return f"what was recorded failed: {'; '.join(failed)}", "UOA-805"
    if not any(channel.recorded for channel in status.channels):
        return "nothing was recorded: no function gave a message that can be written", "UOA-001"
    return "", ""


def _follow(recording: Recording, *, as_json: bool) -> None:
    """Show how it goes on until it has ended."""
    began, is_terminal = time.monotonic(), sys.stderr.isatty()
    while not recording.wait(_PROGRESS_SECONDS):
        status = recording.status()
        if as_json:
            print_json(status, in_one_line=True)
        elif is_terminal:
            click.echo(f"\r{_line(status, time.monotonic() - began)}", nl=False, err=True)
    if is_terminal and not as_json:
        echo(err=True)


@contextmanager
def _dumping() -> Iterator[list[Recording]]:
    """Write the ring of the recording that the list has then at SIGUSR1, in a thread of its own."""
    recordings: list[Recording] = []

    def dump() -> None:
        if not recordings:
            echo("nothing is recorded yet", err=True)
            return
        try:
            echo(f"written: {recordings[0].dump('SIGUSR1')}", err=True)
        except UoarmError as error:
            print_error(error)

    with at_signals(SIGUSR1=dump):
        yield recordings


def _line(status: RecordingStatus, seconds: float) -> str:
    count = sum(channel.recorded for channel in status.channels)
    lost = sum(status.dropped.values())
    return f"{seconds:.0f} s, {count:,} messages, {status.octets / _MEBI:.1f} MiB, {lost:,} lost "


def summary(status: RecordingStatus) -> str:
    """Return what was recorded and lost, a line for each file and function."""
    lines = [*status.files] or ["no file was written"]
    is_whole = not status.dropped.keys() - {"closed", "events"}
    why = "came as it ended" if is_whole else "lost before the writer"
    for channel in status.channels:
        more = f", {channel.unwritable:,} without a form" if channel.unwritable else ""
        missing = channel.received - channel.recorded - channel.unwritable
        lost = f", {missing:,} {why}" if missing else ""
        text = f"{channel.recorded:,} messages as {channel.encoding}"
        lines.append(f"  {channel.function}: {text}{more}{lost}")
    if status.dropped.get("events"):
        lines.append(f"  {status.dropped['events']:,} events lost before the writer")
    return "\n".join(lines)


def check_against(
    file: str, recordings: Sequence[Path], *, is_strict: bool, as_json: bool
) -> NoReturn:
    """Print whether recordings pass a configuration, as data in a list if several, and exit.

    With `is_strict` one passes only if all of it was checked.
    """
    with open_robot(file) as robot:
        results = [check_recording(recording, robot) for recording in recordings]
    if as_json:
        shown = [
            {
                "is_passed": result.is_passed,
                "is_complete": result.is_complete,
                **to_json(result),
            }
            for result in results
        ]
        print_json(shown if len(shown) > 1 else shown[0])
    else:
        for result in results:
            if len(results) > 1:
                echo(styled(result.file, bold=True))
            echo("\n".join(_report(result)))
    passed = [result.is_passed and (result.is_complete or not is_strict) for result in results]
    sys.exit(0 if all(passed) else REFUSED)


def _report(result: RecordingCheck) -> Iterator[str]:
    for note in result.notes:
        yield f"{result.file}: {note}"
    for channel in result.channels:
        yield from _channel_lines(channel)
    if not any(channel.consumers for channel in result.channels):
        yield f"{result.file}: nothing could be checked"


def _channel_lines(channel: ChannelCheck) -> Iterator[str]:
    if not channel.consumers:
        yield f"{channel.topic}: not checked: {channel.cause or 'nothing takes or provides it'}"
        return
    cause = f": {channel.cause}" if channel.cause else ""
    unreadable = f", {channel.unreadable:,} cannot be read" if channel.unreadable else ""
    yield f"{channel.topic}: {channel.messages:,} messages{unreadable}{cause}"
    for consumer in channel.consumers:
        if consumer.unchecked:
            yield f"  {consumer.place}: not checked: {consumer.unchecked}"
            continue
        yield f"  {consumer.place}: {consumer.passed:,} fit, {consumer.failed:,} do not"
        for reason in consumer.reasons:
            yield from (f"    not proven: {line}" for line in format_reason(reason)[:1])
        first = consumer.first
        if first is not None:
            where = f"message {first.number:,} of {first.time}, {first.seconds:.3f} s"
            yield f"    first: {where}: {first.cause}"
