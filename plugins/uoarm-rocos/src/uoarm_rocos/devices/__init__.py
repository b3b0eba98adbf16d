"""Devices that speak their makers' frames: the frames here, the drivers by name in a configuration.

A decoder makes messages of octets and does no I/O: `feed(octets)` returns what they complete.
"""

from uoarm_rocos.devices._blood_pressure import ACCEPTED as UA767_ACCEPTED
from uoarm_rocos.devices._blood_pressure import REFUSED as UA767_REFUSED
from uoarm_rocos.devices._blood_pressure import Measurement, Ua767Decoder
from uoarm_rocos.devices._oximeters import (
    ContecDecoder,
    Nonin1Decoder,
    Nonin2Decoder,
    OximeterDecoder,
    contec_frame,
    nonin1_frame,
    nonin2_packet,
)

__all__ = [
    "UA767_ACCEPTED",
    "UA767_REFUSED",
    "ContecDecoder",
    "Measurement",
    "Nonin1Decoder",
    "Nonin2Decoder",
    "OximeterDecoder",
    "Ua767Decoder",
    "contec_frame",
    "nonin1_frame",
    "nonin2_packet",
]
