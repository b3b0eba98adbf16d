"""What decides in the head of a request, read once; a head that has two readings is refused."""

from __future__ import annotations

from http import HTTPStatus
from urllib.parse import parse_qs, urlsplit

from attrs import frozen
from websockets.datastructures import Headers
from websockets.http11 import Request

from uoarm.errors import UoarmError

__all__ = ["TOKEN_SUBPROTOCOL", "RefusedError", "RequestHead", "WrongTokenError", "read_head"]

TOKEN_SUBPROTOCOL = "uoarm.token."  # noqa: S105 - the name of the place, not a token
_FIELDS = 10


class RefusedError(UoarmError):
    """A handshake that is answered with an HTTP error."""

    def __init__(self, status: HTTPStatus, text: str) -> None:
        super().__init__(text)
        self.status = status


class WrongTokenError(RefusedError):
    """A token that is not valid, which may be a guess."""


@frozen
class RequestHead:
    """The parts of a request that say what it asks for and who asks.

    Attributes:
        path: of the page or endpoint, without the query.
        host: the header `Host`, empty where it has none.
        origin: the header `Origin`; None: it has none.
        token: what it shows, wherever it can put one; empty: none.
        upgrade: whether it asks for a WebSocket.
    """

    path: str
    host: str
    origin: str | None
    token: str
    upgrade: bool


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
    )


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
