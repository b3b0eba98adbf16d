"""uoarm-rocos: devices and robots with an XML catalogue as components of uoarm.

The wire is replaceable: `bridge_type` makes a bridge type of another codec, framer or transport,
for those who have a vendor's documents.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm_rocos._options import PortOptions, RocosOptions, mistake

if TYPE_CHECKING:
    from uoarm_rocos._bridge import MakeWire, xml_wire
    from uoarm_rocos._catalogue import Api, ApiKind, DeviceCatalogue, differences
    from uoarm_rocos._catalogue_xml import load_catalogue
    from uoarm_rocos._codec import MessageCodec, XmlCodec
    from uoarm_rocos._framing import (
        SERIAL_LIMITS,
        TCP_LIMITS,
        Framer,
        LengthFramer,
        LineError,
        MessageLimits,
        StuffedFramer,
        WireError,
    )
    from uoarm_rocos._options import DeviceOptions, LineOptions
    from uoarm_rocos._profile import LineParts
    from uoarm_rocos._structure import ApiClass, ApiRecord, api_classes, structure_of
    from uoarm_rocos._transport import LineTransport, SerialTransport, TcpTransport

__all__ = [
    "SERIAL_LIMITS",
    "TCP_LIMITS",
    "Api",
    "ApiClass",
    "ApiKind",
    "ApiRecord",
    "DeviceCatalogue",
    "DeviceOptions",
    "Framer",
    "LengthFramer",
    "LineError",
    "LineOptions",
    "LineParts",
    "LineTransport",
    "MakeWire",
    "MessageCodec",
    "MessageLimits",
    "SerialTransport",
    "StuffedFramer",
    "TcpTransport",
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
    "_bridge": "MakeWire xml_wire",
    "_catalogue": "Api ApiKind DeviceCatalogue differences",
    "_catalogue_xml": "load_catalogue",
    "_codec": "MessageCodec XmlCodec",
    "_framing": "SERIAL_LIMITS TCP_LIMITS Framer LengthFramer LineError MessageLimits "
    "StuffedFramer WireError",
    "_options": "DeviceOptions LineOptions",
    "_structure": "ApiClass ApiRecord api_classes structure_of",
    "_profile": "LineParts",
    "_transport": "LineTransport SerialTransport TcpTransport",
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names.split()}


def bridge_type(name: str, summary: str, wire: MakeWire | None = None) -> BridgeType:
    """Return a bridge type whose profile devices are reached through another wire.

    Args:
        name: what a configuration's `plugin:` says.
        summary: one line for people.
        wire: makes transport, framer and codec from a device's options; None: the profile's.
    """
    return BridgeType(
        name=name,
        summary=summary,
        create=_maker(wire),
        bridge_options=RocosOptions,
        endpoint_options=PortOptions,
        check_endpoint=mistake,
        doctor=_doctor,
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


def _doctor() -> dict[str, str]:
    from uoarm_rocos._discovery import doctor  # noqa: PLC0415 - loads the reader of XML

    return doctor()


def _maker(wire: MakeWire | None) -> Callable[[str, RocosOptions], Bridge]:
    def make(name: str, options: RocosOptions) -> Bridge:
        from uoarm_rocos._bridge import RocosBridge, xml_wire  # noqa: PLC0415 - loads pyserial

        return RocosBridge(name, options, wire or xml_wire)

    return make
