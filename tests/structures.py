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
