"""What is open of a robot, as objects: components, edges, application ports and offers.

They know what they are connected to, and nothing of who decides that they open and close.
"""

from uoarm._parts._application_ports import ApplicationPorts, OutputReceiver
from uoarm._parts._component import LiveComponent, LiveEdge
from uoarm._parts._offered_function import Functions, OfferedFunction, offered_structures
from uoarm._parts._staleness import StalenessWatch

__all__ = [
    "ApplicationPorts",
    "Functions",
    "LiveComponent",
    "LiveEdge",
    "OfferedFunction",
    "OutputReceiver",
    "StalenessWatch",
    "offered_structures",
]
