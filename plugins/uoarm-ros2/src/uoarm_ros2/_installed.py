"""What is installed here: the ROS 2 in use, and the message types by name, without rclpy."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping
from functools import lru_cache
from importlib.metadata import distributions
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from attrs import frozen

from uoarm.bridge import did_you_mean
from uoarm.errors import BridgeError, ConfigurationError, FailureReason
from uoarm.model import MessageStructure
from uoarm.plugins import expanded
from uoarm_ros2._options import TF_MESSAGE, Ros2BridgeOptions
from uoarm_ros2._types import (
    ACTION,
    MESSAGE,
    SERVICE,
    import_type,
    installed,
    kind_of,
    of_type,
    shape_of,
    structure_of,
    type_mistake,
)
from uoarm_ros2.definitions import DefinitionReader

_NAME_PARTS = 3


@frozen
class Wheel:
    """An rclpy wheel that is installed somewhere on the path: its distribution and its folder."""

    distribution: str
    folder: Path


@frozen
class Installation:
    """What is in use.

    Attributes:
        distribution: `jazzy` or the like.
        origin: whether it came as wheels or with a ROS 2 installation that was sourced.
        conflict: what is wrong with the mixture of installations, empty where nothing is.
    """

    distribution: str
    origin: str
    conflict: str = ""


def wheels() -> tuple[Wheel, ...]:
    """Return the rclpy wheels on the path, as their metadata says; takes some milliseconds."""
    named = (
        (str(distribution.metadata["Name"]).split("-"), distribution)
        for distribution in distributions()
    )
    found = {
        Wheel(parts[1], Path(str(distribution.locate_file(""))).resolve())
        for parts, distribution in named
        if len(parts) == _NAME_PARTS and (parts[0], parts[2]) == ("ros", "rclpy")
    }
    return tuple(sorted(found, key=lambda wheel: (wheel.distribution, str(wheel.folder))))


def installation(
    rclpy: Path, environment: Mapping[str, str], installed: Iterable[Wheel]
) -> Installation:
    """Return what is in use, given rclpy's folder, the environment and the wheels on the path."""
    here, beside = list[str](), list[Wheel]()
    for wheel in installed:
        if wheel.folder == rclpy.resolve().parent:
            here.append(wheel.distribution)
        elif _on_library_path(wheel, environment):
            beside.append(wheel)
    if not here:
        sourced = environment.get("ROS_DISTRO", "unknown")
        return Installation(sourced, "a ROS 2 installation that was sourced", _mixed(rclpy, beside))
    both = f"wheels of {' and '.join(here)} share {rclpy.parent} and overwrite each other"
    return Installation(", ".join(here), "wheels", both if len(here) > 1 else _mixed(rclpy, beside))


def absent_middleware(environment: Mapping[str, str]) -> str:
    """Say that `RMW_IMPLEMENTATION` names a middleware that is not there; empty: nothing is wrong.

    ROS 2 looks when its library is loaded, and then ends the whole process.
    """
    wanted = environment.get("RMW_IMPLEMENTATION", "")
    path = environment.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    folders = [Path(name) for name in (*path, f"{sys.prefix}/lib") if name]
    has_ros = any((folder / "librcl.so").is_file() for folder in folders)
    there = any((folder / f"lib{wanted}.so").is_file() for folder in folders)
    if not wanted or there or not has_ros:
        return ""
    found = {file.name[3:-3] for folder in folders for file in folder.glob("librmw_*_cpp.so")}
    known = ", ".join(sorted(name for name in found if "__" not in name and "shared" not in name))
    return (
        f"the environment says RMW_IMPLEMENTATION={wanted}, and there is no such middleware, only "
        f"{known or 'none'}: unset the variable, or install the other"
    )


def _on_library_path(wheel: Wheel, environment: Mapping[str, str]) -> bool:
    parts = environment.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    return any(wheel.folder in (Path(part), *Path(part).parents) for part in parts if part)


def _mixed(rclpy: Path, beside: Iterable[Wheel]) -> str:
    """Say that start-up code of the wheels puts their libraries in among those of the other."""
    return "; ".join(
        f"rclpy is that of {rclpy.parent}, and wheels of {wheel.distribution} in {wheel.folder} "
        f"put their libraries beside its own, in any order: uninstall the wheels, or start with "
        f"_ROS_WHEELS_BOOTSTRAP_COMPLETE=1"
        for wheel in beside
    )


_SHOWN = 5


_PARTS = {SERVICE: ("Request", "Response"), ACTION: ("Goal", "Result", "Feedback")}


def structure_of_type(name: str, options: object) -> MessageStructure | None:
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


def doubts(
    options: Ros2BridgeOptions, addresses: frozenset[tuple[str, ...]]
) -> dict[tuple[str, ...], str]:
    """Return what is wrong with definitions, and which addresses name a type that is not here.

    A node may describe such a message type, so that it is a doubt and no mistake. Where there is no
    ROS 2, and so no bridge, nothing is doubted.
    """
    if find_spec("rclpy") is None:
        return {}
    reading = DefinitionReader()
    found: dict[tuple[str, ...], str] = {}
    try:
        for folder in options.definitions:
            reading.take(expanded(folder))
    except ConfigurationError as error:
        found[()] = str(error)
    reading.leave_out_twice()
    wrong = [f"{file}: {why}" for file, why in reading.problems.items()]
    wrong += [f"{name}: {reading.unread[name]}" for name in reading.twice]
    if wrong:
        more = f"; and {len(wrong) - _SHOWN} more" if len(wrong) > _SHOWN else ""
        found[()] = f"types of definitions cannot be used: {'; '.join(wrong[:_SHOWN])}{more}"
    for address in addresses:
        name = address[1] if len(address) > 1 else ""
        if not type_mistake(name) and name != TF_MESSAGE and not _is_here(name, reading):
            found[address] = _doubt(name, reading)
    return found


def _is_here(name: str, reading: DefinitionReader) -> bool:
    if name in reading and kind_of(name) == MESSAGE:
        return True
    try:
        import_type(name)
    except BridgeError as error:
        return error.reason is not FailureReason.NOT_FOUND
    return True


def _doubt(name: str, reading: DefinitionReader) -> str:
    if name in reading.unread:
        return f"{of_type(name)}{reading.unread[name]}"
    if kind_of(name) == MESSAGE:
        known = [*installed(), *reading.names]
        rest = did_you_mean(name, known) or ": a node on the topic must describe it"
    else:  # of definitions only messages can be used
        defined = {_part_of(part, kind_of(part))[0] for part in reading.names}
        rest = "" if name in defined else did_you_mean(name, installed())
        rest = rest or ": build its package"
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
