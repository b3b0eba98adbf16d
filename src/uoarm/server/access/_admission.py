"""Admission: Host and Origin against foreign web pages, then tokens or client certificates."""

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

from uoarm._whole_file import stamp_of
from uoarm.errors import ConfigurationError
from uoarm.server.access._access_file import read_access
from uoarm.server.access._policy import AccessPolicy, Now, hash_token
from uoarm.server.access._request_head import RefusedError, RequestHead, WrongTokenError
from uoarm.server.access._role import EVERYTHING, Role
from uoarm.server.access._wrong_tokens import WrongTokens

__all__ = ["Admission", "Credentials", "is_loopback"]

_log = logging.getLogger("uoarm.server")


@frozen
class Credentials:
    """What a client authenticates with; its role can be asked for again later.

    Attributes:
        digest: hash of its token, empty where it has none.
        certificate: common name of its certificate, empty where it has none.
    """

    digest: str = ""
    certificate: str = ""


class Admission:
    """Authenticates clients in their handshake.

    Args:
        access: the access file; None lets everyone in with every right, for loopback only.
        origins: origins of web pages that may connect, beside the server's own; `*` for all.
        hosts: names by which the server is reached, beside those of loopback.
        local: whether the server listens on loopback, where Host is checked.
        slowest: seconds after which a wrong token is answered at the latest.
        now: time of day, for expiry.

    Attributes:
        wrong_tokens: says how slowly they are answered, on all ports together.

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
        slowest: float = 2.5,
        now: Now = lambda: datetime.now(timezone.utc),
    ) -> None:
        self._path = access
        self._origins = origins
        self._hosts = hosts
        self._local = local
        self._now = now
        self.wrong_tokens = WrongTokens(slowest)
        self._stamp = self._look()
        self._policy: AccessPolicy | None = None if access is None else read_access(access)

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

    def admit(self, head: RequestHead, certificate: Mapping[str, Any]) -> Credentials:
        """Return the credentials of a client.

        Raises:
            RefusedError: 401, none that are known; a WrongTokenError where it shows a token.
        """
        digest = hash_token(head.token) if head.token else ""
        credentials = Credentials(digest, _common_name(certificate))
        if self.role(credentials) is None:
            kind = WrongTokenError if credentials.digest else RefusedError
            had = "a token that is not valid" if credentials.digest else "no token"
            raise kind(HTTPStatus.UNAUTHORIZED, f"this server needs a token; got {had}")
        return credentials

    def role(self, credentials: Credentials) -> Role | None:
        """Return the role that a client has at this moment, None when it may not stay."""
        if self._policy is None:
            return EVERYTHING
        now = self._now()
        grant = self._policy.grant_of(credentials.digest, now) if credentials.digest else None
        if grant is None and credentials.certificate:
            grant = self._policy.certificate_grant(credentials.certificate, now)
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
            self._policy = read_access(self._path)
        except ConfigurationError as error:
            _log.error("the access file is not used, what it said before still holds: %s", error)

    def _look(self) -> tuple[int, ...] | None:
        return None if self._path is None else stamp_of(self._path)

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
