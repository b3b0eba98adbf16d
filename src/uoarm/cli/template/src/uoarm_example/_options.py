"""What a configuration may say of this bridge and of its endpoints."""

from __future__ import annotations

from typing import Any

from attrs import frozen

from uoarm.bridge import EndpointOptions, option
from uoarm.model import Options

__all__ = ["BRIDGE_OPTIONS", "ExampleOptions", "mistake"]

_SECONDS = {"type": "number", "exclusiveMinimum": 0}
BRIDGE_OPTIONS: dict[str, Any] = {
    "type": "object",
    "properties": {
        "host": {"type": "string", "minLength": 1, "default": "127.0.0.1"},
        "port": {"type": "integer", "minimum": 1, "maximum": 65535, "examples": [7400]},
        "timeout": {**_SECONDS, "default": 4.0, "description": "seconds that the bus has to reply"},
    },
    "required": ["port"],
    "additionalProperties": False,
}
"""JSON Schema of the bridge's own options."""


@frozen
class ExampleOptions(EndpointOptions):
    """The options of one endpoint: a further one is a further line."""

    stale_after: float | None = option(
        None, _SECONDS, "without a message, after which an output is lost", unit="s"
    )
    grace: float = option(
        10.0, _SECONDS, "that the connection may be broken before the channel is lost", unit="s"
    )
    backlog: int = option(
        1000, {"type": "integer", "minimum": 1}, "messages that may wait to be taken"
    )


def mistake(address: tuple[str, ...], options: Options) -> str:
    """Return what is wrong with an address and its options, or ""."""
    del options
    if len(address) != 1 or not address[0]:
        return f"expected the name of one topic or service, got {list(address)}"
    return ""
