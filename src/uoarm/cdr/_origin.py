"""From which octets a message was read, for what would serialise it again in the same thread.

A bridge notes it around the delivery of a message; a recorder that takes that very message, as the
same object, writes its octets. What was adapted, or came through a queue or another process, is
another object: then nothing is known, and the message is serialised.
"""

from __future__ import annotations

import threading

from uoarm.model import Message

__all__ = ["forget_octets", "note_octets", "octets_of"]

_LITTLE_ENDIAN = b"\0\1"  # plain CDR, as everything here is written


class _Noted(threading.local):
    message: Message = None
    octets: bytes = b""
    definition: str = ""


_noted = _Noted()


def note_octets(message: Message, octets: bytes, definition: str) -> None:
    """Note of which octets, header first, a message was read that is about to be delivered.

    Args:
        message: that was read.
        octets: as ROS 2 serialises it.
        definition: the text of its type, as `definition_of` gives it.
    """
    _noted.message, _noted.octets, _noted.definition = message, octets, definition


def forget_octets() -> None:
    """Note that it was delivered."""
    _noted.message, _noted.octets = None, b""


def octets_of(message: Message, definition: str) -> bytes | None:
    """Return the octets of which a message of a type was read; None: they are not known here."""
    noted = _noted
    if (
        noted.message is message
        and message is not None
        and noted.definition == definition
        and noted.octets.startswith(_LITTLE_ENDIAN)
    ):
        return noted.octets
    return None
