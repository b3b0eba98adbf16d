"""The control plane: requests, connections, what is shared between them, and their status."""

from uoarm.manager._aio import AsyncConnection, AsyncRobotManager
from uoarm.manager._connection import Connection
from uoarm.manager._robot_manager import RobotManager

__all__ = ["AsyncConnection", "AsyncRobotManager", "Connection", "RobotManager"]
