"""What a configuration may say of a bridge and of a port, checked before anything runs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from attrs import frozen
from uoarm_mqtt import BrokerOptions

from uoarm.bridge import EndpointOptions, option
from uoarm.model import Options, Role
from uoarm_vda5050._releases import RELEASES, SENT, TOPICS, TRANSPORT_PARTS

_SECONDS: Mapping[str, Any] = {"type": "number", "exclusiveMinimum": 0, "maximum": 86400}
_COUNT: Mapping[str, Any] = {"type": "integer", "minimum": 1, "maximum": 10_000}


@frozen
class FleetOptions(BrokerOptions):
    """The options of a bridge."""

    release: str = option(
        "2.1",
        {"enum": list(RELEASES)},
        "of the standard; another major version in a header is refused",
    )
    interface: str = option(
        "",
        {"type": "string", "pattern": r"^[^/+#$\s]+$", "examples": ["uagv"]},
        "the first level of topics; left out: `uagv`, from release 3.0 on `vda5050`",
    )
    schemas: str | None = option(
        None,
        {"type": "string", "minLength": 1, "x-uoarm-path": True},
        "a folder with the published JSON Schemas of the release, see below",
    )
    retained_wait: float = option(
        0.2,
        {"type": "number", "minimum": 0, "maximum": 4},
        "seconds that a retained message may come after the broker has answered",
        unit="s",
    )
    state_timeout: float = option(
        35.0,
        _SECONDS,
        "seconds without a state after which a vehicle is degraded; the standard wants one "
        "every 30 s",
        unit="s",
    )
    repeat: float = option(
        2.0,
        _SECONDS,
        "seconds after which an order or cancellation that no state shows is sent again",
        unit="s",
    )
    accept_timeout: float = option(
        15.0, _SECONDS, "seconds within which a vehicle takes an order", unit="s"
    )
    max_nodes: int = option(1000, _COUNT, "of one order")
    max_vehicles: int = option(1000, _COUNT, "that are kept track of")


@frozen
class VehicleOptions(EndpointOptions):
    """The options of one endpoint."""

    header: bool = option(
        False, {"type": "boolean"}, "messages of an output of a topic keep their header"
    )


TRANSPORT = "transport"
# Brokers end the connection for a topic with a control character.
_ID = re.compile(r"[^/+#$\x00-\x1f\x7f-\x9f]{1,200}")


@frozen
class VehicleAddress:
    """What an address stands for.

    Attributes:
        topic: one of the standard, or `transport`.
        part: of a transport order; empty for a call of it, and for a topic.
        header: whether messages keep their header.
    """

    manufacturer: str
    serial_number: str
    topic: str
    part: str = ""
    header: bool = False

    @property
    def vehicle(self) -> tuple[str, str]:
        """Manufacturer and serial number."""
        return self.manufacturer, self.serial_number

    @property
    def roles(self) -> tuple[Role, ...]:
        """What an endpoint here can be; the first is what it usually is."""
        if self.topic == TRANSPORT and not self.part:
            return (Role.SERVICE,)
        if self.topic in SENT:
            return (Role.INPUT, Role.OUTPUT)
        return (Role.INPUT,) if self.part in {"goal", "cancel"} else (Role.OUTPUT,)

    def check_role(self, role: Role) -> None:
        """Hold the place against a role.

        Raises:
            ValueError: it cannot have it; the text says what it can be.
        """
        if role not in self.roles:
            what = f"{self.topic} {self.part}".strip()
            allowed = " or ".join(item.value for item in self.roles)
            raise ValueError(f"{what}: expected {allowed} as its role, got {role.value}")
        if self.header and (role is not Role.OUTPUT or self.topic == TRANSPORT):
            raise ValueError("`header` is for outputs of topics: the bridge makes headers itself")


def place_of(address: tuple[str, ...], options: Options, port: str = "") -> VehicleAddress:
    """Read an address and the options of its port.

    Args:
        address: manufacturer, serial number, topic, and the part of a transport order.
        options: of the port.
        port: its name, which stands for the topic or part that the address leaves out.

    Raises:
        ValueError: it cannot be read; the text says what was expected.
    """
    header = VehicleOptions.of(options).header
    parts = list(address)
    if len(parts) == 2 and port in TOPICS:  # noqa: PLR2004 - manufacturer and serial number
        parts.append(port)
    if len(parts) == 3 and parts[2] == TRANSPORT and port in TRANSPORT_PARTS:  # noqa: PLR2004
        parts.append(port)
    expected = "expected [MANUFACTURER, SERIAL_NUMBER, TOPIC]"
    topics = f"{', '.join(TOPICS)}, or {TRANSPORT}"
    if not 3 <= len(parts) <= 4:  # noqa: PLR2004
        raise ValueError(f"{expected} with a topic of {topics}, got {list(address)}")
    for name in parts[:2]:
        if not _ID.fullmatch(name):
            text = f"{name[:80]!r}: a manufacturer or serial number is no level of a topic with"
            raise ValueError(f"{text} / + # $ or control characters, and not empty")
    if parts[2] not in {*TOPICS, TRANSPORT}:
        raise ValueError(f"there is no topic {parts[2]!r}: {topics}")
    if len(parts) == 4 and (parts[2] != TRANSPORT or parts[3] not in TRANSPORT_PARTS):  # noqa: PLR2004
        allowed = ", ".join(TRANSPORT_PARTS)
        raise ValueError(f"{parts[3]!r}: only {TRANSPORT} has parts: {allowed}")
    manufacturer, serial_number, topic, part = (*parts, "")[:4]
    return VehicleAddress(manufacturer, serial_number, topic, part, header)


def mistake(address: tuple[str, ...], options: Options) -> str:
    """Say what is wrong with an address and its options, "" where nothing is."""
    last = address[-1] if address else ""
    if len(address) == 2:  # noqa: PLR2004 - the topic is the port's name, which is not known here
        last = "state"
    try:
        place_of(address, options, last)
    except ValueError as error:
        return str(error)
    return ""
