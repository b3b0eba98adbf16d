"""Commands for a robot that runs behind `uoarm serve`: `apply`, `approve`, `history`, `stop`."""

from __future__ import annotations

import functools
import re
import sys
from collections.abc import Awaitable, Callable, Mapping
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click
from attrs import field, fields_dict, frozen

from uoarm import errors
from uoarm._raised import reason_of
from uoarm.bridge import other_protocol, redirection, refusal, tls_fault
from uoarm.cli._output import UNWRITTEN, echo, styled
from uoarm.cli._shared import (
    BRIDGE,
    fail,
    hold_apart,
    hold_to,
    is_address,
    json_option,
    needing,
    reporting,
    takes_configuration,
    text_of_file,
)
from uoarm.model import write_json

if TYPE_CHECKING:
    import ssl

_Command = TypeVar("_Command", bound=Callable[..., Any])


def _checked_url(_: click.Context, __: click.Parameter, url: str | None) -> str | None:
    """Refuse what is no address of a server before anything is tried."""
    if url is not None and not is_address(url, ("ws", "wss")):
        raise click.BadParameter(f"expected ws://HOST:PORT/ or wss://HOST:PORT/, got {url!r}")
    return url


@frozen
class Remote:
    """A server, what it is shown, and what of it is trusted."""

    url: str
    token: str | None = field(default=None, repr=False)
    authority: str | None = None
    fingerprint: str | None = None
    certificate: str | None = None
    key: str | None = None

    def tls(self) -> ssl.SSLContext | None:
        """Return what TLS needs beyond the system's authorities; blocks for a fingerprint."""
        from uoarm._support.tls import client_context, show_certificate  # noqa: PLC0415 - if needed

        context = None
        if self.fingerprint is not None:
            from uoarm.client import trust_fingerprint  # noqa: PLC0415 - needs an extra

            context = trust_fingerprint(self.url, self.fingerprint)
            if self.certificate is not None:
                show_certificate(context, self.certificate, self.key)
        elif self.authority is not None or self.certificate is not None:
            context = client_context(self.authority, self.certificate, self.key)
        return context


_FINGERPRINT = re.compile("(?:[0-9A-Fa-f]{2}:?){31}[0-9A-Fa-f]{2}")
_HERE = "ws://127.0.0.1:9080/"
_FILE = click.Path(exists=True, dir_okay=False)
_OPTIONS = (
    click.option("--token", envvar="UOARM_TOKEN", help="Shown to the server; also UOARM_TOKEN."),
    click.option(
        "--fingerprint",
        envvar="UOARM_FINGERPRINT",
        help="SHA-256 of the server's certificate, which `uoarm serve --tls auto` prints; also"
        " UOARM_FINGERPRINT.",
    ),
    click.option(
        "--authority", type=_FILE, help="PEM file that the server's certificate rests on."
    ),
    click.option("--certificate", type=_FILE, help="PEM file shown to the server, as a token is."),
    click.option("--key", type=_FILE, help="PEM file of its key."),
)


def remote_options(*, always: bool) -> Callable[[_Command], _Command]:
    """Add the options that name a server: the command is given them as `server: Remote`.

    Args:
        always: whether the command asks a server in any case, without `--url` the one that `uoarm
            serve` starts here by default; else `server` is None without it.
    """

    def add(command: _Command) -> _Command:
        @functools.wraps(command)
        def with_server(*arguments: Any, **options: Any) -> Any:
            if not always:
                hold_apart("FILE", "--url")
                hold_apart("--file", "--url")
                hold_to(
                    "--url", "--token", "--fingerprint", "--authority", "--certificate", "--key"
                )
            given = {name: options.pop(name) for name in fields_dict(Remote)}
            server = None if given["url"] is None else _checked(Remote(**given))
            return command(*arguments, server=server, **options)

        use = "." if always else f", {_HERE} or wss://: ask it, in place of FILE."
        address = click.option(
            "--url",
            default=_HERE if always else None,
            show_default=True,
            callback=_checked_url,
            help=f"Of a running `uoarm serve`{use}",
        )
        for option in (*reversed(_OPTIONS), address):
            with_server = option(with_server)
        return cast("_Command", with_server)

    return add


def _checked(server: Remote) -> Remote:
    """Refuse options that do nothing together, before anything is tried."""
    named = [
        f"--{name}" for name in ("authority", "fingerprint", "certificate") if getattr(server, name)
    ]
    if named and not server.url.startswith("wss://"):
        raise click.UsageError(f"{named[0]} is for TLS: expected wss://, got {server.url}")
    if server.authority and server.fingerprint:
        raise click.UsageError("give --authority or --fingerprint, not both")
    if server.key and not server.certificate:
        raise click.UsageError("--key is that of --certificate, which is missing")
    if server.token is not None and not server.token.strip().isprintable():
        raise click.UsageError("--token: expected one line of visible characters")
    if server.fingerprint is not None and not _FINGERPRINT.fullmatch(server.fingerprint):
        expected = "expected SHA-256, 64 hexadecimal digits"
        raise click.UsageError(f"--fingerprint: {expected}, got {server.fingerprint}")
    return server


def asked(server: Remote, work: Callable[[Any], Awaitable[Any]], *, watches: bool = False) -> Any:
    """Return what a server answers; exits with 4 where it cannot be reached or refuses.

    Args:
        server: which, and what it is shown.
        work: asks it.
        watches: whether Ctrl-C is how this ends: the exit code is 0 then.
    """
    import asyncio  # noqa: PLC0415 - when first needed

    with reporting(), needing("server"):
        from uoarm.client import connect  # noqa: PLC0415 - needs an extra

    async def ask() -> Any:
        tls = await asyncio.to_thread(server.tls)
        async with connect(server.url, token=server.token, tls=tls, reconnect=0) as robot:
            return await work(robot)

    with reporting():
        try:
            return asyncio.run(ask())
        except KeyboardInterrupt:
            if watches:
                sys.exit(0)
            raise
        except errors.UoarmError:
            raise
        except Exception as error:
            if isinstance(error, OSError) and error.errno in UNWRITTEN:
                raise  # of what is printed: `head` has read enough, or a disk is full
            fail(f"{server.url}: {_cause(error, server)}", BRIDGE, "UOA-402")


def _cause(error: Exception, server: Remote) -> str:
    """Say why a server was not reached, in words that need no knowledge of sockets."""
    import ssl  # noqa: PLC0415 - when first needed
    from http import HTTPStatus  # noqa: PLC0415 - when first needed

    if isinstance(error, ConnectionRefusedError):
        return "nothing listens there: is uoarm serve running?"
    if isinstance(error, TimeoutError):
        return "it does not answer"
    if isinstance(error, ssl.SSLError) or (isinstance(error, OSError) and not error.args):
        trust = "give --authority FILE, or --fingerprint with what it printed at its start"
        return tls_fault(error, trust)
    if isinstance(error, OSError):
        return f"it cannot be reached: {reason_of(error)}"
    from websockets.exceptions import InvalidStatus  # noqa: PLC0415 - an extra

    if isinstance(error, InvalidStatus) and error.response.status_code == HTTPStatus.UNAUTHORIZED:
        proof = "" if server.certificate is None else ", or a --certificate whose name it has"
        return f"it admits no client without a token (--token) that its access file has{proof}"
    if other := other_protocol(error, server.url):
        if server.certificate is not None:
            return "it ends the connection: it may not accept --certificate, or that has ended"
        return other
    if said := refusal(error):
        return f"it refuses: {said}"
    return redirection(error, server.url) or reason_of(error)


_MOST_OCTETS = 1_000_000
_PLACE = re.compile(r"^.*?:(\d+:\d+: \$)", re.MULTILINE)


@click.command()
@takes_configuration()
@remote_options(always=True)
@click.option("--rollback", type=click.IntRange(0), help="In place of FILE, this revision again.")
@click.option("--dry-run", is_flag=True, help="Say only what would happen.")
@click.option("--force", is_flag=True, help="Connections that find no other plan may end for it.")
@click.option("--keep", is_flag=True, help="Write it to the robot's file, too.")
@click.option("--reload-code", is_flag=True, help="Read the code of Python components again.")
@click.option("--revision", type=click.IntRange(0), help="Refuse unless this one is in force.")
@json_option
def apply(
    file: str,
    *,
    server: Remote,
    rollback: int | None,
    reload_code: bool,
    as_json: bool,
    **how: Any,
) -> None:
    """Give a running robot another configuration.

    FILE is its configuration from now on. The token's role needs `configure: all`, and with
    --keep also `keep: all`; comments and order of the robot's own file stay. Exit codes: 0
    applied, 1 another revision is in force or the robot's file has been changed meanwhile, 3 the
    file has mistakes or connections would end, 4 the server cannot be reached or refused.
    """
    hold_apart("FILE", "--rollback")
    hold_apart("--file", "--rollback")
    if reload_code and rollback is not None:
        raise click.UsageError("--rollback keeps the code as it is: leave --reload-code out")
    text = text_of_file(file, _MOST_OCTETS) if rollback is None else ""

    async def change_it(robot: Any) -> Mapping[str, Any]:
        try:
            change: Mapping[str, Any] = (
                await robot.configure(text, **how, reload_code=reload_code)
                if rollback is None
                else await robot.rollback(rollback, **how)
            )
        except errors.ConfigurationError as error:
            # The server took the text for that of its own file: the places in it are of this one.
            moved = _PLACE.sub(lambda item: f"{file}:{item[1]}", str(error))
            raise errors.ConfigurationError(moved) from error
        return change

    change = asked(server, change_it)
    echo(write_json(change, indent=2) if as_json else change["text"])


@click.command()
@remote_options(always=True)
@json_option
def history(*, server: Remote, as_json: bool) -> None:
    """Show the revisions of a running robot's configuration.

    The last hundred. The token's role needs `configure: all`. Exit code 4 when the server cannot
    be reached or refused.
    """

    async def ask(robot: Any) -> Any:
        return await robot.revisions()

    revisions = asked(server, ask)
    if as_json:
        echo(write_json(revisions, indent=2))
        return
    for revision in revisions:
        when = datetime.fromtimestamp(revision["time"], timezone.utc).isoformat(timespec="seconds")
        echo(styled(f"revision {revision['revision']}  {when}", bold=True))
        if revision["differences"] or revision["connections"]:
            echo(revision["text"].partition("\n")[2])


@click.command()
@remote_options(always=True)
@click.option("--release", is_flag=True, help="Let commands through again.")
@json_option
def stop(*, server: Remote, release: bool, as_json: bool) -> None:
    """Stop everything that moves of a running robot.

    Commands are refused until --release. The token's role needs `stop: all`, and `release: all`
    for --release. Exit codes: 0 every open input that moves something has stopped, 1 some have not,
    which are named, or the stop would not outlast a restart, 4 the server cannot be reached or
    refused.
    """

    async def act(robot: Any) -> Any:
        return await (robot.release() if release else robot.stop_all())

    report = asked(server, act)
    if release:
        echo("{}" if as_json else "commands are let through again")
        return
    echo(write_json(report, indent=2) if as_json else report["text"])
    sys.exit(0 if report["stopped"] and not report.get("unkept") else 1)


@click.command()
@click.argument("approval", required=False)
@remote_options(always=True)
@click.option("--refuse", is_flag=True, help="Refuse it.")
@click.option("--cause", default="", help="Why, for who asked.")
@json_option
def approve(
    approval: str | None, *, server: Remote, refuse: bool, cause: str, as_json: bool
) -> None:
    """Decide about what agents ask to do with a running robot.

    Without APPROVAL: list what waits. The token's role needs `approve` for the function, and the
    token is of another principal than the one that asked. Exit codes: 0 decided, 4 the server
    cannot be reached or refused.
    """
    if approval is None and (refuse or cause):
        raise click.UsageError("--refuse and --cause are about one APPROVAL: name it")

    async def act(robot: Any) -> Any:
        waiting = [item for item in await robot.approvals() if item["phase"] == "pending"]
        if approval is None:
            return waiting
        shown = next((item for item in waiting if item["approval"] == approval), None)
        if shown is None:
            text = f"no approval {approval} waits for a decision of this role"
            raise errors.UsageError(text, error_code="UOA-707")
        return await robot.approve(
            approval, approve=not refuse, digest=shown["digest"], cause=cause
        )

    answer = asked(server, act)
    if as_json:
        echo(write_json(answer, indent=2))
        return
    for item in answer if approval is None else [answer]:
        echo(_shown_approval(item))
    if approval is None and not answer:
        echo("nothing waits for an approval")


def _shown_approval(item: Mapping[str, Any]) -> str:
    what = f"{item['operation']} {item['function']}{item['port'] and '.' + item['port']}"
    lines = [
        f"{item['approval']}  {item['phase']}  {item['requester']} asks to {what}",
        f"  with      {write_json(item['arguments'])}",
    ]
    envelope = item["envelope"]
    if envelope["ranges"] or envelope["count"] > 1 or envelope["rate"]:
        lines.append(f"  or        {write_json(envelope)}")
    lines.append(f"  by        {', '.join(item['components'])}; revision {item['revision']}")
    if item["preview"]:
        lines.append(f"  it is     {item['preview']}")
    if item["left"]:
        lines.append(f"  ends      in {item['left']:.0f} s")
    return "\n".join(lines)
