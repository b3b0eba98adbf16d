"""How large a message may be, in every direction in which one can be large."""

from __future__ import annotations

from attrs import frozen

__all__ = ["SERIAL_LIMITS", "TCP_LIMITS", "Limits"]


@frozen
class Limits:
    """Bounds of one message, as section 7 of the profile has them.

    Attributes:
        octets: most octets of a message before framing.
        depth: most elements inside each other.
        elements: most elements in a message.
        attribute_octets: most octets of one attribute.
        attributes: most attributes of one element.
    """

    octets: int = 1_048_576
    depth: int = 32
    elements: int = 100_000
    attribute_octets: int = 1024
    attributes: int = 16


TCP_LIMITS = Limits()
SERIAL_LIMITS = Limits(octets=65_536)
