"""Devices that speak their makers' frames: the frames here, the drivers by name in a configuration.

A decoder makes messages of octets and does no I/O: `feed(octets)` returns what they complete.
"""

from uoarm_rocos.devices._contec import ContecDecoder, contec_frame
from uoarm_rocos.devices._nonin import Nonin1Decoder, Nonin2Decoder, nonin1_frame, nonin2_packet
from uoarm_rocos.devices._oximetry import Decoder
from uoarm_rocos.devices._ua767 import ACCEPTED as UA767_ACCEPTED
from uoarm_rocos.devices._ua767 import REFUSED as UA767_REFUSED
from uoarm_rocos.devices._ua767 import Measurement, Ua767Decoder

__all__ = [
    "UA767_ACCEPTED",
    "UA767_REFUSED",
    "ContecDecoder",
    "Decoder",
    "Measurement",
    "Nonin1Decoder",
    "Nonin2Decoder",
    "Ua767Decoder",
    "contec_frame",
    "nonin1_frame",
    "nonin2_packet",
]
