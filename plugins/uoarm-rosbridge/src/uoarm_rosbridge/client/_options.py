"""Addresses and options as the configuration writes them; no I/O but the files that are named."""

from __future__ import annotations

import hashlib
import os
import re
import ssl
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from attrs import frozen

from uoarm.bridge import (
    BridgeOptions,
    DeclaredOptions,
    PeerOptions,
    TlsOptions,
    address_check,
    host_of,
    option,
    reading_endpoint,
)
from uoarm.errors import ConfigurationError
from uoarm.model import Budget, Endpoint, Options, Role, is_loopback
from uoarm.plugins import UnreadableFileError, read_text

_TEXT: Mapping[str, object] = {"type": "string", "minLength": 1}
_FILE: Mapping[str, object] = {**_TEXT, "x-uoarm-path": True}
_SECONDS: Mapping[str, object] = {"type": "number", "minimum": 0, "maximum": 60}
_COUNT: Mapping[str, object] = {"type": "integer", "minimum": 1}
_PARAMETER = "parameter"
_COMPRESSIONS = ("cbor", "cbor-raw", "none")
_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*")
_PARAMETER_NAME = re.compile(r"[A-Za-z0-9_/~.:-]+")
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/(msg|srv|action))?/[A-Za-z][A-Za-z0-9_]*")


@frozen
class AuthenticationOptions(DeclaredOptions):
    """What the operation `auth` of rosauth says of a client."""

    secret_file: str = option("", _FILE, "whose line is shared with the server", required=True)
    client: str = option("", _TEXT, "that this is", required=True)
    dest: str = option("", _TEXT, "that the server is", required=True)
    level: str = option("user", _TEXT, "that is asked for")


@frozen
class ClientOptions(BridgeOptions):
    """The options of a bridge."""

    url: str = option(
        "",
        {"type": "string", "pattern": r"^wss?://[^@?#\s]+$", "examples": ["ws://robot:9090"]},
        "`ws://` or `wss://`",
        required=True,
    )
    tls: TlsOptions | None = option(
        None, TlsOptions, "`{ca, certificate, key}`, files in PEM; left out: as the system trusts"
    )
    token_file: str = option("", _FILE, "a file whose line is shown as a bearer token")
    auth: AuthenticationOptions | None = option(
        None,
        AuthenticationOptions,
        "`{secret_file, client, dest, level}`: `auth` of rosauth, first on each connection",
    )
    plain_secrets: bool = option(
        False,
        {"type": "boolean"},
        "whether a token or `auth` may go to another machine without TLS",
    )
    compression: str = option(
        "cbor",
        {"enum": [*_COMPRESSIONS]},
        "`cbor-raw`: as ROS serialised them, for pictures; `none`: as JSON",
    )
    wait: float = option(3.0, _SECONDS, "seconds to wait for an answer of rosapi", unit="s")
    check: float = option(
        2.0,
        {"type": "number", "minimum": 0.05, "maximum": 3600},
        "seconds between looks at who publishes and subscribes",
        unit="s",
    )
    grace: float = option(
        5.0,
        _SECONDS,
        "seconds of a break until everything behind it is lost",
        unit="s",
    )
    silence: float = option(
        10.0,
        {"type": "number", "minimum": 0.5, "maximum": 3600},
        "seconds without an answer to a ping until the server is lost",
        unit="s",
    )
    max_octets: int = option(16_777_216, _COUNT, "of one message that comes")
    max_values: int = option(500_000, _COUNT, "in one message that comes")

    @property
    def is_secure(self) -> bool:
        """Whether TLS is spoken."""
        return self.url.startswith("wss://")

    @property
    def budget(self) -> Budget:
        """What one message that comes may cost."""
        return Budget(octets=self.max_octets, elements=self.max_values)

    def check_together(self) -> None:
        """Refuse options of which one excludes another, and a secret on an open line."""
        host = host_of(self.url)
        if self.tls is not None and not self.is_secure:
            raise ValueError(f"`tls` is for wss://, and the url is {self.url}")
        is_open = not (self.is_secure or is_loopback(host) or self.plain_secrets)
        if is_open and (self.token_file or self.auth is not None):
            text = f"the secret would go to {self.url} in the clear: use wss://, or say "
            raise ValueError(f"{text}`plain_secrets: true`")


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
class Port(PeerOptions):
    """The options of one endpoint."""

    throttle: int = option(
        0,
        {"type": "integer", "minimum": 0, "maximum": 3_600_000},
        "of an output: milliseconds between two messages at least; the server leaves others out",
        unit="ms",
    )
    queue: int = option(
        100,
        {"type": "integer", "minimum": 1, "maximum": 100_000},
        "messages that may wait for a consumer; then the oldest are dropped and counted",
    )
    latch: bool = option(
        False,
        {"type": "boolean"},
        "of an input: the server keeps the last message. Of an output: new consumers get "
        "the last message first",
    )
    compression: str | None = option(
        None,
        {"enum": [*_COMPRESSIONS]},
        "of an output, and that of the first on its topic; left out: as the bridge says",
    )


@frozen
class ServerAccess:
    """What a server is shown, read from the files that options name.

    Attributes:
        context: of TLS; None: it is not spoken.
        authentication: returns the operation that a server with rosauth wants first.
    """

    context: ssl.SSLContext | None
    headers: Mapping[str, str]
    authentication: Callable[[], dict[str, object]] | None

    @classmethod
    def of(cls, name: str, options: ClientOptions) -> ServerAccess:
        """Read the files.

        Raises:
            ConfigurationError: one cannot be read.
        """
        headers = {}
        if options.token_file:
            headers["Authorization"] = f"Bearer {_secret(name, options.token_file)}"
        auth = options.auth
        return cls(
            (options.tls or TlsOptions()).context(name) if options.is_secure else None,
            headers,
            None
            if auth is None
            else partial(_authentication, _secret(name, auth.secret_file), auth),
        )


_SECRET_OCTETS = 65536


def _secret(name: str, path: str) -> str:
    try:
        text = read_text(Path(path), _SECRET_OCTETS).strip()
    except UnreadableFileError as error:
        raise ConfigurationError(f"bridge {name!r}: {path}: {error}") from error
    if not text or "\n" in text:
        raise ConfigurationError(f"bridge {name!r}: {path}: expected one line with a secret")
    return text


def _authentication(secret: str, given: AuthenticationOptions) -> dict[str, object]:
    """Return the operation `auth` of rosauth, good for a minute."""
    now = int(time.time())
    rand, end = os.urandom(16).hex(), now + 60
    client, dest, level = given.client, given.dest, given.level
    text = f"{secret}{client}{dest}{rand}{now}{level}{end}"
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


port_of = Port.of_endpoint


def is_type(name: str) -> bool:
    """Return whether a name is that of a type of ROS, as an address may have it."""
    return _TYPE.fullmatch(name) is not None


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


mistake = address_check(_address)
