"""The limits of calls that are given none, on a machine that may be slow."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager

from uoarm import AsyncRobotManager, RobotManager
from uoarm.bridge import Bridge, Channel

__all__ = ["default_limits"]


@contextmanager
def default_limits(seconds: float, *, closing: bool = True) -> Iterator[None]:
    """Have calls of bridges, channels and managers that are given no `timeout` last so long.

    What an application waits for a framework is nothing that a test is about, unless it says so.

    Args:
        seconds: the limit.
        closing: whether it holds for closing, too. What hangs as it is closed is given up after its
            limit, and nothing fails: a long one keeps whoever closes it.
    """
    methods = (
        inspect.unwrap(method).__kwdefaults__ or {}
        for owner in (Bridge, Channel, RobotManager, AsyncRobotManager)
        for name, method in inspect.getmembers(owner, inspect.isfunction)
        if closing or name != "close"
    )
    found = [(item, item["timeout"]) for item in methods if isinstance(item.get("timeout"), float)]
    for defaults, _ in found:
        defaults["timeout"] = seconds
    try:
        yield
    finally:
        for defaults, before in found:
            defaults["timeout"] = before
