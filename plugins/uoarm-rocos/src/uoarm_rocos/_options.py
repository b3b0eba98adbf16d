"""What a configuration may say of devices and endpoints; importing it opens and loads nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from attrs import evolve, field, frozen

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Options, Role, Schema
from uoarm_rocos._catalogue import NAME
from uoarm_rocos._messages import Direction

__all__ = [
    "BRIDGE_OPTIONS",
    "DRIVERS",
    "DRIVER_NAMES",
    "DeviceOptions",
    "LineBackoff",
    "LineOptions",
    "Timing",
    "address_of",
    "devices_of",
    "mistake",
    "tcp_address",
]

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


@frozen
class LineOptions:
    """A serial line: bits a second, data bits, `N`, `E` or `O`, stop bits."""

    baud: int = 115_200
    bits: int = 8
    parity: str = "N"
    stop: float = 1
    xonxoff: bool = False


@frozen
class LineBackoff:
    """Seconds before the first new attempt, doubled each time up to the last."""

    first: float = 0.1
    last: float = 2.0


@frozen
class Timing:
    """How long things may take, in seconds.

    Attributes:
        wait: for a device that is asked for and not there.
        grace: for a fault to pass before the device is reported as lost.
        backoff: pauses between attempts to connect.
    """

    wait: float = 3.0
    grace: float = 5.0
    backoff: LineBackoff = field(factory=LineBackoff)


# The lines that the devices' makers set; a profile device's is the usual one. The CMS50D+ is said
# to use XON/XOFF, but its frames hold the octets 11 and 13 as numbers, which a tty set
# so swallows; nothing is ever sent to it, so there is nothing to hold back either.
DRIVERS: Mapping[str, LineOptions | None] = {
    "profile": LineOptions(),
    "contec-cms50dplus": LineOptions(19_200, 8, "O", 1),
    "nonin-1": LineOptions(9_600),
    "nonin-2": LineOptions(9_600),
    "and-ua767pbt": LineOptions(9_600),
    "espeak": None,
    "festival": None,
}


@frozen
class DeviceOptions:
    """One device of a bridge instance; `options` are those that only its driver reads."""

    name: str
    driver: str = "profile"
    url: str = ""
    catalogue: str = ""
    line: LineOptions = field(factory=LineOptions)
    timing: Timing = field(factory=Timing)
    options: Mapping[str, Any] = field(factory=dict, hash=False)


def devices_of(options: Options) -> dict[str, DeviceOptions]:
    """Read a bridge's options, which fit its schema.

    Raises:
        BridgeError: BAD_ENDPOINT, with the device and what is wrong.
    """
    found = {}
    devices: Any = options["devices"]
    for name, given in devices.items():
        try:
            found[name] = _device(name, given)
        except ValueError as error:
            raise BridgeError(f"devices.{name}: {error}", FailureReason.BAD_ENDPOINT) from None
    return found


def address_of(endpoint: Endpoint) -> tuple[str, str, Direction | None]:
    """Return an endpoint's device, API and direction; None for a service.

    Raises:
        BridgeError: BAD_ENDPOINT, with what is wrong.
    """
    wrong = mistake(endpoint.address, endpoint.options)
    if wrong:
        text = f"bridge {endpoint.bridge!r}: {endpoint}: {wrong}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    device, api = endpoint.address
    directions = {Role.OUTPUT: Direction.OUTPUT, Role.INPUT: Direction.INPUT}
    return device, api, directions.get(endpoint.role)


def _device(name: str, given: Mapping[str, Any]) -> DeviceOptions:
    driver = given.get("driver", "profile")
    usual = DRIVERS[driver]
    url = given.get("url", "")
    if usual is None:
        if url:
            raise ValueError(f"driver {driver} has no line: leave out url")
    elif not url:
        raise ValueError(f"driver {driver} needs a url: tcp://host:port or a serial port")
    if given.get("catalogue") and driver != "profile":
        raise ValueError(f"driver {driver} has its own catalogue: leave out catalogue")
    chosen = {
        key: given[key] for key in ("baud", "bits", "parity", "stop", "xonxoff") if key in given
    }
    line = evolve(usual or LineOptions(), **chosen)
    tcp_address(url)
    timing = Timing(**{key: given[key] for key in ("wait", "grace") if key in given})
    if "backoff" in given:
        timing = evolve(timing, backoff=LineBackoff(*given["backoff"]))
    own = {key: given[key] for key in ("voice", "play", "directory") if key in given}
    return DeviceOptions(name, driver, url, given.get("catalogue", ""), line, timing, own)


def tcp_address(url: str) -> tuple[str, int] | None:
    """Return host and port of a `tcp://` URL, None for every other line.

    Raises:
        ValueError: `tcp://` without host and port.
    """
    if not url.startswith("tcp://"):
        return None
    host, _, port = url.removeprefix("tcp://").rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65_536:  # noqa: PLR2004 - a port
        raise ValueError(f"expected tcp://host:port, got {url!r}")
    return host.strip("[]"), int(port)
