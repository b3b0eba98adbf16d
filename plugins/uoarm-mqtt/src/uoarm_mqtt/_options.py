"""What a configuration may say of a bridge and of a port, checked before anything runs."""

from __future__ import annotations

import os
import re
import ssl
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from attrs import field, frozen

from uoarm.bridge import (
    BridgeOptions,
    DeclaredOptions,
    EndpointOptions,
    TlsOptions,
    host_of,
    option,
    renewed,
)
from uoarm.errors import ConfigurationError
from uoarm.model import Budget, Options, is_loopback
from uoarm.plugins import UnreadableFileError, read_text

_TEXT: Mapping[str, Any] = {"type": "string", "minLength": 1}
_TOPIC: Mapping[str, Any] = {"type": "string", "pattern": r"^[^+#\0]+$", "examples": ["lab/lamp"]}
_FILTER: Mapping[str, Any] = {
    "type": "string",
    "minLength": 1,
    "pattern": r"^(\+|[^+#/\0]*)(/(\+|[^+#/\0]*))*(/#)?$|^#$",
    "examples": ["lab/+/temperature", "lab/#"],
}
_PATH: Mapping[str, Any] = {"type": "string", "minLength": 1, "x-uoarm-path": True}
_SECONDS: Mapping[str, Any] = {"type": "number", "exclusiveMinimum": 0, "maximum": 86400}
_COUNT: Mapping[str, Any] = {"type": "integer", "minimum": 1}
_STRUCTURE: Mapping[str, Any] = {"type": ["object", "boolean"], "x-uoarm-structure": True}
_SERVICE: Mapping[str, Any] = {
    "type": "object",
    "properties": {"request": _STRUCTURE, "reply": _STRUCTURE},
    "additionalProperties": False,
}


_LONGEST_TOPIC = 65535
_SECRET_OCTETS = 65536
# Of a text in a packet, such as a topic: control characters, halves of pairs and non-characters.
_UNSENDABLE = re.compile(
    "[\x00-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef"
    + "".join(chr(plane << 16 | last) for plane in range(17) for last in (0xFFFE, 0xFFFF))
    + "]"
)


@frozen
class BrokerOptions(BridgeOptions):
    """The options of a connection to a broker; a plugin on top of MQTT adds its own."""

    url: str = option(
        "",
        {
            "type": "string",
            "pattern": r"^mqtts?://[^/@?#\s]+$",
            "examples": ["mqtt://127.0.0.1:1883"],
        },
        "`mqtt://host:1883`, or `mqtts://host:8883` with TLS",
        required=True,
    )
    tls: TlsOptions | None = option(
        None, TlsOptions, "`{ca, certificate, key}`, files in PEM; left out: as the system trusts"
    )
    user: str = option("", _TEXT, "that the broker knows")
    password_env: str = option(
        "",
        _TEXT,
        "an environment variable that holds the password",
    )
    password_file: str = option(
        "", _PATH, "a file that holds the password, which is never an option itself"
    )
    plain_password: bool = option(
        False,
        {"type": "boolean"},
        "whether a password may cross a network without TLS",
    )
    client_id: str = option(
        "",
        _TEXT,
        "left out: a new one; two clients with the same one end each other's connection",
    )
    keepalive: int = option(
        15,
        {"type": "integer", "minimum": 1, "maximum": 65535},
        "seconds of silence until the broker is asked; it is given up after twice as many",
        unit="s",
    )
    grace: float = option(
        30.0,
        _SECONDS,
        "seconds of a break until it is a loss; the broker is asked to keep QoS 1 and 2 as long",
        unit="s",
    )
    backlog: int = option(
        1000, _COUNT, "messages of a channel that may wait, each way; 8 times `max_octets` in all"
    )
    max_octets: int = option(1_048_576, _COUNT, "of one payload")
    max_values: int = option(100_000, _COUNT, "in one payload")
    max_depth: int = option(64, {"type": "integer", "minimum": 1, "maximum": 200}, "of one payload")

    @property
    def budget(self) -> Budget:
        """What one payload may cost."""
        return Budget(octets=self.max_octets, elements=self.max_values, depth=self.max_depth)

    @property
    def place(self) -> tuple[str, int, bool]:
        """Host and port of the broker, and whether TLS is spoken; raises ValueError."""
        url = urlsplit(self.url)
        is_secure = url.scheme == "mqtts"
        try:
            host, port = url.hostname or "", url.port or (8883 if is_secure else 1883)
            host.encode("idna")
        except ValueError as error:
            raise ValueError(f"url {self.url!r}: {error}") from None
        return host, port, is_secure

    def check_together(self) -> None:
        """Refuse options of which one asks for, or excludes, another."""
        host_of(self.url)
        host, _, is_secure = self.place
        if self.tls is not None and not is_secure:
            raise ValueError("`tls` goes with a url that begins with mqtts://")
        has_password = bool(self.password_env or self.password_file)
        if self.password_env and self.password_file:
            raise ValueError("`password_env` or `password_file`, not both")
        if has_password and not self.user:
            raise ValueError("a password goes with a `user`")
        if has_password and not (is_secure or is_loopback(host) or self.plain_password):
            text = "the password would cross the network unencrypted: mqtts://, or `plain_password`"
            raise ValueError(f"{text}: true where the network is your own")


@frozen
class AnnouncementOptions(DeclaredOptions):
    """Where a bridge says that it is there."""

    topic: str = option("", _TOPIC, "that it says it on, retained", required=True)
    online: str = option("online", _TEXT, "what it says while it is there")
    offline: str = option("offline", _TEXT, "what its last will says")


@frozen
class DiscoveryOptions(DeclaredOptions):
    """Where components are looked for."""

    topics: tuple[str, ...] = option(
        ("#",), {"type": "array", "items": _FILTER}, "filters of the topics that are looked at"
    )
    seconds: float = option(1.0, _SECONDS, "that is waited for messages", unit="s")
    most: int = option(200, _COUNT, "topics that are listed")


@frozen
class MqttOptions(BrokerOptions):
    """The options of a bridge."""

    presence: AnnouncementOptions | None = option(
        None,
        AnnouncementOptions,
        "`{topic, online, offline}`: where this bridge announces itself, retained and by "
        "its last will",
    )
    structures: Mapping[str, Any] = option(
        {},
        {"type": "object", "propertyNames": _FILTER, "additionalProperties": _STRUCTURE},
        "JSON Schemas by topic or filter",
    )
    services: Mapping[str, Any] = option(
        {},
        {"type": "object", "propertyNames": _TOPIC, "additionalProperties": _SERVICE},
        "`{request, reply}` by topic",
    )
    schemas: str = option(
        "",
        {
            "type": "string",
            "pattern": r"^[^+#{}]*\{topic\}[^+#{}]*$",
            "examples": ["schemas/{topic}"],
        },
        "where structures are retained, such as `schemas/{topic}`",
    )
    retained_wait: float = option(
        0.2,
        {"type": "number", "minimum": 0, "maximum": 4},
        "seconds that a retained message may come after the broker's answer",
        unit="s",
    )
    replies: str = option(
        "uoarm/replies",
        _TOPIC,
        "topic of replies, with the client's name as one more level",
    )
    discover: DiscoveryOptions = option(
        DiscoveryOptions(), DiscoveryOptions, "`{topics, seconds, most}`, see below"
    )


@frozen
class PresenceOptions(DeclaredOptions):
    """Where a component says whether it is there: a retained topic, written by its last will."""

    topic: str = option("", _TOPIC, "that it says it on", required=True)
    member: str = option("", _TEXT, "of the JSON object on it; left out: the payload as a text")
    online: str = option("online", _TEXT, "what stands there while it is there")
    finished: str = option("", _TEXT, "what stands there after an orderly end; left out: none is")


@frozen
class TopicOptions(EndpointOptions):
    """The options of one endpoint."""

    content: str = option(
        "json",
        {"enum": ["json", "octets", "text"]},
        "what payloads are: `json`, `octets`, or `text` in UTF-8",
    )
    qos: int = option(1, {"enum": [0, 1, 2]}, "of subscribing or of publishing")
    retain: bool = option(
        False,
        {"type": "boolean"},
        "an input: the broker keeps what is sent. An output: new consumers first get each "
        "topic's last message; without it, what is retained is ignored",
    )
    share: str = option(
        "",
        {"type": "string", "pattern": "^[^/+#]+$", "examples": ["robots"]},
        "group of a shared subscription, where each message goes to one member; not with `retain`",
    )
    with_topic: bool = option(
        False,
        {"type": "boolean"},
        "messages of an output are `{topic, message}`",
    )
    expiry: int = option(
        0,
        {"type": "integer", "minimum": 0, "maximum": 2**32 - 1},
        "seconds until the broker drops what no client has taken; 0: never",
        unit="s",
    )
    presence: PresenceOptions | None = option(
        None,
        PresenceOptions,
        "`{topic, member, online, finished}`: where the component announces itself, see below",
    )


def mistake(address: tuple[str, ...], options: Options) -> str:
    """Say what is wrong with an address, and of options with one another; "" where nothing is."""
    if options.get("retain") and options.get("share"):
        return "a shared subscription is given no retained messages: `retain` or `share`"
    if len(address) != 1:
        return f"expected one topic, got {list(address)}"
    return wrong_filter(address[0])


def sendable(text: str) -> str:
    """Return a text without what brokers end the connection for."""
    return _UNSENDABLE.sub(" ", text)


def wrong_filter(topic: str) -> str:
    """Say what is wrong with a topic or topic filter, "" where nothing is."""
    if not 0 < len(topic.encode(errors="replace")) <= _LONGEST_TOPIC or _UNSENDABLE.search(topic):
        what = f"a topic of 1 to {_LONGEST_TOPIC} octets without control characters"
        return f"expected {what}, got {topic[:80]!r}"
    if topic.startswith("$share/"):
        return f"{topic!r}: write the topic alone, and the group as the option `share`"
    *inner, last = topic.split("/")
    if any("#" in level for level in inner) or ("#" in last and last != "#"):
        return f"{topic!r}: # stands for all further levels, so it must be the last one"
    if any("+" in level and level != "+" for level in (*inner, last)):
        return f"{topic!r}: + stands for one whole level"
    return ""


@frozen
class PresenceAnnouncement:
    """What a client says of itself on a topic, retained.

    Attributes:
        topic: that it says it on.
        will: what the broker says for it when it ends without a word.
        online: returns what it says each time that it has connected.
        offline: returns what it says before it ends in order.
    """

    topic: str
    will: str
    online: Callable[[], str]
    offline: Callable[[], str]


@frozen
class BrokerCredentials:
    """What the broker is shown, and what of it is trusted, as files say now.

    Attributes:
        user: that the broker knows, "" for none.
        context: for TLS; None without it.
    """

    user: str
    password: str | None = field(repr=False)
    context: ssl.SSLContext | None


@frozen
class ConnectionOptions:
    """How to connect to a broker, read from options. The password is in no text of it.

    Attributes:
        client_id: two clients with the same one end each other's connection.
        credentials: reads what the broker is shown, for each attempt to connect.
        keepalive: seconds after which a broker that says nothing is asked whether it lives.
        grace: seconds that a break may last before it is a loss.
        announcement: what the client says of itself; None: nothing.
        budget: what one payload may cost.
        backlog: messages of one channel that may wait.
    """

    host: str
    port: int
    client_id: str
    credentials: Callable[[], BrokerCredentials]
    keepalive: int
    grace: float
    announcement: PresenceAnnouncement | None
    budget: Budget
    backlog: int

    @property
    def backlog_octets(self) -> int:
        """Octets of the messages of one channel that may wait."""
        return 8 * self.budget.octets

    @property
    def client_level(self) -> str:
        """The client's name as a level of a topic, where a name may have what a level may not."""
        return self.client_id.replace("+", "-").replace("#", "-")


def connection_options(
    name: str, options: BrokerOptions, announcement: PresenceAnnouncement | None = None
) -> ConnectionOptions:
    """Read what options name: files, and variables of the environment.

    Raises:
        ConfigurationError: one cannot be read.
    """
    host, port, is_secure = options.place

    def credentials() -> BrokerCredentials:
        tls = (options.tls or TlsOptions()).context(name) if is_secure else None
        return BrokerCredentials(options.user, _password(name, options), tls)

    return ConnectionOptions(
        host=host,
        port=port,
        client_id=options.client_id or f"uoarm-{name}-{os.urandom(4).hex()}",
        credentials=renewed(credentials),
        keepalive=options.keepalive,
        grace=options.grace,
        announcement=announcement,
        budget=options.budget,
        backlog=options.backlog,
    )


def announcement(options: AnnouncementOptions | None) -> PresenceAnnouncement | None:
    """Return what a bridge says of itself."""
    if options is None:
        return None
    online, offline = options.online, options.offline
    return PresenceAnnouncement(options.topic, offline, lambda: online, lambda: offline)


def _password(name: str, options: BrokerOptions) -> str | None:
    if variable := options.password_env:
        if variable not in os.environ:
            raise _wrong(name, f"the environment has no variable {variable!r} (password_env)")
        return os.environ[variable]
    if file := options.password_file:
        try:
            return read_text(Path(file), _SECRET_OCTETS).rstrip("\r\n")
        except UnreadableFileError as error:
            raise _wrong(name, f"password_file {file!r}: {error}") from None
    return None


def _wrong(name: str, what: str) -> ConfigurationError:
    return ConfigurationError(f"bridge {name!r}: {what}")
