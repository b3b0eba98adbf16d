"""The packages of definitions below a folder, and the order in which they are built."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from attrs import frozen

from uoarm.errors import ConfigurationError

__all__ = ["InterfacePackage", "in_build_order", "packages_in"]

KINDS = ("msg", "srv", "action")
_NAME = re.compile(r"[a-z](_?[a-z0-9]+)*")
_TYPE_NAME = re.compile(r"[A-Z][A-Za-z0-9]*")
_VERSION = re.compile(r"<version[^>]*>\s*(\d+(\.\d+)*)\s*</version>")
_MOST_FILES = 2_000
_MOST_OCTETS = 1 << 20


@frozen
class InterfacePackage:
    """A package's definitions; `files` are relative to `folder`: `msg/Grip.msg`."""

    name: str
    version: str
    folder: Path
    files: tuple[Path, ...]


def packages_in(folder: Path) -> tuple[InterfacePackage, ...]:
    """Return the packages below a folder, which may be one itself: `package/msg/Name.msg`.

    Raises:
        ConfigurationError: there are none, two of one name, too many files, or wrong names.
    """
    if not folder.is_dir():
        raise ConfigurationError(f"{folder} is no folder")
    found: dict[Path, list[Path]] = {}
    for path in sorted(folder.resolve().rglob("*.*")):
        kind = path.parent.name
        if kind in KINDS and path.suffix in {f".{kind}", ".idl"} and path.is_file():
            found.setdefault(path.parents[1], []).append(path)
    if not found:
        raise ConfigurationError(
            f"{folder} has no definitions: expected package/msg/Name.msg, package/srv/Name.srv or "
            f"package/action/Name.action below it"
        )
    number = sum(map(len, found.values()))
    if number > _MOST_FILES:
        raise ConfigurationError(f"{folder} has {number:,} definitions, at most {_MOST_FILES:,}")
    made: dict[str, InterfacePackage] = {}
    for root, paths in found.items():
        package = _package(root, paths)
        if package.name in made:
            both = f"{made[package.name].folder} and {root}"
            raise ConfigurationError(f"package {package.name} is there twice: {both}")
        made[package.name] = package
    return tuple(made.values())


def _package(root: Path, paths: Iterable[Path]) -> InterfacePackage:
    if not _NAME.fullmatch(root.name):
        raise ConfigurationError(f"{root}: {root.name!r} is no name of a ROS package")
    kept: dict[Path, Path] = {}
    for path in paths:
        if not _TYPE_NAME.fullmatch(path.stem):
            raise ConfigurationError(f"{path}: {path.stem!r} is no name of a type, as GripState")
        if path.stat().st_size > _MOST_OCTETS:
            raise ConfigurationError(f"{path} has more than {_MOST_OCTETS:,} octets")
        stem = path.relative_to(root).with_suffix("")
        if path.suffix != ".idl" or stem not in kept:  # an .idl beside its source adds nothing
            kept[stem] = path.relative_to(root)
    manifest = root / "package.xml"
    text = manifest.read_text(encoding="utf-8", errors="replace") if manifest.is_file() else ""
    report = _VERSION.search(text)
    return InterfacePackage(root.name, report[1] if report else "0.0.0", root, tuple(kept.values()))


def in_build_order(needs: Mapping[str, frozenset[str]]) -> tuple[str, ...]:
    """Return packages so that each stands after those that it needs.

    Raises:
        ConfigurationError: some need one another.
    """
    order: list[str] = []
    left = {name: needed & needs.keys() - {name} for name, needed in needs.items()}
    while left:
        ready = sorted(name for name, needed in left.items() if needed <= {*order})
        if not ready:
            raise ConfigurationError(f"packages need one another: {', '.join(sorted(left))}")
        order += ready
        left = {name: needed for name, needed in left.items() if name not in ready}
    return tuple(order)
