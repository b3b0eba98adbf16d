"""Who is let in: Host and Origin against strange web pages, then tokens or certificates."""

from __future__ import annotations

import ipaddress
import logging
from collections.abc import Mapping
from datetime import datetime, timezone
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from attrs import frozen

from uoarm.errors import ConfigurationError
from uoarm.server._access_file import read_access
from uoarm.server._request_head import RefusedError, RequestHead
from uoarm.server._role import EVERYTHING, Role
from uoarm.server._tokens import AccessBook, Now, hash_token

__all__ = ["Admission", "Pass", "is_loopback"]

_log = logging.getLogger("uoarm.server")


@frozen
class Pass:
    """What a client showed to be let in; its role can be asked for again later.

    Attributes:
        digest: hash of its token, empty where it has none.
        certificate: common name of its certificate, empty where it has none.
    """

    digest: str = ""
    certificate: str = ""


class Admission:
    """Decides about handshakes.

    Args:
        access: the access file; None lets everyone in with every right, for loopback only.
        origins: origins of web pages that may connect, beside the server's own; `*` for all.
        hosts: names by which the server is reached, beside those of loopback.
        local: whether the server listens on loopback, where Host is checked.
        now: time of day, for expiry.

    Raises:
        ConfigurationError: the access file has mistakes.
    """

    def __init__(
        self,
        access: Path | None,
        *,
        origins: tuple[str, ...] = (),
        hosts: tuple[str, ...] = (),
        local: bool = True,
        now: Now = lambda: datetime.now(timezone.utc),
    ) -> None:
        self._path = access
        self._origins = origins
        self._hosts = hosts
        self._local = local
        self._now = now
        self._stamp = self._look()
        self._book: AccessBook | None = None if access is None else read_access(access)

    def check_page(self, head: RequestHead) -> None:
        """Refuse what a strange web page, or a strange name for this machine, brings here.

        Raises:
            RefusedError: with the status 403.
        """
        host, origin = head.host, head.origin
        if self._local and not self._is_ours(host):
            raise RefusedError(HTTPStatus.FORBIDDEN, f"Host {host[:100]!r} is not this server")
        if origin is None or "*" in self._origins or origin in self._origins:
            return
        if origin.partition("://")[2] != host or not host:
            raise RefusedError(
                HTTPStatus.FORBIDDEN,
                f"pages from {origin[:100]!r} may not connect; allow them with --origin",
            )

    def admit(self, head: RequestHead, certificate: Mapping[str, Any]) -> Pass:
        """Return what the client showed.

        Raises:
            RefusedError: 401, it showed nothing that is known.
        """
        digest = hash_token(head.token) if head.token else ""
        shown = Pass(digest, _common_name(certificate))
        if self.role(shown) is None:
            had = "a token that is not valid" if shown.digest else "no token"
            raise RefusedError(HTTPStatus.UNAUTHORIZED, f"this server needs a token; got {had}")
        return shown

    def role(self, shown: Pass) -> Role | None:
        """Return the role that a client has at this moment, None when it may not stay."""
        if self._book is None:
            return EVERYTHING
        now = self._now()
        grant = self._book.grant_of(shown.digest, now) if shown.digest else None
        if grant is None and shown.certificate:
            grant = self._book.certificate_grant(shown.certificate, now)
        return None if grant is None else grant.role

    def refresh(self) -> None:
        """Read the access file again if it changed; a file with mistakes changes nothing.

        Blocks while it reads: called in a thread of its own, one call at a time.
        """
        stamp = self._look()
        if self._path is None or stamp == self._stamp:
            return
        self._stamp = stamp
        try:
            self._book = read_access(self._path)
        except ConfigurationError as error:
            _log.error("the access file is not used, what it said before still holds: %s", error)

    def _look(self) -> tuple[int, ...] | None:
        try:
            found = None if self._path is None else self._path.stat()
        except OSError:
            return ()
        return None if found is None else (found.st_mtime_ns, found.st_size, found.st_ino)

    def _is_ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        return is_loopback(name) or name in self._hosts


def is_loopback(host: str) -> bool:
    """Say whether a host name or address is this machine's loopback."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _common_name(certificate: Mapping[str, Any]) -> str:
    for part in certificate.get("subject", ()):
        for key, value in part:
            if key == "commonName":
                return str(value)
    return ""
