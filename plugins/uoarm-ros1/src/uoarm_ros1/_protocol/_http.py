"""As much of HTTP as XML-RPC needs: a message with a length, read within a budget."""

from __future__ import annotations

from attrs import frozen

from uoarm_ros1._protocol._streams import ProtocolError

__all__ = ["HttpMessage", "HttpReader", "http_reply", "http_request"]

_END = b"\r\n\r\n"
_MAX_HEAD_OCTETS = 16_384
_OK = " 200 "


@frozen
class HttpMessage:
    """A request or a reply.

    Attributes:
        start: its first line.
        body: what it carries.
        keeps: whether the connection stays open behind it.
    """

    start: str
    body: bytes
    keeps: bool

    @property
    def is_ok(self) -> bool:
        """Whether it is a reply that says that the request was done."""
        return _OK in f"{self.start} "


class HttpReader:
    """Takes the messages of one connection apart.

    Args:
        most: octets that a body may have.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._octets = bytearray()
        self._head: tuple[str, int | None, bool] | None = None

    @property
    def held(self) -> int:
        """How many octets wait here for the rest of their message."""
        return len(self._octets)

    @property
    def is_between_messages(self) -> bool:
        """Whether nothing of a message that is not whole has come."""
        return not self._octets and self._head is None

    def received(self, octets: bytes) -> list[HttpMessage]:
        """Take octets; returns the messages that are whole by them.

        Raises:
            ProtocolError: a message is too long, or no HTTP.
        """
        self._octets += octets
        messages = []
        while (message := self._next()) is not None:
            messages.append(message)
        return messages

    def ended(self) -> HttpMessage | None:
        """Return the message that ends with its connection, as one without a length does."""
        if self._head is None or self._head[1] is not None:
            return None
        return HttpMessage(self._head[0], bytes(self._octets), keeps=False)

    def _next(self) -> HttpMessage | None:
        if self._head is None:
            end = self._octets.find(_END)
            if end < 0:
                if len(self._octets) > _MAX_HEAD_OCTETS:
                    raise ProtocolError(f"no HTTP within {_MAX_HEAD_OCTETS:,} octets")
                return None
            self._head = self._read_head(bytes(self._octets[:end]))
            del self._octets[: end + len(_END)]
        start, length, keeps = self._head
        if length is None:
            if len(self._octets) > self._most:
                raise ProtocolError(f"more than {self._most:,} octets")
            return None
        if len(self._octets) < length:
            return None
        body = bytes(self._octets[:length])
        del self._octets[:length]
        self._head = None
        return HttpMessage(start, body, keeps)

    def _read_head(self, octets: bytes) -> tuple[str, int | None, bool]:
        start, *lines = octets.decode("latin-1").split("\r\n")
        if "HTTP/1." not in start:
            raise ProtocolError(f"expected HTTP, got {start[:80]!r}")
        fields = {
            name.strip().lower(): value.strip()
            for name, _, value in (line.partition(":") for line in lines)
        }
        if "transfer-encoding" in fields:
            raise ProtocolError("a body in chunks, which XML-RPC has not")
        text = fields.get("content-length")
        length = None
        if text is not None:
            if not text.isascii() or not text.isdigit() or len(text) > len(str(self._most)) + 1:
                raise ProtocolError(f"a body of {text[:20]!r} octets; {self._most:,} are allowed")
            length = int(text)
            if length > self._most:
                raise ProtocolError(f"a body of {length:,} octets; {self._most:,} are allowed")
        said = fields.get("connection", "").lower()
        keeps = said == "keep-alive" or ("HTTP/1.1" in start and said != "close")
        if length is None and not start.startswith("HTTP/"):
            length = 0  # of a request without a body
        return start, length, keeps


def http_request(host: str, port: int, body: bytes) -> bytes:
    """Return a request of XML-RPC, after which the connection ends."""
    head = (
        f"POST / HTTP/1.1\r\nHost: {host}:{port}\r\nUser-Agent: uoarm\r\nConnection: close\r\n"
        f"Content-Type: text/xml\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    return head.encode("latin-1", "replace") + body


def http_reply(body: bytes, *, keeps: bool, status: str = "200 OK") -> bytes:
    """Return a reply of XML-RPC."""
    head = (
        f"HTTP/1.1 {status}\r\nServer: uoarm\r\nContent-Type: text/xml\r\n"
        f"Connection: {'keep-alive' if keeps else 'close'}\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    return head.encode("latin-1") + body
