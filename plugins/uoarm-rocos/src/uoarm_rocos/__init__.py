"""uoarm-rocos: devices and robots with an XML catalogue as components of uoarm.

The wire is replaceable: `bridge_type` makes a bridge type of another codec, framer or transport,
for whoever holds a vendor's documents.
"""

from __future__ import annotations

from uoarm.bridge import BridgeType, hookimpl
from uoarm_rocos._bridge import RocosBridge
from uoarm_rocos._catalogue import Api, Catalogue, Kind, differences
from uoarm_rocos._catalogue_xml import load_catalogue
from uoarm_rocos._classes import ApiClass, Record, api_classes
from uoarm_rocos._codec import Codec, XmlCodec
from uoarm_rocos._drivers import MakeWire, xml_wire
from uoarm_rocos._errors import LineError, WireError
from uoarm_rocos._framing import Framer, LengthFramer, StuffedFramer
from uoarm_rocos._limits import SERIAL_LIMITS, TCP_LIMITS, Limits
from uoarm_rocos._settings import BRIDGE_OPTIONS, DeviceSettings, mistake
from uoarm_rocos._structure import structure_of
from uoarm_rocos._talk import Wire
from uoarm_rocos._transport import LineSettings, SerialTransport, TcpTransport, Transport

__all__ = [
    "SERIAL_LIMITS",
    "TCP_LIMITS",
    "Api",
    "ApiClass",
    "Catalogue",
    "Codec",
    "DeviceSettings",
    "Framer",
    "Kind",
    "LengthFramer",
    "Limits",
    "LineError",
    "LineSettings",
    "MakeWire",
    "Record",
    "SerialTransport",
    "StuffedFramer",
    "TcpTransport",
    "Transport",
    "Wire",
    "WireError",
    "XmlCodec",
    "api_classes",
    "bridge_type",
    "differences",
    "load_catalogue",
    "structure_of",
    "uoarm_bridge_types",
    "xml_wire",
]


def bridge_type(name: str, summary: str, wire: MakeWire) -> BridgeType:
    """Return a bridge type whose profile devices are reached through another wire.

    Args:
        name: what a configuration's `plugin:` says.
        summary: one line for people.
        wire: makes transport, framer and codec from a device's settings.
    """
    return BridgeType(
        name=name,
        summary=summary,
        create=lambda instance, options: RocosBridge(instance, options, wire),
        options_schema=BRIDGE_OPTIONS,
        check_endpoint=mistake,
    )


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [bridge_type("rocos", "devices with an XML catalogue, over TCP or serial", xml_wire)]
