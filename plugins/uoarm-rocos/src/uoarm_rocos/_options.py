"""What a configuration may say of devices and endpoints; importing it opens and loads nothing."""

from __future__ import annotations

from uoarm.model import Options, Schema
from uoarm_rocos._fields import NAME

__all__ = ["BRIDGE_OPTIONS", "DRIVER_NAMES", "mistake"]

DRIVER_NAMES = (
    "profile",
    "contec-cms50dplus",
    "nonin-1",
    "nonin-2",
    "and-ua767pbt",
    "espeak",
    "festival",
)
_SECONDS: dict[str, object] = {"type": "number", "exclusiveMinimum": 0, "maximum": 3600}
_DEVICE: dict[str, object] = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "driver": {"enum": list(DRIVER_NAMES), "description": "what it speaks; default profile"},
        "url": {
            "type": "string",
            "x-uoarm-path": r"(\.\.?|~)/.*",
            "description": "tcp://host:port, a serial port, socket://, rfc2217://",
        },
        "catalogue": {
            "type": "string",
            "x-uoarm-path": True,
            "description": "file, instead of asking the device",
        },
        "baud": {"type": "integer", "minimum": 50, "maximum": 4_000_000},
        "bits": {"enum": [5, 6, 7, 8]},
        "parity": {"enum": ["N", "E", "O"]},
        "stop": {"enum": [1, 1.5, 2]},
        "xonxoff": {"type": "boolean"},
        "wait": {**_SECONDS, "description": "for a device that is not there; default 3"},
        "grace": {**_SECONDS, "description": "for a fault to pass before it is a loss; default 5"},
        "backoff": {
            "type": "array",
            "items": _SECONDS,
            "minItems": 2,
            "maxItems": 2,
            "description": "first and longest pause between attempts; default [0.1, 2]",
        },
        "voice": {"type": "string", "description": "of speech, where a request names none"},
        "play": {"enum": ["auto", "never"], "description": "of speech; default auto"},
        "directory": {
            "type": "string",
            "x-uoarm-path": True,
            "description": "for speech that is not played",
        },
    },
}
BRIDGE_OPTIONS: Schema = {
    "type": "object",
    "additionalProperties": False,
    "required": ["devices"],
    "properties": {
        "devices": {
            "type": "object",
            "minProperties": 1,
            "propertyNames": {"pattern": "^[A-Za-z_][A-Za-z0-9_.-]*$"},
            "additionalProperties": _DEVICE,
            "examples": [{"robot": {"url": "tcp://127.0.0.1:4000"}}],
        },
    },
}


def mistake(address: tuple[str, ...], options: Options) -> str:
    """Return what is wrong with an address or its options, or ""."""
    if len(address) != 2 or not NAME.fullmatch(address[1]):  # noqa: PLR2004 - as the text says
        return f"expected [device, API name], got {list(address)}"
    if options:
        return f"an endpoint has no options here, got {', '.join(options)}"
    return ""
