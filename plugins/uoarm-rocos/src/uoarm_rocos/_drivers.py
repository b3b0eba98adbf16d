"""Which device stands behind each name of a driver."""

from __future__ import annotations

import os
from collections.abc import Callable

from uoarm_rocos._catalogue_xml import load_catalogue
from uoarm_rocos._codec import XmlCodec
from uoarm_rocos._device import Device
from uoarm_rocos._framing import LengthFramer, StuffedFramer
from uoarm_rocos._limits import SERIAL_LIMITS, TCP_LIMITS
from uoarm_rocos._profile import Changed, ProfileDevice
from uoarm_rocos._settings import DeviceSettings
from uoarm_rocos._talk import Wire
from uoarm_rocos._transport import transport_for
from uoarm_rocos.devices._contec import PERIOD, ContecDecoder
from uoarm_rocos.devices._monitor import Monitor
from uoarm_rocos.devices._nonin import PERIOD_1, PERIOD_2, Nonin1Decoder, Nonin2Decoder
from uoarm_rocos.devices._oximetry import Decoder, oximeter_catalogue
from uoarm_rocos.devices._stream import StreamDevice
from uoarm_rocos.speech._device import Speech
from uoarm_rocos.speech._engine import Engine
from uoarm_rocos.speech._espeak import EspeakEngine
from uoarm_rocos.speech._festival import FestivalEngine

__all__ = ["MakeWire", "make_device", "xml_wire"]

_OXIMETERS: dict[str, tuple[str, float, Callable[[], Decoder]]] = {
    "contec-cms50dplus": ("Contec CMS50D+", PERIOD, ContecDecoder),
    "nonin-1": ("Nonin, serial format 1", PERIOD_1, Nonin1Decoder),
    "nonin-2": ("Nonin, serial format 2", PERIOD_2, Nonin2Decoder),
}
_ENGINES: dict[str, Callable[[], Engine]] = {"espeak": EspeakEngine, "festival": FestivalEngine}
_IS_POSIX = os.name == "posix"
MakeWire = Callable[[DeviceSettings], Wire]


def xml_wire(settings: DeviceSettings) -> Wire:
    """Return the profile's own parts: lengths over TCP, stuffing and CRC on every other line."""
    transport = transport_for(settings.url, settings.line)
    if settings.url.startswith("tcp://"):
        return Wire(transport, LengthFramer, XmlCodec(TCP_LIMITS), prompt=_IS_POSIX)
    is_port = "://" not in settings.url
    return Wire(transport, StuffedFramer, XmlCodec(SERIAL_LIMITS), prompt=_IS_POSIX and is_port)


def make_device(settings: DeviceSettings, wire: MakeWire, changed: Changed) -> Device:
    """Make a device and begin to connect it.

    Raises:
        UoarmError: its catalogue cannot be read, or its driver lacks a package.
    """
    if settings.driver == "profile":
        catalogue = load_catalogue(settings.catalogue) if settings.catalogue else None
        return ProfileDevice(settings.name, wire(settings), settings.timing, catalogue, changed)
    if settings.driver in _ENGINES:
        return Speech(settings.name, _ENGINES[settings.driver](), settings.options)
    transport = transport_for(settings.url, settings.line)
    if settings.driver == "and-ua767pbt":
        return Monitor(settings.name, transport, settings.timing, changed)
    text, period, decoder = _OXIMETERS[settings.driver]
    catalogue = oximeter_catalogue(text, period)
    return StreamDevice(settings.name, catalogue, decoder, transport, settings.timing)
