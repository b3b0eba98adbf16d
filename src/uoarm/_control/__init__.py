"""The control plane: requests, connections, what is shared between them, and their status."""

from uoarm._control.aio import AsyncConnection, AsyncRobotManager
from uoarm._control.connection import Connection
from uoarm._control.robot_manager import RobotManager

__all__ = ["AsyncConnection", "AsyncRobotManager", "Connection", "RobotManager"]
