"""The structures of installed message types by name, without a bridge and without rclpy."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import MessageStructure, Options
from uoarm_ros2._schema import structure_of
from uoarm_ros2._shape import shape_of
from uoarm_ros2._types import MESSAGE, import_type, kind_of, type_mistake

__all__ = ["structure_of_type"]


def structure_of_type(name: str, options: Options) -> MessageStructure | None:
    """Return the structure of an installed message type; None: there is none of this name.

    Takes `package/Name` for `package/msg/Name`, as ROS 1 and its clients spell it.

    Raises:
        BridgeError: the type is installed and cannot be understood.
    """
    del options  # those of definitions are read where the bridge is made
    if name.count("/") == 1:
        name = name.replace("/", f"/{MESSAGE}/")
    if type_mistake(name) or kind_of(name) != MESSAGE or not _has_messages(name.partition("/")[0]):
        return None
    return _installed(name)


@lru_cache(maxsize=1024)
def _installed(name: str) -> MessageStructure | None:
    try:
        return structure_of(shape_of(import_type(name), name))
    except BridgeError as error:
        if error.reason is FailureReason.NOT_FOUND:
            return None
        raise


def _has_messages(package: str) -> bool:
    """Say whether a package holds message types, without importing anything of it.

    The name comes from a client: to import whatever it names would run any module's code.
    """
    spec = find_spec(package)
    folders = () if spec is None else spec.submodule_search_locations or ()
    return any(Path(folder, MESSAGE, "__init__.py").is_file() for folder in folders)
