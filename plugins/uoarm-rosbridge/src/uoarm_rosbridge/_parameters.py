"""Parameters that clients set for one another; a component's own are in the configuration."""

from __future__ import annotations

from collections.abc import Hashable

import orjson

from uoarm.errors import MessageError, UsageError
from uoarm.server.front_end import LimitError, Shares
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
        self._owners: dict[str, Hashable] = {}
        self._named = Shares(_MOST)
        self._octets = Shares(_MOST_OCTETS)

    @property
    def names(self) -> list[str]:
        """All names, in the order in which they were set first."""
        return list(self._texts)

    def get(self, name: str) -> str | None:
        """Return a parameter's JSON text; None: there is none."""
        return self._texts.get(name)

    def set(self, name: str, text: str, owner: Hashable) -> None:
        """Set a parameter, which may be there already.

        Args:
            name: of the parameter.
            text: of its value.
            owner: as whose it counts: something that stays the same when a client comes again.

        Raises:
            UsageError: the name is that of a function, whose parameters are not the clients'.
            MessageError: the text is no JSON.
            LimitError: there are too many parameters, or they are too long, and the owner has its
                share of them.
        """
        if find_place(name).function:
            raise UsageError(f"{name!r:.200} belongs to the server: it is in the configuration")
        owner = self._owners.get(name, owner)
        before = self._texts.get(name)
        if before is None and not self._named.admits(owner):
            raise LimitError(f"there are {_MOST:,} parameters already")
        more = _size(name, text) - (0 if before is None else _size(name, before))
        if more > 0 and not self._octets.admits(owner, more):
            raise LimitError(f"all parameters together may have {_MOST_OCTETS:,} octets")
        try:
            orjson.loads(text)
        except orjson.JSONDecodeError as error:
            raise MessageError(f"set_param: value: expected a JSON text: {error}") from None
        self._texts[name], self._owners[name] = text, owner
        self._octets.take(owner, more)
        if before is None:
            self._named.take(owner)

    def delete(self, name: str) -> bool:
        """Delete a parameter; False: there was none."""
        text = self._texts.pop(name, None)
        if text is None:
            return False
        owner = self._owners.pop(name)
        self._octets.take(owner, -_size(name, text))
        self._named.take(owner, -1)
        return True


def _size(name: str, text: str) -> int:
    return len(name.encode()) + len(text.encode())
