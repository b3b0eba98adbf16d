"""The structures of installed message types by name, without a bridge and without rclpy."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import MessageStructure, Options
from uoarm_ros2._schema import structure_of
from uoarm_ros2._shape import shape_of
from uoarm_ros2._types import ACTION, MESSAGE, SERVICE, import_type, kind_of, type_mistake

__all__ = ["structure_of_type"]

_PARTS = {SERVICE: ("Request", "Response"), ACTION: ("Goal", "Result", "Feedback")}


def structure_of_type(name: str, options: Options) -> MessageStructure | None:
    """Return the structure of an installed message type; None: there is none of this name.

    Takes `package/Name` for `package/msg/Name`, as ROS 1 and its clients spell it. Parts of
    services and actions are types as well: `package/srv/Name_Request`, `package/action/Name_Goal`.

    Raises:
        BridgeError: the type is installed and cannot be understood.
    """
    del options  # those of definitions are read where the bridge is made
    if name.count("/") == 1:
        name = name.replace("/", f"/{MESSAGE}/")
    if type_mistake(name):
        return None
    package, kind, own = name.split("/")
    if (kind != MESSAGE and not _part_of(own, kind)[1]) or not _has_types(package, kind):
        return None
    return _installed(name)


@lru_cache(maxsize=1024)
def _installed(name: str) -> MessageStructure | None:
    whole, part = _part_of(name, kind_of(name))
    try:
        native: Any = import_type(whole)
        return structure_of(shape_of(getattr(native, part) if part else native, name))
    except BridgeError as error:
        if error.reason is FailureReason.NOT_FOUND:
            return None
        raise


def _part_of(name: str, kind: str) -> tuple[str, str]:
    """Return the service or the action of a part, and which part it is; a message has none."""
    whole, _, part = name.rpartition("_")
    return (whole, part) if part in _PARTS.get(kind, ()) else (name, "")


def _has_types(package: str, kind: str) -> bool:
    """Say whether a package holds types of a kind, without importing anything of it.

    The name comes from a client: to import whatever it names would run any module's code.
    """
    spec = find_spec(package)
    folders = () if spec is None else spec.submodule_search_locations or ()
    return any(Path(folder, kind, "__init__.py").is_file() for folder in folders)
