"""Bridge hosts: a bridge, unchanged, in a process and Python environment of its own.

Needs the extra `uoarm[hosts]`, in the application and in the environment of every host.
"""

from uoarm._host._desk import MachineDesk
from uoarm._host._die_with_parent import die_with_parent
from uoarm._host._join import JoinedHost
from uoarm._host._remote import RemoteBridge
from uoarm._host._security import Identity
from uoarm._host._settings import HostSettings
from uoarm._host._xmlrpc import XmlRpcFace

__all__ = [
    "HostSettings",
    "Identity",
    "JoinedHost",
    "MachineDesk",
    "RemoteBridge",
    "XmlRpcFace",
    "die_with_parent",
]
