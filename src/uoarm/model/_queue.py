"""What a queue between a fast producer and a slow consumer does when it is full."""

from __future__ import annotations

from enum import Enum

from attrs import field, frozen
from attrs.validators import ge, gt

from uoarm._arguments import built_with_arguments
from uoarm._mistakes import choose
from uoarm.errors import ConfigurationError

__all__ = ["OverflowPolicy", "QueuePolicy", "ValidationMode"]


class OverflowPolicy(Enum):
    """What happens to a message that finds the queue full; every loss is counted."""

    LATEST = "latest"
    DROP_OLDEST = "drop-oldest"
    BLOCK = "block"


def _policy(name: OverflowPolicy | str) -> OverflowPolicy:
    return choose(OverflowPolicy, name, "policy", ConfigurationError)


@built_with_arguments
@frozen
class QueuePolicy:
    """Length and overflow policy of one queue.

    Attributes:
        length: messages held at most; `latest` always holds one.
        policy: `latest` keeps the newest only, `drop-oldest` makes room at the old end,
            `block` makes the producer wait. Its name does, too; an unknown one is a
            ConfigurationError.
        timeout: seconds that `block` waits before the new message is dropped and counted.
        octets: memory that the messages may hold, as decoded values; with more the queue counts as
            full. One message of any size passes when it is alone.
    """

    length: int = field(default=16, validator=ge(1))
    policy: OverflowPolicy = field(default=OverflowPolicy.DROP_OLDEST, converter=_policy)
    timeout: float = field(default=1.0, validator=gt(0.0))
    octets: int = field(default=67_108_864, validator=ge(1))


class ValidationMode(Enum):
    """How many messages of a connection are checked against their declared structure."""

    OFF = "off"
    SAMPLED = "sampled"
    ALWAYS = "always"

    __hash__ = object.__hash__  # members are singletons; by name it costs ten times as much
