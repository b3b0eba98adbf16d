"""Limits after which a client and a server take each other for gone, on a machine that may be slow.

Those are for networks. In tests both ends are here, and one that is late is only starved; a test
about being late states its limit.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from typing import Any

__all__ = ["lengthen"]

_LIMITS: dict[str, dict[str, tuple[str, ...]]] = {
    "uoarm.client": {"connect": ("timeout",)},
    "uoarm.server": {"Limits": ("stall_seconds",)},
    "websockets.asyncio.client": {"connect": ("open_timeout", "ping_timeout")},
    "websockets.sync.client": {"connect": ("open_timeout", "ping_timeout")},
}


def lengthen(seconds: float) -> None:
    """Have the limits that nobody states last so long, of what tests have imported."""
    for module, calls in _LIMITS.items():
        if (found := sys.modules.get(module)) is None:
            continue
        for name, limits in calls.items():
            called = inspect.unwrap(getattr(found, name))
            for limit in limits:
                _set_default(called.__init__ if inspect.isclass(called) else called, limit, seconds)


def _set_default(function: Callable[..., Any], name: str, value: float) -> None:
    """Change the default of one parameter."""
    parameters = inspect.signature(function).parameters.values()
    by_name = function.__kwdefaults__ or {}
    if name in by_name:
        by_name[name] = value
        return
    by_place = [one.name for one in parameters if one.default is not one.empty]
    defaults = dict(zip(by_place, function.__defaults__ or (), strict=False))
    assert name in defaults, f"{function.__qualname__} has no {name} by default"
    function.__defaults__ = (*(defaults | {name: value}).values(),)
