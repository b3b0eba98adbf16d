"""The control plane: requests, connections, what is shared between them, and their status."""

from uoarm._control._aio import AsyncConnection, AsyncRobotManager
from uoarm._control._connection import Connection
from uoarm._control._robot_manager import RobotManager

__all__ = ["AsyncConnection", "AsyncRobotManager", "Connection", "RobotManager"]
