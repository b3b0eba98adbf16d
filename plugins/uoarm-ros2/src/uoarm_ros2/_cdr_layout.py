"""Where the fields of a message lie in its serialised form, as far as that is known beforehand.

ROS 2 sends XCDR version 1: four octets that say in which byte order, then the fields one after
another, each number at a multiple of its own size, counted from behind those four.
"""

from __future__ import annotations

from uoarm_ros2._shape import NUMBER_CODES, Scalar

__all__ = ["CODES", "HEADER", "Cursor", "size_of"]

HEADER = 4
CODES = {"bool": "?", "byte": "B", **NUMBER_CODES}
_SIZES = {"?": 1, "b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4, "d": 8}
_GREATEST = 8


def size_of(scalar: Scalar) -> int:
    """Return how many octets a number has."""
    return _SIZES[CODES[scalar.name]]


class Cursor:
    """What is known of the place of the next field: it is `rest` more than a multiple of `modulus`.

    Behind the four octets everything is known, behind a text nothing.
    """

    def __init__(self, modulus: int = 1) -> None:
        self.modulus = modulus
        self.rest = 0

    def forget(self) -> None:
        """Something of unknown length lies behind."""
        self.modulus, self.rest = 1, 0

    def align(self, size: int) -> int | None:
        """Go to a multiple of `size`; return how many octets that takes, None: it depends."""
        if self.modulus % size:
            self.modulus, self.rest = size, 0
            return None
        padding = -self.rest % size
        self.advance(padding)
        return padding

    def advance(self, octets: int) -> None:
        """Go past so many octets."""
        self.rest = (self.rest + octets) % self.modulus

    @staticmethod
    def aligned(place: str, size: int) -> str:
        """Return the expression for the next multiple of `size`, of an offset in the whole."""
        if size == _GREATEST:  # the four octets before are half of it
            return f"({place} + 3 & -8) + 4"
        return f"{place} + {size - 1} & -{size}"
