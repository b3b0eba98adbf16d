"""What a configuration may say of devices and endpoints; importing it opens and loads nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from attrs import evolve, field, frozen

from uoarm.bridge import (
    Backoff,
    BridgeOptions,
    DeclaredOptions,
    EndpointOptions,
    address_check,
    option,
    reading_endpoint,
)
from uoarm.model import Endpoint, Role
from uoarm_rocos._catalogue import NAME, Direction

_TEXT: Mapping[str, Any] = {"type": "string"}
_PATH: Mapping[str, Any] = {"type": "string", "x-uoarm-path": True}
_SECONDS: Mapping[str, Any] = {"type": "number", "exclusiveMinimum": 0, "maximum": 3600}


@frozen
class LineOptions:
    """A serial line: bits a second, data bits, `N`, `E` or `O`, stop bits."""

    baud: int = 115_200
    bits: int = 8
    parity: str = "N"
    stop: float = 1
    xonxoff: bool = False


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
    backoff: Backoff = field(factory=Backoff)


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
class DeviceOptions(DeclaredOptions):
    """The options of one device."""

    driver: str = option("profile", {"enum": list(DRIVERS)}, "what it speaks, see below")
    url: str = option(
        "",
        {"type": "string", "x-uoarm-path": r"(\.\.?|~)/.*"},
        "`tcp://host:port`; or a serial port in any form of pyserial: `/dev/ttyUSB0`, `COM3`, "
        "`socket://`, `rfc2217://`",
    )
    catalogue: str | None = option(
        None, _PATH, "a file, for `profile`; left out: the device is asked"
    )
    baud: int | None = option(
        None,
        {"type": "integer", "minimum": 50, "maximum": 4_000_000},
        "bits a second of the serial line; this and the next four: left out, the driver's",
    )
    bits: int | None = option(None, {"enum": [5, 6, 7, 8]}, "data bits of the serial line")
    parity: str | None = option(None, {"enum": ["N", "E", "O"]}, "none, even or odd")
    stop: float | None = option(None, {"enum": [1, 1.5, 2]}, "stop bits")
    xonxoff: bool | None = option(None, {"type": "boolean"}, "flow control by XON and XOFF")
    wait: float = option(3.0, _SECONDS, "seconds to wait for a device that is asked for", unit="s")
    grace: float = option(
        5.0, _SECONDS, "seconds that a fault may last before it is a loss", unit="s"
    )
    backoff: Sequence[float] | None = option(
        None,
        {"type": "array", "items": _SECONDS, "minItems": 2, "maxItems": 2},
        "first and longest pause between attempts to connect, in seconds; left out: `[0.1, 2]`",
    )
    voice: str | None = option(
        None, _TEXT, "of speech, where a request names none; left out: the engine's"
    )
    play: str = option("auto", {"enum": ["auto", "never"]}, "whether speech is played")
    directory: str | None = option(
        None, _PATH, "for speech that is not played; left out: a temporary one"
    )

    @property
    def line(self) -> LineOptions:
        """Settings of the serial line: what is given, and else the driver's."""
        names = ("baud", "bits", "parity", "stop", "xonxoff")
        chosen = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return evolve(DRIVERS[self.driver] or LineOptions(), **chosen)

    @property
    def timing(self) -> Timing:
        """How long things may take."""
        first, most = self.backoff or (0.1, 2.0)
        return Timing(self.wait, self.grace, Backoff(first, most))

    def check_together(self) -> None:
        """Refuse what the driver does not need, and miss what it does."""
        if DRIVERS[self.driver] is None:
            if self.url:
                raise ValueError(f"driver {self.driver} has no line: leave out url")
        elif not self.url:
            text = f"driver {self.driver} needs a url: tcp://host:port or a serial port"
            raise ValueError(text)
        if self.catalogue and self.driver != "profile":
            raise ValueError(f"driver {self.driver} has its own catalogue: leave out catalogue")
        tcp_address(self.url)


@frozen
class PortOptions(EndpointOptions):
    """The options of one endpoint: there are none."""


@frozen
class RocosOptions(BridgeOptions):
    """The options of a bridge."""

    devices: Mapping[str, DeviceOptions] = option(
        {},
        {
            "type": "object",
            "minProperties": 1,
            "propertyNames": {"pattern": "^[A-Za-z_][A-Za-z0-9_.-]*$", "examples": ["robot"]},
            "additionalProperties": DeviceOptions,
            "examples": [{"robot": {"url": "tcp://127.0.0.1:4000"}}],
        },
        "by name",
        required=True,
    )


def _check(address: tuple[str, ...]) -> None:
    if len(address) != 2 or not NAME.fullmatch(address[1]):  # noqa: PLR2004 - as the text says
        raise ValueError(f"expected [device, API name], got {list(address)}")


mistake = address_check(_check)


def address_of(endpoint: Endpoint) -> tuple[str, str, Direction | None]:
    """Return an endpoint's device, API and direction; None for a service.

    Raises:
        BridgeError: BAD_ENDPOINT, with what is wrong.
    """
    with reading_endpoint(endpoint):
        if endpoint.options:
            PortOptions.of(endpoint.options)
        _check(endpoint.address)
    device, api = endpoint.address
    directions = {Role.OUTPUT: Direction.OUTPUT, Role.INPUT: Direction.INPUT}
    return device, api, directions.get(endpoint.role)


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
