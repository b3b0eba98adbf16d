"""uoarm-ros2: ROS 2 topics, services and actions as components of uoarm.

Importing this package imports no middleware; making a bridge does.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

from uoarm.bridge import Bridge, BridgeType, hookimpl, install_command
from uoarm.errors import PluginError
from uoarm.model import Options
from uoarm_ros2._installed import absent_middleware, doubts, structure_of_type
from uoarm_ros2._options import Ros2BridgeOptions, Ros2Options, mistake, topic_name
from uoarm_ros2._parameters import mistakes

__all__ = ["uoarm_bridge_types"]


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [
        BridgeType(
            name="ros2",
            summary="ROS 2 topics, services and actions through rclpy",
            create=_create,
            bridge_options=Ros2BridgeOptions,
            endpoint_options=Ros2Options,
            check_endpoint=mistake,
            topic=topic_name,
            doctor=_doctor,
            check_parameters=_check_parameters,
            structure_of_type=structure_of_type,
            doubts=doubts,
            contract=2,
        )
    ]


def _create(name: str, options: Ros2BridgeOptions) -> Bridge:
    try:
        module = import_with_middleware("uoarm_ros2._bridge")
    except PluginError as error:
        raise PluginError(f"bridge {name!r}: {error}") from error
    made: Bridge = module.Ros2Bridge(name, options)
    return made


def _check_parameters(
    address: tuple[str, ...], parameters: Options, options: Ros2BridgeOptions
) -> dict[str, str]:
    del address, options  # which parameters a node has only the node knows
    return mistakes(parameters)


def _doctor() -> dict[str, str]:
    found: dict[str, str] = import_with_middleware("uoarm_ros2._middleware").environment()
    return found


def import_with_middleware(module: str) -> Any:
    """Import a module of this plugin that imports rclpy.

    Raises:
        PluginError: there is no rclpy, or not the middleware that the environment asks for; says
            how to get it.
    """
    absent = absent_middleware(os.environ)
    if absent and "rclpy" not in sys.modules:
        raise PluginError(absent)
    try:
        return importlib.import_module(module)
    except ImportError as error:
        command = install_command("uoarm-ros2", "jazzy")
        raise PluginError(
            f"rclpy cannot be imported: install it with {command} (or [kilted]), or source the "
            f"ROS 2 installation before starting Python ({error})"
        ) from error
