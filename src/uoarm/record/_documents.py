"""What a file has beside messages: the plans, the configuration without secrets, the lock."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from attrs import evolve

from uoarm.model import Plan, Robot, StatusEvent, to_json, write_json

__all__ = ["documents", "event_message", "gap_message", "masked"]

_HIDDEN = "***"
_SECRET_NAME = re.compile(
    r"(?i)(?:passw(?:or)?d|passphrase|secret|token|credential|api_?key|private_?key)s?$"
)
_IN_URL = re.compile(r"(?<=://)[^\s/@]+(?=@)")
_MOST_LOCK = 16 << 20


def masked(value: Any) -> Any:
    """Return plain data in which secrets are hidden: by the name of a member, and in URLs."""
    if isinstance(value, Mapping):
        return {
            str(name): _HIDDEN
            if _SECRET_NAME.search(str(name)) and item not in (None, "")
            else masked(item)
            for name, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [masked(item) for item in value]
    return _IN_URL.sub(_HIDDEN, value) if isinstance(value, str) else value


def documents(robot: Robot, plans: Mapping[str, Plan]) -> Iterator[tuple[str, bytes]]:
    """Yield the attachments of a file: name and content, JSON all of them.

    Args:
        robot: the configuration in force.
        plans: by the function that is recorded.
    """
    yield "configuration.json", _written(to_json(evolve(robot, text="")))
    for function, plan in plans.items():
        yield f"plan-{function}.json", _written(to_json(plan))
    lock = Path(robot.origin).with_name("robot.lock") if robot.origin else None
    if lock is not None:
        try:
            content = lock.read_bytes()
        except OSError:
            return  # there is none
        if len(content) <= _MOST_LOCK:
            yield "robot.lock", content


def event_message(event: StatusEvent) -> dict[str, Any]:
    """Return what the channel of events has of a status event."""
    message: dict[str, Any] = masked(to_json(event))
    return message


def gap_message(function: str, connection: str, gap: Any) -> dict[str, Any]:
    """Return what the channel of events has of a gap between two plans."""
    return {
        "subject": f"connection {connection}",
        "change": "gap",
        "cause": gap.cause,
        "function": function,
        "gap": masked(to_json(gap)),
    }


def _written(value: Any) -> bytes:
    return write_json(masked(value), indent=1).encode()
