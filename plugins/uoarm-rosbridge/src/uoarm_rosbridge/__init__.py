"""The rosbridge v2 endpoint: existing ROS web clients find every framework behind it.

Source of the protocol: https://github.com/RobotWebTools/rosbridge_suite, ROSBRIDGE_PROTOCOL.md.
"""

__all__: list[str] = []
