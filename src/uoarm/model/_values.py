"""The two open types that cross every layer: messages and their schemas."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

__all__ = ["Deliver", "Message", "Options", "Schema"]

Message: TypeAlias = Any
"""A value of the JSON data model, plus `bytes`-like octets and numeric buffers (numpy, array)."""

Schema: TypeAlias = Mapping[str, object] | bool
"""A JSON Schema of draft 2020-12; treated as immutable everywhere."""

Options: TypeAlias = Mapping[str, object]
"""Named settings from the configuration file, already plain JSON values."""

Deliver: TypeAlias = Callable[[Message], None]
"""Takes one message; never raises, never blocks longer than its declared policy."""
