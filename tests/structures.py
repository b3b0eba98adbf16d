"""Structures that tests write often."""

from __future__ import annotations

from typing import Any


def closed(**members: object) -> dict[str, Any]:
    """Return the schema of objects with exactly these members."""
    return {
        "type": "object",
        "properties": members,
        "required": list(members),
        "additionalProperties": False,
    }


class Quits(dict[str, Any]):
    """What a component gives, and ends whatever thread looks into it."""

    def __init__(self, kind: type[BaseException]) -> None:
        self.kind = kind

    def __len__(self, *_: object) -> Any:
        raise self.kind

    __iter__ = __contains__ = __getitem__ = get = items = keys = __len__
