"""What a queue between a fast producer and a slow consumer does when it is full."""

from __future__ import annotations

from enum import Enum

from attrs import field, frozen
from attrs.validators import ge, gt

__all__ = ["OverflowPolicy", "QueuePolicy", "ValidationMode"]


class OverflowPolicy(Enum):
    """What happens to a message that finds the queue full; every loss is counted."""

    LATEST = "latest"
    DROP_OLDEST = "drop-oldest"
    BLOCK = "block"


@frozen
class QueuePolicy:
    """Length and overflow policy of one queue.

    Attributes:
        length: messages held at most; `latest` always holds one.
        policy: `latest` keeps the newest only, `drop-oldest` makes room at the old end,
            `block` makes the producer wait.
        timeout: seconds that `block` waits before the new message is dropped and counted.
    """

    length: int = field(default=16, validator=ge(1))
    policy: OverflowPolicy = OverflowPolicy.DROP_OLDEST
    timeout: float = field(default=1.0, validator=gt(0.0))


class ValidationMode(Enum):
    """How many messages of a connection are checked against their declared structure."""

    OFF = "off"
    SAMPLED = "sampled"
    ALWAYS = "always"
