"""Components that raise when they are to."""

from __future__ import annotations

from tests.manager.stage import Narrow

raises: set[str] = set()
wrong: set[str] = set()


class OddError(Exception):
    """An error of a component's own."""


def first(message: Narrow) -> Narrow:
    return _step("first", message)


def second(message: Narrow) -> Narrow:
    return _step("second", message)


def strict(message: Narrow) -> Narrow:
    """Raise on what does not match its hint, and on 13."""
    if message["value"] > 255 or message["value"] == 13:
        raise OddError(f"strict does not like {message['value']}")
    return message


def _step(name: str, message: Narrow) -> Narrow:
    if name in raises:
        raise OddError(f"{name} does not like {message['value']}")
    return {"value": "one"} if name in wrong else message  # type: ignore[typeddict-item]
