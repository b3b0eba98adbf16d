"""What a configuration may say of this bridge and of its endpoints."""

from __future__ import annotations

from attrs import frozen

from uoarm.bridge import BridgeOptions, EndpointOptions, option
from uoarm.model import Options

_SECONDS = {"type": "number", "exclusiveMinimum": 0}
_PORT = {"type": "integer", "minimum": 1, "maximum": 65535, "examples": [7400]}


@frozen
class BusOptions(BridgeOptions):
    """The options of the bridge: a further one is a further line."""

    host: str = option("127.0.0.1", {"type": "string", "minLength": 1}, "that the bus is on")
    port: int = option(0, _PORT, "of the bus", required=True)
    timeout: float = option(4.0, _SECONDS, "seconds that the bus has to reply", unit="s")


@frozen
class ExampleOptions(EndpointOptions):
    """The options of one endpoint."""

    stale_after: float | None = option(
        None, _SECONDS, "seconds without a message after which an output is lost", unit="s"
    )
    grace: float = option(
        10.0, _SECONDS, "seconds that a break may last before the channel is lost", unit="s"
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
