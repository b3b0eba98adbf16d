"""XML-RPC and as much of HTTP as it needs, as master and nodes speak them, and what a node answers.

Without I/O. No document type and so no entity is accepted: nothing that comes can grow in being
read.
"""

from __future__ import annotations

import base64
import binascii
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import escape

from attrs import define, field, frozen

from uoarm.model import Budget
from uoarm_ros1._tcpros import ProtocolError

XML_BUDGET = Budget(octets=8 << 20, elements=200_000, depth=64)
_LEAST, _MOST = -(2**31), 2**31 - 1
_LEAVES = frozenset(
    {"int", "i4", "i8", "boolean", "double", "string", "base64", "dateTime.iso8601", "nil"}
)
_UNWRITABLE = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_LEVELS_EACH = 4  # value, struct, member, value: of one level of the message
_DONE, _FAILED, _WRONG = 1, 0, -1
_MOST_PUBLISHERS = 1000


class Fault(Exception):  # noqa: N818 - the protocol's own word
    """The other side answered that it failed; the text says why."""


def encode_call(method: str, arguments: Sequence[Any]) -> bytes:
    """Return a call as a document.

    Raises:
        ValueError: an argument has no form in XML-RPC.
    """
    params = "".join(f"<param>{_encoded(argument)}</param>" for argument in arguments)
    name = f"<methodName>{escape(method)}</methodName>"
    text = f"<methodCall>{name}<params>{params}</params></methodCall>"
    return f"<?xml version='1.0'?>\n{text}\n".encode()


def encode_reply(result: Any) -> bytes:
    """Return a reply as a document; of a Fault one that says so."""
    if isinstance(result, Fault):
        fault = _encoded({"faultCode": 1, "faultString": str(result)})
        text = f"<methodResponse><fault>{fault}</fault></methodResponse>"
    else:
        value = _encoded(result)
        text = f"<methodResponse><params><param>{value}</param></params></methodResponse>"
    return f"<?xml version='1.0'?>\n{text}\n".encode()


def decode_call(octets: bytes, budget: Budget = XML_BUDGET) -> tuple[str, list[Any]]:
    """Return the method and the arguments of a call.

    Raises:
        ProtocolError: it is no call, or more than the budget allows.
    """
    reading = _read(octets, budget)
    if reading.root != "methodCall" or reading.method is None:
        raise ProtocolError("expected a call of XML-RPC")
    return reading.method, reading.params


def decode_reply(octets: bytes, budget: Budget = XML_BUDGET) -> Any:
    """Return what a call returned.

    Raises:
        Fault: it failed.
        ProtocolError: it is no reply, or more than the budget allows.
    """
    reading = _read(octets, budget)
    if reading.root != "methodResponse" or len(reading.params) != 1:
        raise ProtocolError("expected a reply of XML-RPC with one value")
    (value,) = reading.params
    if reading.is_fault:
        said = value.get("faultString", "") if isinstance(value, dict) else value
        raise Fault(str(said)[:500].strip() or "it says not why")
    return value


def _encoded(value: Any) -> str:
    if value is True or value is False:
        inner = f"<boolean>{int(value)}</boolean>"
    elif isinstance(value, int):
        if not _LEAST <= value <= _MOST:
            raise ValueError(f"{value} has more than the 32 bits of an integer in XML-RPC")
        inner = f"<int>{value}</int>"
    elif isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{value} has no form in XML-RPC")
        inner = f"<double>{value!r}</double>"
    elif isinstance(value, str):
        inner = f"<string>{_escaped(value)}</string>"
    elif isinstance(value, bytes | bytearray | memoryview):
        inner = f"<base64>{base64.b64encode(value).decode()}</base64>"
    elif isinstance(value, dict):
        inner = f"<struct>{''.join(map(_member, value.items()))}</struct>"
    elif isinstance(value, list | tuple):
        inner = f"<array><data>{''.join(map(_encoded, value))}</data></array>"
    else:
        raise ValueError(f"{type(value).__name__} has no form in XML-RPC")
    return f"<value>{inner}</value>"


def _member(item: tuple[Any, Any]) -> str:
    name, value = item
    if not isinstance(name, str):
        raise ValueError(f"a member is named by {name!r}, and XML-RPC has texts for names")  # noqa: TRY004
    return f"<member><name>{_escaped(name)}</name>{_encoded(value)}</member>"


def _escaped(text: str) -> str:
    if found := _UNWRITABLE.search(text):
        raise ValueError(f"{text[:60]!r} has the character {found[0]!r}, which XML has not")
    return escape(text, {"\r": "&#13;"})  # else it is read as a line feed


@define
class _Level:
    """An element that is open.

    Attributes:
        tag: its name.
        texts: what stood in it directly.
        values: of the elements within that are closed.
        name: of a member.
    """

    tag: str
    texts: list[str] = field(factory=list)
    values: list[Any] = field(factory=list)
    name: str = ""


class _Document:
    """One document while it is read."""

    def __init__(self, budget: Budget) -> None:
        self._budget = budget
        self._levels: list[_Level] = []
        self._elements = 0
        self.root = ""
        self.method: str | None = None
        self.params: list[Any] = []
        self.is_fault = False

    def start(self, tag: str, attributes: object) -> None:
        del attributes
        self._elements += 1
        if self._elements > _LEVELS_EACH * self._budget.elements:
            raise ProtocolError(f"XML of more than {self._budget.elements:,} values")
        if len(self._levels) > _LEVELS_EACH * self._budget.depth:
            raise ProtocolError(f"XML nested more than {self._budget.depth} levels deep")
        self.root = self.root or tag
        self._levels.append(_Level(tag))

    def text(self, text: str) -> None:
        if self._levels:
            self._levels[-1].texts.append(text)

    def refuse(self, *_: object) -> None:
        raise ProtocolError("XML with a document type, of which XML-RPC has none")

    def end(self, tag: str) -> None:
        level = self._levels.pop()
        above = self._levels[-1] if self._levels else _Level("")
        text = "".join(level.texts)
        if tag in _LEAVES:
            above.values.append(_leaf(tag, text))
        elif tag == "value":
            above.values.append(level.values[0] if level.values else text)
        elif tag == "name":
            above.name = text
        elif tag == "member":
            above.values.append((level.name, level.values[0] if level.values else ""))
        elif tag == "struct":
            above.values.append(_struct(level.values))
        elif tag == "array":
            above.values.append(level.values)
        elif tag == "methodName":
            self.method = text.strip()
        elif tag in {"param", "fault"}:
            self.params.extend(level.values[:1])
            self.is_fault = self.is_fault or tag == "fault"
        elif tag in {"data", "params"}:
            above.values.extend(level.values)
        elif self._levels:
            raise ProtocolError(f"XML with an element {tag[:40]!r}, which XML-RPC has not")


def _struct(members: list[Any]) -> dict[str, Any]:
    if not all(isinstance(member, tuple) for member in members):
        raise ProtocolError("a structure in XML-RPC with something that is no member")
    return dict(members)


def _leaf(tag: str, text: str) -> Any:
    try:
        if tag in {"int", "i4", "i8"}:
            if len(text.strip()) > len(str(2**64)):
                raise ValueError(text)  # noqa: TRY301 - as int does with other texts
            return int(text)
        if tag == "boolean":
            return {"1": True, "0": False, "true": True, "false": False}[text.strip()]
        if tag == "double":
            return float(text)
        if tag == "base64":
            return base64.b64decode("".join(text.split()), validate=True)
    except (ValueError, KeyError, binascii.Error):
        raise ProtocolError(f"XML-RPC with {text[:40]!r} for a {tag}") from None
    return None if tag == "nil" else text


def _read(octets: bytes, budget: Budget) -> _Document:
    if len(octets) > budget.octets:
        raise ProtocolError(f"XML of {len(octets):,} octets; {budget.octets:,} are allowed")
    document = _Document(budget)
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = document.start
    parser.EndElementHandler = document.end
    parser.CharacterDataHandler = document.text
    parser.StartDoctypeDeclHandler = document.refuse
    parser.EntityDeclHandler = document.refuse
    try:
        parser.Parse(octets, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise ProtocolError(f"no XML: {error}") from error
    return document


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


@frozen
class PublisherUpdate:
    """The master said who publishes a topic now: the addresses of their APIs."""

    topic: str
    publishers: tuple[str, ...]


@frozen
class ParameterUpdate:
    """The master said that a parameter, or one within it, has changed."""

    key: str
    value: Any


@frozen
class Shutdown:
    """The master, or an operator, asked the node to end."""

    reason: str


@frozen
class TransportRefusal:
    """The caller asked for a topic of ours, and not over TCPROS."""

    topic: str


Event = PublisherUpdate | ParameterUpdate | Shutdown | TransportRefusal


@define
class NodeApi:
    """The answers of one node.

    Attributes:
        caller: the node's own name.
        master: where its master is.
        process: the number of its process.
        host: under which others reach it.
        port: on which it takes connections of TCPROS; 0: not yet.
        publications: types by topic.
        subscriptions: types by topic.
        connections: returns what `getBusInfo` lists.
    """

    caller: str
    master: str
    process: int
    host: str
    port: int = 0
    publications: dict[str, str] = field(factory=dict)
    subscriptions: dict[str, str] = field(factory=dict)
    connections: Callable[[], list[list[Any]]] = list

    def answer(self, method: str, arguments: list[Any]) -> tuple[Any, Event | None]:
        """Return what a call returns, and what it means for the node."""
        known: Mapping[str, Callable[..., tuple[list[Any], Event | None]]] = {
            "getBusStats": self._bus_stats,
            "getBusInfo": self._bus_info,
            "getMasterUri": self._master_uri,
            "getPid": self._pid,
            "getSubscriptions": self._subscriptions,
            "getPublications": self._publications,
            "requestTopic": self._request_topic,
            "publisherUpdate": self._publisher_update,
            "paramUpdate": self._param_update,
            "shutdown": self._shutdown,
        }
        if method not in known:
            return Fault(f"a node has no method {method[:80]!r}"), None
        if not arguments or not isinstance(arguments[0], str):
            return Fault(f"{method} is called with the name of the caller first"), None
        try:
            return known[method](*arguments[1:])
        except TypeError:
            return Fault(f"{method} does not take {len(arguments) - 1} arguments"), None

    def _bus_stats(self) -> tuple[list[Any], None]:
        return [_DONE, "", [[], [], []]], None

    def _bus_info(self) -> tuple[list[Any], None]:
        return [_DONE, "bus info", self.connections()], None

    def _master_uri(self) -> tuple[list[Any], None]:
        return [_DONE, "", self.master], None

    def _pid(self) -> tuple[list[Any], None]:
        return [_DONE, "", self.process], None

    def _subscriptions(self) -> tuple[list[Any], None]:
        return [_DONE, "", [[topic, kind] for topic, kind in self.subscriptions.items()]], None

    def _publications(self) -> tuple[list[Any], None]:
        return [_DONE, "", [[topic, kind] for topic, kind in self.publications.items()]], None

    def _request_topic(
        self, topic: object, protocols: object
    ) -> tuple[list[Any], TransportRefusal | None]:
        if not isinstance(topic, str) or topic not in self.publications:
            return [_WRONG, f"{self.caller} does not publish {str(topic)[:200]}", []], None
        wanted = protocols if isinstance(protocols, list) else []
        if any(isinstance(protocol, list) and protocol[:1] == ["TCPROS"] for protocol in wanted):
            return [_DONE, "ready", ["TCPROS", self.host, self.port]], None
        return [_FAILED, "only TCPROS is spoken here", []], TransportRefusal(topic)

    def _publisher_update(
        self, topic: object, publishers: object
    ) -> tuple[list[Any], PublisherUpdate | None]:
        if (
            not isinstance(topic, str)
            or not isinstance(publishers, list)
            or len(publishers) > _MOST_PUBLISHERS
            or not all(isinstance(publisher, str) for publisher in publishers)
        ):
            return [_WRONG, "expected a topic and a list of addresses", 0], None
        return [_DONE, "", 0], PublisherUpdate(topic, tuple(publishers))

    def _param_update(self, key: object, value: Any) -> tuple[list[Any], ParameterUpdate | None]:
        if not isinstance(key, str):
            return [_WRONG, "expected the name of a parameter", 0], None
        return [_DONE, "", 0], ParameterUpdate(key, value)

    def _shutdown(self, reason: object = "") -> tuple[list[Any], Shutdown]:
        return [_DONE, "", 0], Shutdown(str(reason)[:500])
