"""uoarm-rocos: devices and robots with an XML catalogue as components of uoarm.

The wire is replaceable: `bridge_type` makes a bridge type of another codec, framer or transport,
for whoever holds a vendor's documents.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm.model import Options
from uoarm_rocos._doctor import doctor
from uoarm_rocos._options import BRIDGE_OPTIONS, mistake

if TYPE_CHECKING:
    from uoarm_rocos._catalogue import Api, Catalogue, Kind, differences
    from uoarm_rocos._catalogue_xml import load_catalogue
    from uoarm_rocos._classes import ApiClass, Record, api_classes
    from uoarm_rocos._codec import Codec, XmlCodec
    from uoarm_rocos._drivers import MakeWire, xml_wire
    from uoarm_rocos._errors import LineError, WireError
    from uoarm_rocos._framing import Framer, LengthFramer, StuffedFramer
    from uoarm_rocos._limits import SERIAL_LIMITS, TCP_LIMITS, Limits
    from uoarm_rocos._settings import DeviceSettings
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

_MODULES = {
    "_catalogue": "Api Catalogue Kind differences",
    "_catalogue_xml": "load_catalogue",
    "_classes": "ApiClass Record api_classes",
    "_codec": "Codec XmlCodec",
    "_drivers": "MakeWire xml_wire",
    "_errors": "LineError WireError",
    "_framing": "Framer LengthFramer StuffedFramer",
    "_limits": "SERIAL_LIMITS TCP_LIMITS Limits",
    "_settings": "DeviceSettings",
    "_structure": "structure_of",
    "_talk": "Wire",
    "_transport": "LineSettings SerialTransport TcpTransport Transport",
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names.split()}


def bridge_type(name: str, summary: str, wire: MakeWire | None = None) -> BridgeType:
    """Return a bridge type whose profile devices are reached through another wire.

    Args:
        name: what a configuration's `plugin:` says.
        summary: one line for people.
        wire: makes transport, framer and codec from a device's settings; None: the profile's.
    """
    return BridgeType(
        name=name,
        summary=summary,
        create=_maker(wire),
        options_schema=BRIDGE_OPTIONS,
        check_endpoint=mistake,
        doctor=doctor,
        contract=2,
    )


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [bridge_type("rocos", "devices with an XML catalogue, over TCP or serial")]


def __getattr__(name: str) -> object:
    """Import the public names when they are used: loading the plugin stays light."""
    module = _HOMES.get(name)
    if module is None:
        raise AttributeError(f"module 'uoarm_rocos' has no attribute {name!r}")
    return getattr(import_module(f"uoarm_rocos.{module}"), name)


def _maker(wire: MakeWire | None) -> Callable[[str, Options], Bridge]:
    def make(name: str, options: Options) -> Bridge:
        from uoarm_rocos._bridge import RocosBridge  # noqa: PLC0415 - imports pyserial
        from uoarm_rocos._drivers import xml_wire  # noqa: PLC0415 - the same

        return RocosBridge(name, options, wire or xml_wire)

    return make
