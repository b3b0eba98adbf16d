"""Options of a bridge and of an endpoint, declared once: a class whose attributes are the options.

    @frozen
    class TopicOptions(EndpointOptions):
        qos: int = option(1, {"enum": [0, 1, 2]}, "how surely messages arrive")
        expiry: float = option(0.0, SECONDS, "after which the broker drops what is sent", unit="s")

`BridgeType(bridge_options=PlantOptions, endpoint_options=TopicOptions)` makes the check of the
configuration, what an editor explains, and the values that the bridge gets of it; `options_table`
makes the table of a page. A further option is one more line. A class is the source, not a JSON
Schema, since the type checker then knows what the bridge reads; the schema follows from it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urljoin, urlsplit

import attrs
from typing_extensions import Self

from uoarm._mistakes import Mistake, schema_mistakes
from uoarm._raised import Log, reason_of
from uoarm._spelling import Speller
from uoarm._support.yaml import write_path
from uoarm.bridge._border import reading_endpoint
from uoarm.errors import ConfigurationError
from uoarm.model import Endpoint, Options, Schema

if TYPE_CHECKING:
    import ssl

_log = Log("uoarm.bridge")

_OPTION = "uoarm option"
_MOST_SAID = 300  # letters of what a server says
T = TypeVar("T")


def option(
    default: T,
    schema: Mapping[str, Any] | type[DeclaredOptions],
    description: str,
    *,
    unit: str = "",
    required: bool = False,
) -> T:
    """Declare one option, as the value of an attribute of a class of `DeclaredOptions`.

    An attribute whose name would be a word of Python ends with `_`, which the option has not.

    Args:
        default: what it is where it is left out; None: nothing.
        schema: JSON Schema of what may be written; or another such class, for an option that is a
            mapping with options of its own. The class may also stand in the schema, in the place of
            `additionalProperties` or of `items`.
        description: what it does, in one sentence or less, for editors, tables and people.
        unit: of its number, in UCUM, such as `s`.
        required: whether it must be given where the mapping that it stands in is.
    """
    metadata = {_OPTION: (schema, description, unit, required)}
    made: T = attrs.field(default=default, metadata=metadata)
    return made


class DeclaredOptions:
    """Options, checked and complete: what is left out has its default, and lists are tuples.

    A class of them is an attrs class, `@frozen`, whose attributes are all `option(...)`.
    """

    __slots__ = ()

    @classmethod
    def schema(cls) -> Schema:
        """Return the JSON Schema of a mapping of these options; no others are allowed."""
        kind: Any = cls
        return _schema(kind)

    @classmethod
    def of(cls, options: Options) -> Self:
        """Read options.

        Raises:
            ValueError: they are wrong; the text names every one, what was expected and what came.
        """
        given = dict(options)
        found = schema_mistakes(given, cls.schema(), Speller())
        if wrong := [_sentence(mistake) for mistake in found]:
            raise ValueError("; ".join(wrong))
        made: Self = _made(cls, given)
        return made

    def check_together(self) -> None:
        """Hold options that are right each by itself against one another; reads nothing else.

        Raises:
            ValueError: they do not go together; the text says how.
        """


@attrs.frozen
class EndpointOptions(DeclaredOptions):
    """The options of one endpoint. The class itself has none, and so refuses any."""

    @classmethod
    def of_endpoint(cls, endpoint: Endpoint) -> Self:
        """Read the options of an endpoint.

        Raises:
            BridgeError: with BAD_ENDPOINT, the endpoint and everything that is wrong.
        """
        with reading_endpoint(endpoint):
            return cls.of(endpoint.options)


@attrs.frozen
class PeerOptions(EndpointOptions):
    """The options of an endpoint in a framework whose peers come and go by themselves."""

    peer: str = option(
        "required",
        {"enum": ["required", "optional"]},
        "`optional`: available without another end",
    )
    stale_after: float | None = option(
        None,
        {"type": "number", "exclusiveMinimum": 0, "maximum": 86400},
        "seconds without a message until an output is lost; left out: never",
        unit="s",
    )
    at_once: int = option(
        8,
        {"type": "integer", "minimum": 1, "maximum": 64},
        "offered requests or goals that are handled at a time",
    )

    @property
    def peer_required(self) -> bool:
        """Whether an endpoint without another end counts as unavailable."""
        return self.peer == "required"

    @classmethod
    def of_endpoint(cls, endpoint: Endpoint) -> Self:
        """Read the options of an endpoint. What is offered needs no peer.

        Raises:
            BridgeError: with BAD_ENDPOINT, the endpoint and everything that is wrong.
        """
        options = super().of_endpoint(endpoint)
        return attrs.evolve(options, peer="optional") if endpoint.is_offered else options


class BridgeOptions(DeclaredOptions):
    """The options of a bridge, as its plugin gets them."""

    __slots__ = ()


_FILE: Mapping[str, Any] = {"type": "string", "minLength": 1, "x-uoarm-path": True}


@attrs.frozen
class TlsOptions(DeclaredOptions):
    """What a client of TLS trusts, and what it shows: the same for every plugin."""

    ca: str | None = option(
        None, _FILE, "PEM file that the server's certificate rests on; left out: the system's"
    )
    certificate: str | None = option(None, _FILE, "PEM file that the server is shown")
    key: str | None = option(None, _FILE, "of the certificate; left out: in the same file")

    def check_together(self) -> None:
        """Refuse a key without its certificate."""
        if self.key is not None and self.certificate is None:
            raise ValueError("a `key` goes with a `certificate`")

    def context(self, bridge: str) -> ssl.SSLContext:
        """Return the context of a client; the certificate and the name of a server are checked.

        Raises:
            ConfigurationError: a file cannot be used; the text names it.
        """
        from uoarm._support.tls import client_context  # noqa: PLC0415 - slow import

        what = f"bridge {bridge!r}: tls"
        return client_context(self.ca, self.certificate, self.key, what=what)


_TO_DO = {  # by OpenSSL's number of what is wrong with a certificate
    9: "look at the clocks",
    10: "renew it there, or look at this machine's clock",
    62: "connect by a name that it has",
    64: "connect by an address that it has",
}

_OTHER_SPEECH = {"wrong version number", "record layer failure", "http request"}


def tls_fault(error: BaseException, trust: str = "give its authority as `ca` of `tls`") -> str:
    """Say why no connection came about, in words for what TLS raises.

    Args:
        error: any; of another one it is what `reason_of` returns.
        trust: what to do for a certificate that rests on nothing known.
    """
    import ssl  # noqa: PLC0415 - slow import

    if isinstance(error, ssl.SSLCertVerificationError):
        to_do = _TO_DO.get(getattr(error, "verify_code", 0), trust)
        return f"its certificate is not trusted: {error.verify_message.rstrip('.')}; {to_do}"
    if isinstance(error, ssl.SSLError):
        reason = reason_of(error)
        if reason in _OTHER_SPEECH:
            return f"no TLS is spoken there: {reason}"
        if re.search("alert .*(certificate|unknown ca)", reason):
            return f"no TLS: it says of this side's certificate: {reason}"
        return f"no TLS: {reason}"
    if isinstance(error, ConnectionResetError) and not error.args:  # asyncio, in a handshake
        return "no TLS: it ended the connection"
    return reason_of(error)


def other_protocol(error: BaseException, url: str) -> str:
    """Say that what answers at an address of WebSockets speaks no HTTP, "" where it does.

    Args:
        error: of `websockets`.
        url: which was asked for.
    """
    if type(error).__name__ != "InvalidMessage":
        return ""
    return f"no HTTP/1.1 is spoken there{': with TLS it is wss://' if url[:3] == 'ws:' else ''}"


def redirection(error: BaseException, url: str) -> str:
    """Say which address to give where a WebSocket server redirects, "" where it does not.

    Args:
        error: of `websockets`, or what was raised from it.
        url: which was asked for.
    """
    for raised in (error, error.__cause__):
        # A proxy redirects to HTTP, which some versions of the library follow.
        location = getattr(raised, "uri", "")
        if (response := getattr(raised, "response", None)) is not None:
            location = response.headers.get("Location", "")
        if location and location != url:
            wanted = urljoin(re.sub("^ws", "http", url), location)
            return f"it redirects: give {re.sub('^http', 'ws', wanted)} as the address"
    return ""


def refusal(error: BaseException) -> str:
    """Return what a WebSocket server says as it refuses, "" where it says nothing as text.

    Args:
        error: of `websockets`.
    """
    response = getattr(error, "response", None)
    if response is None or not response.headers.get("Content-Type", "").startswith("text/plain"):
        return ""
    said = bytes(response.body or b"").decode(errors="replace").strip()[:_MOST_SAID]
    return said if said.isprintable() else ""


def host_of(url: str) -> str:
    """Return the host of an address.

    Raises:
        ValueError: it has none, or its port cannot be one; the text begins with the address.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f"{url!r}: {error}") from None
    if not host or port == 0:
        raise ValueError(f"{url!r}: expected a host{' and a port from 1 on' if host else ''}")
    return host


def renewed(read: Callable[[], T]) -> Callable[[], T]:
    """Read files now, and return what reads them again: certificates and passwords are renewed.

    To be called for each attempt to connect. Where the files cannot be read any more, as while they
    are written, it returns what was read last, and logs why.

    Raises:
        ConfigurationError: they cannot be read now.
    """
    latest = read()

    def again() -> T:
        nonlocal latest
        try:
            latest = read()
        except ConfigurationError as error:
            _log.warning("%s; what was read before is used", error)
        return latest

    return again


def address_check(
    read: Callable[[tuple[str, ...]], object],
) -> Callable[[tuple[str, ...], Options], str]:
    """Return the `check_endpoint` of a plugin whose addresses are right if they can be read.

    Args:
        read: takes the parts of an address; raises ValueError with a sentence.
    """

    def check(address: tuple[str, ...], options: Options) -> str:
        del options  # each is checked by its own schema
        try:
            read(address)
        except ValueError as error:
            return str(error)
        return ""

    return check


def options_table(schema: Schema, heading: str = "option") -> str:
    """Return the table of a page, in Markdown, of the options that a schema describes."""
    described: Any = schema
    required = described.get("required", ())
    rows = [f"| {heading} | default | meaning |", "|---|---|---|"]
    for name, known in described.get("properties", {}).items():
        default = "must be given" if name in required else _written(known.get("default"))
        rows.append(f"| `{name}` | {default} | {known.get('description', '')} |")
    return "\n".join(rows)


def _written(default: object) -> str:
    if default is None or default in ("", [], {}):
        return ""
    if isinstance(default, bool):
        return str(default).lower()
    return f"{default:,}" if isinstance(default, int | float) else f"`{default}`"


def _attributes(kind: Any) -> tuple[attrs.Attribute[Any], ...]:
    attributes: tuple[attrs.Attribute[Any], ...] = attrs.fields(kind)
    return attributes


@cache
def _schema(kind: Any) -> Schema:
    properties: dict[str, Any] = {}
    required: list[str] = []
    for attribute in _attributes(kind):
        schema, description, unit, is_required = attribute.metadata[_OPTION]
        known = _resolved(schema)
        default = attribute.default
        is_nothing = default is None or default == "" or isinstance(default, DeclaredOptions)
        if not (is_nothing or is_required):
            known["default"] = list(default) if isinstance(default, tuple) else default
        if unit:
            known["x-unit"] = unit
        name = attribute.name.rstrip("_")
        properties[name] = {**known, "description": description}
        if is_required:
            required.append(name)
    closed = {"type": "object", "properties": properties, "additionalProperties": False}
    return {**closed, "required": required} if required else closed


def _resolved(schema: Any) -> dict[str, Any]:
    """Return a schema in which classes are the schemas that they make."""
    known: Any = _schema(schema) if isinstance(schema, type) else schema
    return {
        keyword: _resolved(value) if isinstance(value, type) else value
        for keyword, value in known.items()
    }


def _made(kind: Any, given: Mapping[str, Any]) -> Any:
    """Return the value of options that were checked: each as it was written, or its default."""
    values = {}
    for attribute in _attributes(kind):
        name = attribute.name.rstrip("_")
        if name in given:
            with _inside(name):
                values[attribute.name] = _value(attribute.metadata[_OPTION][0], given[name])
        elif isinstance(attribute.default, dict):  # of the class: a bridge gets one of its own
            values[attribute.name] = dict(attribute.default)
    made = kind(**values)
    made.check_together()
    return made


def _value(schema: Any, value: Any) -> Any:
    if isinstance(schema, type):
        return value if value is None else _made(schema, value)
    if isinstance(value, list):
        return tuple(_value(schema.get("items", {}), item) for item in value)
    others = schema.get("additionalProperties")
    if isinstance(value, Mapping) and isinstance(others, type):
        made = {}
        for name, member in value.items():
            with _inside(name):
                made[name] = _made(others, member)
        return made
    return value


@contextmanager
def _inside(name: str) -> Iterator[None]:
    """Begin what is wrong within with the name of the option."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _sentence(mistake: Mistake) -> str:
    path, sentence, hint, _ = mistake
    place = f"option {write_path(path)}: " if path else ""
    return f"{place}{sentence}{f' ({hint})' if hint else ''}"
