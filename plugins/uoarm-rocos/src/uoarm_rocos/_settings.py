"""Addresses and options as the configuration writes them, read without opening anything."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from attrs import evolve, field, frozen

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Options, Role
from uoarm_rocos._line import Backoff
from uoarm_rocos._messages import Direction
from uoarm_rocos._options import mistake
from uoarm_rocos._profile import Timing
from uoarm_rocos._transport import LineSettings, transport_for

__all__ = ["DRIVERS", "DeviceSettings", "address_of", "devices_of"]

# The lines that the devices' makers set; a profile device's is the usual one. The CMS50D+ is said
# to use XON/XOFF, but its frames hold the octets 11 and 13 as numbers, which a tty that is told
# so swallows; nothing is ever sent to it, so there is nothing to hold back either.
DRIVERS: Mapping[str, LineSettings | None] = {
    "profile": LineSettings(),
    "contec-cms50dplus": LineSettings(19_200, 8, "O", 1),
    "nonin-1": LineSettings(9_600),
    "nonin-2": LineSettings(9_600),
    "and-ua767pbt": LineSettings(9_600),
    "espeak": None,
    "festival": None,
}


@frozen
class DeviceSettings:
    """One device of a bridge instance; `options` are those that only its driver reads."""

    name: str
    driver: str = "profile"
    url: str = ""
    catalogue: str = ""
    line: LineSettings = field(factory=LineSettings)
    timing: Timing = field(factory=Timing)
    options: Mapping[str, Any] = field(factory=dict, hash=False)


def devices_of(options: Options) -> dict[str, DeviceSettings]:
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


def _device(name: str, given: Mapping[str, Any]) -> DeviceSettings:
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
    settings = LineSettings() if usual is None else usual
    chosen = {
        key: given[key] for key in ("baud", "bits", "parity", "stop", "xonxoff") if key in given
    }
    line = evolve(settings, **chosen)
    transport_for(url, line)
    timing = Timing(**{key: given[key] for key in ("wait", "grace") if key in given})
    if "backoff" in given:
        timing = evolve(timing, backoff=Backoff(*given["backoff"]))
    own = {key: given[key] for key in ("voice", "play", "directory") if key in given}
    return DeviceSettings(name, driver, url, given.get("catalogue", ""), line, timing, own)
