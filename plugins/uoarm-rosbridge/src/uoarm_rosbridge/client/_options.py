"""Addresses and options as the configuration writes them; no I/O but the files that are named."""

from __future__ import annotations

import hashlib
import os
import re
import ssl
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from attrs import evolve, frozen

from uoarm.bridge import EndpointOptions, option, reading_endpoint
from uoarm.errors import ConfigurationError
from uoarm.model import Budget, Endpoint, Options, Role, Schema, is_loopback

__all__ = [
    "BRIDGE_OPTIONS",
    "Address",
    "ClientOptions",
    "Port",
    "address_of",
    "client_options",
    "is_type",
    "mistake",
    "port_of",
    "topic_name",
]

_TEXT: Mapping[str, object] = {"type": "string", "minLength": 1}
_SECONDS: Mapping[str, object] = {"type": "number", "minimum": 0, "maximum": 60}
_COUNT: Mapping[str, object] = {"type": "integer", "minimum": 1}
_PARAMETER = "parameter"
_COMPRESSIONS = ("cbor", "cbor-raw", "none")
_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*")
_PARAMETER_NAME = re.compile(r"[A-Za-z0-9_/~.:-]+")
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/(msg|srv|action))?/[A-Za-z][A-Za-z0-9_]*")


def _closed(properties: Mapping[str, object], *required: str) -> Schema:
    return {
        "type": "object",
        "properties": dict(properties),
        "required": list(required),
        "additionalProperties": False,
    }


BRIDGE_OPTIONS: Schema = _closed(
    {
        "url": {
            "type": "string",
            "pattern": r"^wss?://[^@?#\s]+$",
            "examples": ["ws://robot:9090"],
            "description": "of the server",
        },
        "tls": _closed({"ca": _TEXT, "certificate": _TEXT, "key": _TEXT}),
        "token_file": {**_TEXT, "description": "whose text is shown as a bearer token"},
        "auth": _closed(
            {"secret_file": _TEXT, "client": _TEXT, "dest": _TEXT, "level": _TEXT},
            "secret_file",
            "client",
            "dest",
        ),
        "compression": {
            "enum": [*_COMPRESSIONS],
            "description": "how messages come; default cbor",
        },
        "plain_secrets": {
            "const": True,
            "description": "a token or `auth` may go without TLS to another machine",
        },
        "wait": {**_SECONDS, "description": "seconds to wait for an answer of rosapi; default 3"},
        "check": {
            "type": "number",
            "minimum": 0.05,
            "maximum": 3600,
            "description": "seconds between looks at who publishes; default 2",
        },
        "grace": {
            **_SECONDS,
            "description": "seconds that the connection may be away before what is open is lost; "
            "default 5",
        },
        "silence": {
            "type": "number",
            "minimum": 0.5,
            "maximum": 3600,
            "description": "seconds without an answer to a ping until the server counts as lost; "
            "default 10",
        },
        "max_octets": {**_COUNT, "description": "of a message that comes; default 16 MiB"},
        "max_values": {**_COUNT, "description": "of a message that comes; default 500,000"},
    },
    "url",
)


@frozen
class Address:
    """A topic, a service, an action or a parameter by name.

    Attributes:
        name: as written.
        type: of ROS 1 or 2; empty: what the server says. Of a parameter `parameter`.
    """

    name: str
    type: str = ""

    @property
    def is_parameter(self) -> bool:
        """Whether it is a parameter."""
        return self.type == _PARAMETER

    @property
    def is_action(self) -> bool:
        """Whether its type is that of an action of ROS 2."""
        return "/action/" in self.type

    @property
    def is_actionlib(self) -> bool:
        """Whether its type is that of an action of ROS 1, which is five topics."""
        return self.type.count("/") == 1 and self.type.endswith("Action")


@frozen
class Port(EndpointOptions):
    """The options of one endpoint."""

    peer: str = option(
        "required",
        {"enum": ["required", "optional"]},
        "`optional`: available without another end, as for publishing outward",
    )
    stale_after: float | None = option(
        None,
        {"type": "number", "exclusiveMinimum": 0, "maximum": 86400},
        "of an output: seconds without a message after which it is lost; left out: never",
        unit="s",
    )
    throttle: int = option(
        0,
        {"type": "integer", "minimum": 0, "maximum": 3_600_000},
        "of an output: milliseconds between two messages at the least; the server leaves others "
        "out",
        unit="ms",
    )
    queue: int = option(
        100,
        {"type": "integer", "minimum": 1, "maximum": 100_000},
        "messages that may wait here for one consumer; then the oldest are dropped and counted",
    )
    latch: bool = option(
        False,
        {"type": "boolean"},
        "of an input: the server keeps the last message for who comes later. Of an output: the "
        "last message stands, as a map does; sent again after a break, it is not delivered again",
    )
    compression: str | None = option(
        None,
        {"enum": [*_COMPRESSIONS]},
        "of an output: how its messages come; left out: as the bridge says. All outputs on one "
        "topic have that of the first",
    )
    at_once: int = option(
        8,
        {"type": "integer", "minimum": 1, "maximum": 64},
        "of what is offered: requests that are handled at the same time",
    )

    @property
    def peer_required(self) -> bool:
        """Whether an endpoint without another end counts as unavailable."""
        return self.peer == "required"


@frozen
class ClientOptions:
    """The options of a bridge.

    Attributes:
        url: of the server.
        context: of TLS; None: it is not spoken, or as the system trusts.
        headers: of the handshake.
        authentication: returns the operation that a server with rosauth wants first.
        compression: how messages come.
        wait: seconds to wait for an answer of rosapi.
        check: seconds between looks at who publishes.
        grace: seconds that the connection may be away before it is lost.
        silence: seconds without an answer to a ping until the server is lost.
        budget: of a message that comes.
    """

    url: str
    context: ssl.SSLContext | None
    headers: Mapping[str, str]
    authentication: Callable[[], dict[str, object]] | None
    compression: str
    wait: float
    check: float
    grace: float
    silence: float
    budget: Budget


def client_options(name: str, options: Options) -> ClientOptions:
    """Read the options of a bridge, already checked against the schema.

    Raises:
        ConfigurationError: a file cannot be read, or a secret would go over an open line.
    """
    given: dict[str, Any] = dict(options)
    url, tls = given["url"], given.get("tls")
    is_secure = url.startswith("wss://")
    if tls is not None and not is_secure:
        raise ConfigurationError(f"bridge {name!r}: `tls` is for wss://, and the url is {url}")
    has_secret = "token_file" in given or "auth" in given
    is_here = is_loopback(_host(name, url))
    if has_secret and not (is_secure or is_here or given.get("plain_secrets")):
        text = f"bridge {name!r}: the secret would go to {url} in the clear: use wss://, or say "
        raise ConfigurationError(f"{text}`plain_secrets: true`")
    headers = {}
    if "token_file" in given:
        headers["Authorization"] = f"Bearer {_secret(name, given['token_file'])}"
    auth = given.get("auth")
    return ClientOptions(
        url,
        _context(name, tls) if is_secure else None,
        headers,
        None if auth is None else _Authentication(_secret(name, auth["secret_file"]), auth),
        given.get("compression", "cbor"),
        given.get("wait", 3.0),
        given.get("check", 2.0),
        given.get("grace", 5.0),
        given.get("silence", 10.0),
        Budget(
            octets=given.get("max_octets", 16_777_216), elements=given.get("max_values", 500_000)
        ),
    )


def _host(name: str, url: str) -> str:
    try:
        return urlsplit(url).hostname or ""
    except ValueError as error:
        raise ConfigurationError(f"bridge {name!r}: url {url}: {error}") from None


def _context(name: str, tls: Mapping[str, str] | None) -> ssl.SSLContext:
    given = tls or {}
    try:
        context = ssl.create_default_context(cafile=given.get("ca"))
        if "certificate" in given:
            # Asked for no passphrase on a terminal: a key that has one is refused.
            context.load_cert_chain(given["certificate"], given.get("key"), password=lambda: b"")
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"bridge {name!r}: tls: {error}") from error
    return context


def _secret(name: str, path: str) -> str:
    try:
        text = Path(path).read_text("utf-8").strip()
    except (OSError, UnicodeError) as error:
        raise ConfigurationError(f"bridge {name!r}: {path}: {error}") from error
    if not text or "\n" in text:
        raise ConfigurationError(f"bridge {name!r}: {path}: expected one line with a secret")
    return text


class _Authentication:
    """Makes the operation `auth` of rosauth, anew for each connection."""

    def __init__(self, secret: str, given: Mapping[str, str]) -> None:
        self._secret, self._given = secret, given

    def __call__(self) -> dict[str, object]:
        """Return it, good for a minute."""
        now, given = int(time.time()), self._given
        rand, end = os.urandom(16).hex(), now + 60
        client, dest, level = given["client"], given["dest"], given.get("level", "user")
        text = f"{self._secret}{client}{dest}{rand}{now}{level}{end}"
        mac = hashlib.sha512(text.encode()).hexdigest()
        return {
            "op": "auth", "mac": mac, "client": client, "dest": dest, "rand": rand, "t": now,
            "level": level, "end": end,
        }  # fmt: skip


def address_of(endpoint: Endpoint) -> Address:
    """Read an endpoint's address.

    Raises:
        BridgeError: with BAD_ENDPOINT and what is wrong.
    """
    with reading_endpoint(endpoint):
        address = _address(endpoint.address)
        if address.is_parameter and (endpoint.role is Role.SERVICE or endpoint.is_offered):
            raise ValueError("a parameter is an output that is read, or an input that is set")
    return address


def port_of(endpoint: Endpoint) -> Port:
    """Read an endpoint's options. What is offered needs no peer.

    Raises:
        BridgeError: with BAD_ENDPOINT and what is wrong.
    """
    port = Port.of_endpoint(endpoint)
    return evolve(port, peer="optional") if endpoint.is_offered else port


def is_type(name: str) -> bool:
    """Return whether a name is that of a type of ROS, as an address may have it."""
    return _TYPE.fullmatch(name) is not None


def mistake(address: tuple[str, ...], options: Options) -> str:
    """Return what is wrong with an address, or ""."""
    del options  # each is checked by itself
    try:
        _address(address)
    except ValueError as error:
        return str(error)
    return ""


def topic_name(address: tuple[str, ...], options: Options) -> str:
    """Return the topic that an address names, or "" for an action, a service or a parameter."""
    read = _address(address)
    is_action = read.is_action or read.is_actionlib
    is_else = read.is_parameter or "/srv/" in read.type or is_action or "at_once" in options
    return "" if is_else else f"/{read.name.lstrip('/')}"


def _address(parts: tuple[str, ...]) -> Address:
    if not 1 <= len(parts) <= 2:  # noqa: PLR2004 - the two parts of the sentence
        raise ValueError(f"expected [name] or [name, type], got {list(parts)}")
    address = Address(*parts)
    pattern = _PARAMETER_NAME if address.is_parameter else _NAME
    if not pattern.fullmatch(address.name):
        raise ValueError(f"{address.name!r} is not a name of ROS such as /camera/image_raw")
    if len(parts) > 1 and not address.is_parameter and not is_type(address.type):
        text = f"{address.type!r} is not a type of ROS such as sensor_msgs/msg/Image"
        raise ValueError(f"{text}, nor `{_PARAMETER}`")
    return address
