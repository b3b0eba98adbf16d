"""The structures of installed message types by name, without a bridge and without rclpy."""

from __future__ import annotations

import os
import sys
from difflib import get_close_matches
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from uoarm.errors import BridgeError, ConfigurationError, FailureReason
from uoarm.model import MessageStructure, Options
from uoarm_ros2._schema import structure_of
from uoarm_ros2._settings import TF_MESSAGE
from uoarm_ros2._shape import shape_of
from uoarm_ros2._types import (
    ACTION,
    MESSAGE,
    SERVICE,
    import_type,
    kind_of,
    of_type,
    type_mistake,
)
from uoarm_ros2.definitions import Reading

__all__ = ["doubts", "installed", "structure_of_type"]

_INDEX = "share/ament_index/resource_index/rosidl_interfaces"
_SHOWN = 5


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


def installed() -> list[str]:
    """Return the types whose definitions are installed, as the index of ROS 2 lists them."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    found = set()
    for prefix in filter(None, prefixes):
        folder = Path(prefix) / _INDEX
        for package in folder.iterdir() if folder.is_dir() else ():
            lines = package.read_text().splitlines()
            found |= {f"{package.name}/{line.rpartition('.')[0]}" for line in lines}
    return sorted(name for name in found if not type_mistake(name))


def doubts(options: Options, addresses: frozenset[tuple[str, ...]]) -> dict[tuple[str, ...], str]:
    """Return what is wrong with definitions, and which addresses name a type that is not here.

    A node may describe such a message type, so that it is a doubt and no mistake. Where there is no
    ROS 2, and so no bridge, nothing is doubted.
    """
    if find_spec("rclpy") is None:
        return {}
    reading = Reading()
    found: dict[tuple[str, ...], str] = {}
    folders: Any = options.get("definitions", ())
    try:
        for folder in folders:
            reading.take(Path(folder).expanduser())
    except ConfigurationError as error:
        found[()] = str(error)
    reading.leave_out_twice()
    wrong = [f"{file}: {why}" for file, why in reading.problems.items()]
    wrong += [f"{name}: {reading.unread[name]}" for name in reading.twice]
    if wrong:
        more = f"; and {len(wrong) - _SHOWN} more" if len(wrong) > _SHOWN else ""
        found[()] = f"types of definitions cannot be used: {'; '.join(wrong[:_SHOWN])}{more}"
    known = [*installed(), *reading.names]
    for address in addresses:
        name = address[1] if len(address) > 1 else ""
        if not type_mistake(name) and name != TF_MESSAGE and not _is_here(name, reading):
            found[address] = _doubt(name, known, reading)
    return found


def _is_here(name: str, reading: Reading) -> bool:
    if name in reading and kind_of(name) == MESSAGE:
        return True
    try:
        import_type(name)
    except BridgeError as error:
        return error.reason is not FailureReason.NOT_FOUND
    return True


def _doubt(name: str, known: list[str], reading: Reading) -> str:
    if name in reading.unread:
        return f"{of_type(name)}{reading.unread[name]}"
    near = get_close_matches(name, known, n=1)
    rest = f"; did you mean {near[0]!r}?" if near else ": build its package"
    if not near and kind_of(name) == MESSAGE:
        rest = ": a node on the topic must describe it"
    return f"no package that is installed here has the type {name!r}{rest}"


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
