"""uoarm-ros2: ROS 2 topics, services and actions as components of uoarm.

Importing this package imports no middleware; making a bridge does.
"""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl, install_command
from uoarm.errors import PluginError
from uoarm.model import Options
from uoarm_ros2._parameters import mistakes
from uoarm_ros2._settings import BRIDGE_OPTIONS, mistake, topic_name

__all__ = ["uoarm_bridge_types"]


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
            topic=topic_name,
            doctor=_doctor,
            check_parameters=_check_parameters,
            contract=2,
        )
    ]


def _create(name: str, options: Options) -> Bridge:
    try:
        from uoarm_ros2._bridge import Ros2Bridge  # noqa: PLC0415 - imports the middleware
    except ImportError as error:
        raise PluginError(f"bridge {name!r}: {missing(error)}") from error
    return Ros2Bridge(name, options)


def _check_parameters(
    address: tuple[str, ...], parameters: Options, options: Options
) -> dict[str, str]:
    del address, options  # which parameters a node has only the node knows
    return mistakes(parameters)


def _doctor() -> dict[str, str]:
    try:
        from uoarm_ros2._middleware import environment  # noqa: PLC0415 - imports the middleware
    except ImportError as error:
        raise PluginError(missing(error)) from error
    return environment()


def missing(error: ImportError) -> str:
    """Return the sentence that says how to get the rclpy that cannot be imported."""
    command = install_command("uoarm-ros2", "jazzy")
    return (
        f"rclpy cannot be imported: install it with {command} (or [kilted]), or source the ROS 2 "
        f"installation before starting Python ({error})"
    )
