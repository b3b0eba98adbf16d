"""Bridge hosts: a bridge, unchanged, in a process and Python environment of its own.

Needs the extra `uoarm[hosts]`, in the application and in the environment of every host. What other
machines need beside, `uoarm[machines]`, is imported from `_host.machines` and `_host.agent` alone.
"""

from typing import TYPE_CHECKING

from uoarm._deferred import deferred

if TYPE_CHECKING:
    from uoarm._host.process_connection import HostSettings
    from uoarm._host.remote_bridge import RemoteBridge
    from uoarm._host.transport.zenoh_transport import Identity
    from uoarm._host.xmlrpc_server import XmlRpcServer

__all__ = [
    "HostSettings",
    "Identity",
    "RemoteBridge",
    "XmlRpcServer",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = deferred(
        __name__,
        {
            "process_connection": ("HostSettings",),
            "remote_bridge": ("RemoteBridge",),
            "transport.zenoh_transport": ("Identity",),
            "xmlrpc_server": ("XmlRpcServer",),
        },
    )
