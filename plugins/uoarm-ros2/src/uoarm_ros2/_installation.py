"""Which ROS 2 this process uses: told by where rclpy lies and what is installed beside it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping
from importlib.metadata import distributions
from pathlib import Path

from attrs import frozen

__all__ = ["Installation", "Wheel", "absent_middleware", "installation", "wheels"]

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
    """Return the rclpy wheels on the path, as their metadata tells; takes some milliseconds."""
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
