"""uoarm, the UoA Robot Manager: ask for a robot function, get it from any framework.

The layers, from the top; imports go down only:

    uoarm               this façade            uoarm.cli       the command line
    uoarm._control      requests, connections, status, health
    uoarm._resolve      robot + structures -> plan
    uoarm.config        file -> robot
    uoarm._dataplane    routes, queues, counters
    uoarm.local         plain Python components
    uoarm.bridge        the contract of framework plugins
    uoarm._adapt        declared, typed, compiled adapters
    uoarm.model         frozen values          uoarm.schema    containment, on its own
"""

from typing import TYPE_CHECKING

from uoarm import _run_as_module, errors  # noqa: F401 - that first, for what it does
from uoarm._deferred import deferred
from uoarm._version import __version__
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    CommandRefusedError,
    ConfigurationError,
    ConnectionClosedError,
    ControlMessageError,
    MessageError,
    PluginError,
    ResolutionError,
    UoarmError,
    UsageError,
)

if TYPE_CHECKING:
    from uoarm._aio import AsyncConnection, AsyncRobotManager
    from uoarm._control import Connection, RobotManager
    from uoarm.model import (
        OverflowPolicy,
        Plan,
        QueuePolicy,
        StatusEvent,
        StatusMap,
        ValidationMode,
    )

__all__ = [
    "AsyncConnection",
    "AsyncRobotManager",
    "BridgeError",
    "BridgeTimeoutError",
    "CommandRefusedError",
    "ConfigurationError",
    "Connection",
    "ConnectionClosedError",
    "ControlMessageError",
    "MessageError",
    "OverflowPolicy",
    "Plan",
    "PluginError",
    "QueuePolicy",
    "ResolutionError",
    "RobotManager",
    "StatusEvent",
    "StatusMap",
    "UoarmError",
    "UsageError",
    "ValidationMode",
    "__version__",
    "errors",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = deferred(
        __name__,
        {
            "_aio": ("AsyncConnection", "AsyncRobotManager"),
            "_control": ("Connection", "RobotManager"),
            "model": (
                "OverflowPolicy",
                "Plan",
                "QueuePolicy",
                "StatusEvent",
                "StatusMap",
                "ValidationMode",
            ),
        },
        submodules=("bridge", "config", "environments", "model", "plugins", "schema"),
    )
