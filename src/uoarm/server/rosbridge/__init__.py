"""The rosbridge v2 endpoint: existing ROS web clients find every framework behind it.

Source of the protocol: https://github.com/RobotWebTools/rosbridge_suite, ROSBRIDGE_PROTOCOL.md.
"""

from uoarm.server.rosbridge._hub import Hub
from uoarm.server.rosbridge._session import RosbridgeSession

__all__ = ["Hub", "RosbridgeSession"]
