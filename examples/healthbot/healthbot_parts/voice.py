"""The spare voice: no sound at all, so that a visit goes on where no speech engine is left.

What is to be said stands on the screen in any case.
"""

from __future__ import annotations

from healthbot_parts.messages import Said, Speech

__all__ = ["silent"]


def silent(speech: Speech) -> Said:
    """Say nothing, and answer so: no sound, not played."""
    del speech
    return {"audio": b"", "duration": 0.0, "played": False}
