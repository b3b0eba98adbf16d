"""The control plane: requests, connections, what is shared between them, and their status."""

from typing import TYPE_CHECKING

from uoarm._deferred import deferred

if TYPE_CHECKING:
    from uoarm._control.connection import Connection
    from uoarm._control.robot_manager import RobotManager

__all__ = ["Connection", "RobotManager"]

if not TYPE_CHECKING:
    __getattr__, __dir__ = deferred(
        __name__,
        {
            "connection": ("Connection",),
            "robot_manager": ("RobotManager",),
        },
    )
