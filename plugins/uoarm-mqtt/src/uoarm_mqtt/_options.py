"""What a configuration may say of a bridge and of a port, checked before anything runs."""

from __future__ import annotations

import os
import ssl
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from attrs import frozen

from uoarm.bridge import EndpointOptions, option
from uoarm.errors import ConfigurationError
from uoarm.model import Budget, Options, Schema, is_loopback

__all__ = [
    "BRIDGE_OPTIONS",
    "CONNECTION_OPTIONS",
    "ConnectionOptions",
    "PresenceAnnouncement",
    "PresenceOptions",
    "TopicOptions",
    "connection_options",
    "mistake",
]

_TEXT: Mapping[str, Any] = {"type": "string", "minLength": 1}
_PATH: Schema = {"type": "string", "minLength": 1, "x-uoarm-path": True}
_SECONDS: Schema = {"type": "number", "exclusiveMinimum": 0, "maximum": 86400}
_COUNT: Schema = {"type": "integer", "minimum": 1}
_STRUCTURE: Schema = {"type": ["object", "boolean"]}


def _closed(properties: Mapping[str, Any], *required: str) -> Schema:
    return {
        "type": "object",
        "properties": dict(properties),
        "required": list(required),
        "additionalProperties": False,
    }


CONNECTION_OPTIONS: Mapping[str, Any] = {
    "url": {
        "type": "string",
        "pattern": r"^mqtts?://[^/@?#\s]+$",
        "examples": ["mqtt://127.0.0.1:1883"],
    },
    "client_id": _TEXT,
    "user": _TEXT,
    "password_env": _TEXT,
    "password_file": _PATH,
    "plain_password": {"const": True},
    "tls": _closed({"ca": _PATH, "certificate": _PATH, "key": _PATH}),
    "keepalive": {"type": "integer", "minimum": 1, "maximum": 65535},
    "grace": _SECONDS,
    "backlog": _COUNT,
    "max_octets": _COUNT,
    "max_values": _COUNT,
    "max_depth": {"type": "integer", "minimum": 1, "maximum": 200},
}
"""JSON Schemas of the options that `connection_options` reads, by name; `url` must be given."""

BRIDGE_OPTIONS: Schema = _closed(
    {
        **CONNECTION_OPTIONS,
        "presence": _closed({"topic": _TEXT, "online": _TEXT, "offline": _TEXT}, "topic"),
        "structures": {"type": "object", "additionalProperties": _STRUCTURE},
        "services": {
            "type": "object",
            "additionalProperties": _closed({"request": _STRUCTURE, "reply": _STRUCTURE}),
        },
        "schemas": {"type": "string", "pattern": r"^[^+#{}]*\{topic\}[^+#{}]*$"},
        "retained_wait": {"type": "number", "minimum": 0, "maximum": 4},
        "replies": _TEXT,
        "discover": _closed(
            {"topics": {"type": "array", "items": _TEXT}, "seconds": _SECONDS, "most": _COUNT}
        ),
    },
    "url",
)

_LONGEST_TOPIC = 65535


@frozen
class PresenceOptions(EndpointOptions):
    """Where a component says whether it is there: a retained topic, written by its last will."""

    topic: str = option("", _TEXT, "that it says it on", required=True)
    member: str = option("", _TEXT, "of the JSON object on it; left out: the payload as a text")
    online: str = option("online", _TEXT, "what stands there while it is there")
    finished: str = option("", _TEXT, "what stands there after an orderly end; left out: none is")


@frozen
class TopicOptions(EndpointOptions):
    """The options of one endpoint."""

    content: str = option(
        "json", {"enum": ["json", "octets", "text"]}, "what payloads are; a text is UTF-8"
    )
    qos: int = option(1, {"enum": [0, 1, 2]}, "of subscribing or of publishing")
    retain: bool = option(
        False,
        {"type": "boolean"},
        "an input: what is sent stands on the broker. An output: the last message of each topic "
        "stands, so that each new consumer gets it first, until an empty payload clears it; "
        "without it, what is retained is left where it is",
    )
    share: str = option(
        "",
        {"type": "string", "pattern": "^[^/+#]+$"},
        "group of a shared subscription, in which each message goes to one member; outputs and "
        "served functions, without `retain`",
    )
    with_topic: bool = option(
        False,
        {"type": "boolean"},
        "messages of an output are `{topic, message}`",
    )
    expiry: int = option(
        0,
        {"type": "integer", "minimum": 1, "maximum": 2**32 - 1},
        "seconds after which the broker drops what is sent, when no client has taken it; 0: never",
        unit="s",
    )
    presence: PresenceOptions | None = option(  # noqa: RUF009 - a field, of an immutable value
        None,
        PresenceOptions,
        "`{topic, member, online, finished}`: where the component says that it is there, see below",
    )


def mistake(address: tuple[str, ...], options: Options) -> str:
    """Say what is wrong with an address, and of options with one another; "" where nothing is."""
    if options.get("retain") and options.get("share"):
        return "a shared subscription is given no retained messages: `retain` or `share`"
    if len(address) != 1:
        return f"expected one topic, got {list(address)}"
    return wrong_filter(address[0])


def wrong_filter(topic: str) -> str:
    """Say what is wrong with a topic or topic filter, "" where nothing is."""
    if not topic or "\0" in topic or len(topic.encode(errors="replace")) > _LONGEST_TOPIC:
        return f"expected a topic of 1 to {_LONGEST_TOPIC} octets without NUL, got {topic[:80]!r}"
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
class ConnectionOptions:
    """How to connect to a broker, read from options. The password is in no text of it.

    Attributes:
        host: of the broker.
        port: of the broker.
        client_id: two clients with the same one end each other's connection.
        login: of paho: user and password, or None; behind a closure, so that no repr shows it.
        context: for TLS; None without it.
        keepalive: seconds after which a broker that says nothing is asked whether it lives.
        grace: seconds that a break may last before it is a loss.
        announcement: what the client says of itself; None for nothing.
        budget: what one payload may cost.
        backlog: messages of one channel that may wait.
    """

    host: str
    port: int
    client_id: str
    login: Any
    context: ssl.SSLContext | None
    keepalive: int
    grace: float
    announcement: PresenceAnnouncement | None
    budget: Budget
    backlog: int


def connection_options(name: str, options: Options) -> ConnectionOptions:
    """Read the options of a bridge, already checked against the schema.

    Raises:
        ConfigurationError: a file or variable that they name cannot be read, or they contradict
            one another.
    """
    given: dict[str, Any] = dict(options)
    url = urlsplit(given["url"])
    encrypted = url.scheme == "mqtts"
    try:
        host, port = url.hostname or "", url.port or (8883 if encrypted else 1883)
        host.encode("idna")
    except ValueError as error:
        raise _wrong(name, f"url {given['url']!r}: {error}") from None
    if "tls" in given and not encrypted:
        raise _wrong(name, "`tls` goes with a url that begins with mqtts://")
    password = _password(name, given)
    if password and not (encrypted or is_loopback(host) or given.get("plain_password")):
        text = "the password would cross the network unencrypted: mqtts://, or `plain_password`"
        raise _wrong(name, f"{text}: true where the network is your own")
    return ConnectionOptions(
        host=host,
        port=port,
        client_id=given.get("client_id", f"uoarm-{name}-{os.urandom(4).hex()}"),
        login=(lambda: (given["user"], password)) if "user" in given else None,
        context=_context(name, given.get("tls", {})) if encrypted else None,
        keepalive=given.get("keepalive", 15),
        grace=given.get("grace", 30.0),
        announcement=_announcement(given["presence"]) if "presence" in given else None,
        budget=Budget(
            octets=given.get("max_octets", 1_048_576),
            elements=given.get("max_values", 100_000),
            depth=given.get("max_depth", 64),
        ),
        backlog=given.get("backlog", 1000),
    )


def _announcement(says: Mapping[str, str]) -> PresenceAnnouncement:
    online, offline = says.get("online", "online"), says.get("offline", "offline")
    return PresenceAnnouncement(says["topic"], offline, lambda: online, lambda: offline)


def _password(name: str, given: Mapping[str, Any]) -> str | None:
    if "password_env" in given and "password_file" in given:
        raise _wrong(name, "`password_env` or `password_file`, not both")
    if "user" not in given and ({"password_env", "password_file"} & given.keys()):
        raise _wrong(name, "a password goes with a `user`")
    if (variable := given.get("password_env")) is not None:
        if variable not in os.environ:
            raise _wrong(name, f"the environment has no variable {variable!r} (password_env)")
        return os.environ[variable]
    if (file := given.get("password_file")) is not None:
        try:
            return Path(file).read_text(encoding="utf-8").rstrip("\r\n")
        except (OSError, ValueError) as error:
            raise _wrong(name, f"password_file {file!r}: {error}") from None
    return None


def _context(name: str, tls: Mapping[str, str]) -> ssl.SSLContext:
    if "key" in tls and "certificate" not in tls:
        raise _wrong(name, "tls: a `key` goes with a `certificate`")
    try:
        context = ssl.create_default_context(cafile=tls.get("ca"))
        if "certificate" in tls:
            # Asked for no passphrase on a terminal: a key that has one is refused.
            context.load_cert_chain(tls["certificate"], tls.get("key"), password=lambda: b"")
    except (OSError, ValueError) as error:
        raise _wrong(name, f"tls: {dict(tls)}: {error}") from None
    return context


def _wrong(name: str, what: str) -> ConfigurationError:
    return ConfigurationError(f"bridge {name!r}: {what}")
