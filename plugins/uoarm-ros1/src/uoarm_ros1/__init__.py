"""uoarm-ros1: topics, services, parameters and actions of ROS 1 as components of uoarm.

Nothing of ROS is needed on this machine; nothing but the master and the nodes on theirs.
"""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm.errors import BridgeError
from uoarm.model import MessageStructure
from uoarm_ros1._options import Ros1BridgeOptions, Ros1Options, mistake, topic_name

__all__ = ["uoarm_bridge_types"]


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [
        BridgeType(
            name="ros1",
            summary="topics, services, parameters and actions of ROS 1, without ROS here",
            create=_create,
            bridge_options=Ros1BridgeOptions,
            endpoint_options=Ros1Options,
            check_endpoint=mistake,
            topic=topic_name,
            doctor=_doctor,
            structure_of_type=_structure_of_type,
            contract=2,
        )
    ]


def _create(name: str, options: Ros1BridgeOptions) -> Bridge:
    from uoarm_ros1._bridge import Ros1Bridge  # noqa: PLC0415 - imports numpy

    return Ros1Bridge(name, options)


def _structure_of_type(name: str, options: Ros1BridgeOptions) -> MessageStructure | None:
    from uoarm_ros1._types import TypeStore  # noqa: PLC0415 - imports numpy

    try:
        record = TypeStore(options.definitions).message(name)
    except BridgeError:
        return None
    return None if record is None else record.structure


def _doctor() -> dict[str, str]:
    import os  # noqa: PLC0415 - not needed to load the plugin
    from importlib.metadata import version  # noqa: PLC0415 - not needed to load the plugin

    from uoarm_ros1._types import installed_folders  # noqa: PLC0415 - imports numpy

    found = {
        name: os.environ.get(name, "not set")
        for name in ("ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_IP", "ROS_NAMESPACE")
    }
    folders = ", ".join(map(str, installed_folders(os.environ))) or "none"
    return {**found, "definitions from": folders, "rosbags": version("rosbags")}
