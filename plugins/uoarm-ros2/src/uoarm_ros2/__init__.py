"""uoarm-ros2: ROS 2 topics, services and actions as components of uoarm.

Importing this package imports no middleware; making a bridge does.
"""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm.errors import PluginError
from uoarm.model import Options
from uoarm_ros2._settings import BRIDGE_OPTIONS, mistake

__all__ = ["uoarm_bridge_types"]

_INSTALL = (
    "rclpy cannot be imported: install it with `pip install 'uoarm-ros2[jazzy]'` (or [kilted]), "
    "or source the ROS 2 installation before starting Python"
)


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [
        BridgeType(
            name="ros2",
            summary="ROS 2 topics, services and actions through rclpy",
            create=_create,
            options_schema=BRIDGE_OPTIONS,
            check_endpoint=mistake,
            doctor=_doctor,
        )
    ]


def _create(name: str, options: Options) -> Bridge:
    try:
        from uoarm_ros2._bridge import Ros2Bridge  # noqa: PLC0415 - imports the middleware
    except ImportError as error:
        raise PluginError(f"bridge {name!r}: {_INSTALL} ({error})") from error
    return Ros2Bridge(name, options)


def _doctor() -> dict[str, str]:
    try:
        from uoarm_ros2._middleware import environment  # noqa: PLC0415 - imports the middleware
    except ImportError as error:
        return {"rclpy": f"missing: {_INSTALL} ({error})"}
    return environment()
