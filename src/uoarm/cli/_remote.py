"""What a command asks of a robot that runs behind `uoarm serve`, here or elsewhere."""

from __future__ import annotations

import asyncio
import functools
import os
import ssl
import sys
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from typing import Any, TypeVar, cast

import click
from attrs import field, fields_dict, frozen

from uoarm import errors
from uoarm.cli._shared import BRIDGE, fail, needing, reporting

__all__ = ["Remote", "asked", "remote_options"]


_Command = TypeVar("_Command", bound=Callable[..., Any])


def _checked_url(_: click.Context, __: click.Parameter, url: str | None) -> str | None:
    """Refuse what is no address of a server before anything is tried."""
    if url is not None and not url.startswith(("ws://", "wss://")):
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
        context = None
        if self.fingerprint is not None:
            from uoarm.client import trust_fingerprint  # noqa: PLC0415 - needs an extra

            context = trust_fingerprint(self.url, self.fingerprint)
        elif self.authority is not None or self.certificate is not None:
            context = ssl.create_default_context(cafile=self.authority)
        if context is not None and self.certificate is not None:
            context.load_cert_chain(self.certificate, self.key)
        return context


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
            given = {name: options.pop(name) for name in fields_dict(Remote)}
            server = None if given["url"] is None else _checked(Remote(**given))
            return command(*arguments, server=server, **options)

        use = "." if always else f", {_HERE} or wss://: show what runs."
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
    return server


def asked(server: Remote, work: Callable[[Any], Awaitable[Any]], *, watches: bool = False) -> Any:
    """Return what a server answers; exits with 4 where it cannot be reached or refuses.

    Args:
        server: which, and what it is shown.
        work: asks it.
        watches: whether Ctrl-C is how this ends: the exit code is 0 then.
    """
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
        except Exception as error:  # noqa: BLE001 - sockets and handshakes fail in many ways
            fail(f"{server.url}: {_cause(error)}", BRIDGE)


def _cause(error: Exception) -> str:
    """Say why a server was not reached, in words that need no knowledge of sockets."""
    if isinstance(error, ConnectionRefusedError):
        return "nothing listens there: is uoarm serve running?"
    if isinstance(error, TimeoutError):
        return "it does not answer"
    if isinstance(error, ssl.SSLCertVerificationError):
        why = f"its certificate is not trusted: {error.verify_message}"
        return f"{why}; give --authority FILE, or --fingerprint with what it printed at its start"
    if isinstance(error, ssl.SSLError):
        return f"no TLS: {error.reason or error}"
    if isinstance(error, OSError):
        number = error.errno or 0  # asyncio's own text repeats the address; negative: of names
        return f"it cannot be reached: {os.strerror(number) if number > 0 else error.strerror}"
    from websockets.exceptions import InvalidMessage, InvalidStatus  # noqa: PLC0415 - an extra

    if isinstance(error, InvalidStatus) and error.response.status_code == HTTPStatus.UNAUTHORIZED:
        return "it lets nobody in without a token (--token) that its access file has"
    if isinstance(error, InvalidMessage):
        return "no HTTP is spoken there: with TLS it is wss://"
    return f"{type(error).__name__}: {error}"
