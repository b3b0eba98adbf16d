"""The basic types of ROS, and which of them a schema of a scalar stands for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["BASIC", "FLOAT32_MAX", "basic_type"]

BASIC = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
    "string": "", "wstring": "",
}  # fmt: skip
"""Every basic type and its format in `struct`; empty for texts."""

_WHOLE = frozenset("bBhHiIqQ")
_INTEGERS = (
    ("uint8", 0, 2**8 - 1), ("int8", -(2**7), 2**7 - 1), ("uint16", 0, 2**16 - 1),
    ("int16", -(2**15), 2**15 - 1), ("uint32", 0, 2**32 - 1), ("int32", -(2**31), 2**31 - 1),
    ("uint64", 0, 2**64 - 1),
)  # fmt: skip
FLOAT32_MAX = 340282346638528859811704183484516925440
"""The greatest finite number of 32 bits."""

_KINDS = {"boolean": ("bool",), "string": ("string", "wstring"), "number": ("float64", "float32")}


def basic_type(schema: Mapping[str, Any]) -> str:
    """Return the basic type of a scalar, "" for anything else.

    A framework's own name counts where ROS has it, too; then the bounds; then the widest type.
    """
    kind, native = schema.get("type"), str(schema.get("x-native-type"))
    bounds = schema.get("minimum"), schema.get("maximum")
    if kind == "integer":
        if BASIC.get(native) in _WHOLE:
            return native
        return next((name for name, low, high in _INTEGERS if bounds == (low, high)), "int64")
    known = _KINDS.get(kind) if isinstance(kind, str) else None
    if known is None:
        return ""
    if native in known:
        return native
    narrow = kind == "number" and bounds == (-FLOAT32_MAX, FLOAT32_MAX)
    return "float32" if narrow else known[0]
