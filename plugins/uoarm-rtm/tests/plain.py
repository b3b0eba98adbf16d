"""Messages as plain JSON; apart from the strategies, which take long to import."""

from __future__ import annotations

from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Return a message with lists for buffers and texts for NaN, so that == compares it."""
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, bytes | list | memoryview):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return repr(value)
    return value
