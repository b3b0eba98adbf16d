"""The control plane: requests, connections, what is shared between them, and their status."""

from typing import TYPE_CHECKING

from uoarm._deferred import deferred

if TYPE_CHECKING:
    from uoarm._control.aio import AsyncConnection, AsyncRobotManager
    from uoarm._control.connection import Connection
    from uoarm._control.robot_manager import RobotManager

__all__ = ["AsyncConnection", "AsyncRobotManager", "Connection", "RobotManager"]

if not TYPE_CHECKING:
    __getattr__, __dir__ = deferred(
        __name__,
        {
            "aio": ("AsyncConnection", "AsyncRobotManager"),
            "connection": ("Connection",),
            "robot_manager": ("RobotManager",),
        },
    )
