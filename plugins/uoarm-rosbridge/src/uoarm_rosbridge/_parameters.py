"""Parameters that clients set for one another; a component's own are in the configuration."""

from __future__ import annotations

import orjson

from uoarm.errors import MessageError, UsageError
from uoarm.server.front_end import LimitError
from uoarm_rosbridge._names import find_place

__all__ = ["Parameters"]

_MOST = 1_000
_MOST_OCTETS = 1 << 20


class Parameters:
    """JSON texts by name, kept until they are deleted or the server ends; in the loop's thread.

    Names have a leading slash, as topics have; a missing one is added.
    """

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._octets = 0

    @property
    def names(self) -> list[str]:
        """All names, in the order in which they were set first."""
        return list(self._texts)

    def get(self, name: str) -> str | None:
        """Return a parameter's JSON text; None: there is none."""
        return self._texts.get(name)

    def set(self, name: str, text: str) -> None:
        """Set a parameter, which may be there already.

        Raises:
            UsageError: the name is that of a function, whose parameters are not the clients'.
            MessageError: the text is no JSON.
            LimitError: there are too many parameters, or they are too long.
        """
        if find_place(name).function:
            raise UsageError(f"{name!r:.200} belongs to the server: it is in the configuration")
        before = self._texts.get(name)
        if before is None and len(self._texts) >= _MOST:
            raise LimitError(f"there are {_MOST:,} parameters already")
        octets = self._octets + _size(name, text) - (0 if before is None else _size(name, before))
        if octets > _MOST_OCTETS:
            raise LimitError(f"all parameters together may have {_MOST_OCTETS:,} octets")
        try:
            orjson.loads(text)
        except orjson.JSONDecodeError as error:
            raise MessageError(f"set_param: value: expected a JSON text: {error}") from None
        self._texts[name], self._octets = text, octets

    def delete(self, name: str) -> bool:
        """Delete a parameter; False: there was none."""
        text = self._texts.pop(name, None)
        if text is None:
            return False
        self._octets -= _size(name, text)
        return True


def _size(name: str, text: str) -> int:
    return len(name.encode()) + len(text.encode())
