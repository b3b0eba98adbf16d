"""Admission: Host and Origin against foreign web pages, then tokens or client certificates."""

from __future__ import annotations

import ipaddress
import re
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from attrs import define, evolve, frozen
from websockets.datastructures import Headers
from websockets.http11 import Request

from uoarm._raised import Log
from uoarm._support.files import stamp_of
from uoarm.errors import ConfigurationError, UoarmError
from uoarm.model import is_loopback
from uoarm.server.access._access_file import read_access
from uoarm.server.access._role import LOCAL, AccessPolicy, AccessRole, Grant, hash_token

_FREE, _FREE_IN_ALL = 5, 50
_FIRST_SECONDS = 0.1
_FORGIVEN_SECONDS = 10.0
_ADDRESSES = 4096
_NETWORK_BITS = 64


@define
class _Guesses:
    """How many wrong tokens came lately: one less after each ten seconds."""

    count: float = 0.0
    at: float = 0.0

    def add(self, now: float) -> float:
        self.count = max(0.0, self.count - max(0.0, now - self.at) / _FORGIVEN_SECONDS) + 1
        self.at = now
        return self.count


class WrongTokens:
    """Says how long a client that shows a wrong token waits for its answer. No clock, no waiting.

    The pause doubles with each wrong token of an address, and with those of all addresses together
    beyond a number that honest clients with an old token come to. Nothing here is asked about a
    right token: who has one is let in at once, from the same address, too. So that those who wait
    do not take all connections, only some may; the others get no answer.

    Args:
        longest: seconds for which a client waits at most.
        waiting: clients that may wait for their answer at one time; of one address an eighth.
    """

    def __init__(self, longest: float, waiting: int = 64) -> None:
        self._longest = longest
        self._most = waiting
        self._most_of_one = max(1, waiting // 8)
        self._of: OrderedDict[str, _Guesses] = OrderedDict()
        self._all = _Guesses()
        self._waiting: Counter[str] = Counter()

    def begin(self, address: str, now: float) -> float | None:
        """Count a wrong token; return the seconds until its answer, None for no answer at all.

        Where it waits, `end` follows.
        """
        network = _network(address)
        guesses = self._of.setdefault(network, _Guesses())
        self._of.move_to_end(network)
        if len(self._of) > _ADDRESSES:
            self._of.popitem(last=False)
        of_all = self._all.add(now)
        beyond = max(guesses.add(now) - _FREE, of_all - _FREE_IN_ALL)
        pause = 0.0 if beyond <= 0 else _FIRST_SECONDS * 2 ** min(beyond - 1, 30)
        if self._waiting[network] >= self._most_of_one or self._waiting.total() >= self._most:
            return None
        self._waiting[network] += 1
        return min(self._longest, pause)

    def end(self, address: str) -> None:
        """Note that a client waits no more."""
        self._waiting -= Counter({_network(address): 1})


def _network(address: str) -> str:
    """Return what counts as one address: of IPv6 a network, of which a guesser has all."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv4Address):
        return str(found)
    if found.ipv4_mapped is not None:
        return str(found.ipv4_mapped)
    return str(ipaddress.ip_network((found, _NETWORK_BITS), strict=False))


TOKEN_SUBPROTOCOL = "uoarm.token."  # noqa: S105 - the name of the place, not a token
MANAGER_HEADER = "Uoarm-Manager"
_IDENTITY = re.compile(r"[0-9a-f]{32}")
_FIELDS = 10


class RefusedError(UoarmError):
    """A handshake that is answered with an HTTP error."""

    error_code = "UOA-705"

    def __init__(self, status: HTTPStatus, text: str) -> None:
        super().__init__(text)
        self.status = status


class WrongTokenError(RefusedError):
    """A token that is not valid, which may be a guess."""

    error_code = "UOA-706"


@frozen
class RequestHead:
    """The parts of a request that say what it asks for and who asks.

    Attributes:
        path: of the page or endpoint, without the query.
        host: the header `Host`, empty where it has none.
        origin: the header `Origin`; None: it has none.
        token: what it shows, wherever it can put one; empty: none.
        upgrade: whether it asks for a WebSocket.
        importer: the identity of the manager that it says it is; empty: none.
    """

    path: str
    host: str
    origin: str | None
    token: str
    upgrade: bool
    importer: str = ""


def read_head(request: Request) -> RequestHead:
    """Read the head of a request.

    Raises:
        RefusedError: 400, the path is none, or a header that decides comes twice: two readers,
            such as a proxy and this server, might each believe another one.
    """
    headers = request.headers
    try:
        target = urlsplit(request.path)
        query = parse_qs(target.query, max_num_fields=_FIELDS) if target.query else {}
    except ValueError:  # its text, and the path, may hold a token: neither goes to the log
        raise RefusedError(
            HTTPStatus.BAD_REQUEST,
            f"the path cannot be read: expected one such as / with at most {_FIELDS} fields",
        ) from None
    host, origin = _one(headers, "Host"), _one(headers, "Origin")
    return RequestHead(
        target.path,
        host or "",
        origin,
        _token(_one(headers, "Authorization") or "", headers, query.get("token", [])),
        "Upgrade" in headers,
        _importer(_one(headers, MANAGER_HEADER)),
    )


def _importer(identity: str | None) -> str:
    if identity is not None and not _IDENTITY.fullmatch(identity):
        text = f"the header {MANAGER_HEADER} has no identity: expected 32 hexadecimal digits"
        raise RefusedError(HTTPStatus.BAD_REQUEST, text)
    return identity or ""


def _one(headers: Headers, name: str) -> str | None:
    values = headers.get_all(name)
    if len(values) > 1:
        raise RefusedError(
            HTTPStatus.BAD_REQUEST, f"the header {name} comes {len(values)} times; once is allowed"
        )
    return values[0] if values else None


def _token(authorization: str, headers: Headers, shown: list[str]) -> str:
    kind, _, token = authorization.partition(" ")
    if kind.lower() == "bearer" and token.strip():
        return token.strip()
    for offer in ",".join(headers.get_all("Sec-WebSocket-Protocol")).split(","):
        if offer.strip().startswith(TOKEN_SUBPROTOCOL):
            return offer.strip().removeprefix(TOKEN_SUBPROTOCOL)
    return shown[0] if shown else ""


_log = Log("uoarm.server")


@frozen
class Credentials:
    """What a client authenticates with; its role can be asked for again later.

    Attributes:
        digest: hash of its token, empty where it has none.
        certificate: common name of its certificate, empty where it has none.
        importer: identity of the manager that imports with them, which then gets what is exported
            only; empty: none.
    """

    digest: str = ""
    certificate: str = ""
    importer: str = ""


class Admission:
    """Authenticates clients in their handshake.

    Args:
        access: the access file; None lets everyone in with every right, for loopback only.
        origins: origins of web pages that may connect, beside the server's own; `*` for all.
        hosts: names by which the server is reached, beside those of loopback.
        local: whether the server listens on loopback, where Host is checked.
        slowest: seconds after which a wrong token is answered at the latest.
        exports: returns what other managers may import, by role.

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
        exports: Callable[[], Mapping[str, tuple[str, ...]]] = dict,
    ) -> None:
        self._exports = exports
        self._path = access
        self._origins = origins
        self._hosts = hosts
        self._local = local
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
            raise RefusedError(
                HTTPStatus.FORBIDDEN,
                f"Host {host[:100]!r} is not this server; --allow-host lets another name in",
            )
        if origin is None or "*" in self._origins or origin in self._origins:
            return
        if origin.partition("://")[2] != host or not host:
            raise RefusedError(
                HTTPStatus.FORBIDDEN,
                f"pages from {origin[:100]!r} may not connect to {host[:100]!r}; "
                "allow them with --origin",
            )

    def admit(self, head: RequestHead, certificate: Mapping[str, Any]) -> Credentials:
        """Return the credentials of a client, without what gives it no right.

        Raises:
            RefusedError: 401, none that are known; a WrongTokenError where it shows a token.
        """
        # With what gives no right, a client could be another one with each of its requests.
        if self._policy is None:
            return Credentials(importer=head.importer)
        digest = hash_token(head.token) if head.token else ""
        shown = Credentials(digest, _common_name(certificate), head.importer)
        if self.role(evolve(shown, certificate="")) is None:
            shown = evolve(shown, digest="")
        if self.role(shown) is None:
            kind = WrongTokenError if digest else RefusedError
            had = "a token that is not valid" if digest else "no token"
            raise kind(HTTPStatus.UNAUTHORIZED, f"this server needs a token; got {had}")
        return shown

    def role(self, credentials: Credentials) -> AccessRole | None:
        """Return the role that a client has at this moment, None when it may not stay."""
        grant = self.grant(credentials)
        return None if grant is None else grant.role

    def grant(self, credentials: Credentials) -> Grant | None:
        """Return the role of a client and whose it is, None when it may not stay."""
        grant = self._whole_grant(credentials)
        if grant is None or not credentials.importer:
            return grant
        role = grant.role
        return evolve(grant, role=role.exporting(self._exports().get(role.name, ())))

    def _whole_grant(self, credentials: Credentials) -> Grant | None:
        if self._policy is None:
            return LOCAL
        now = datetime.now(timezone.utc)
        grant = self._policy.grant_of(credentials.digest, now) if credentials.digest else None
        if grant is None and credentials.certificate:
            grant = self._policy.certificate_grant(credentials.certificate, now)
        return grant

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


def _common_name(certificate: Mapping[str, Any]) -> str:
    for part in certificate.get("subject", ()):
        for key, value in part:
            if key == "commonName":
                return str(value)
    return ""
