"""Native types by name: message packages are found when they are needed, by import."""

from __future__ import annotations

import importlib
import re
from difflib import get_close_matches

from uoarm.errors import BridgeError, FailureReason

__all__ = ["ACTION", "MESSAGE", "SERVICE", "import_type", "kind_of", "of_type", "type_mistake"]

MESSAGE, SERVICE, ACTION = "msg", "srv", "action"
_NAME = re.compile(r"[a-z][a-z0-9_]*/(msg|srv|action)/[A-Z][A-Za-z0-9_]*")


def type_mistake(name: str) -> str:
    """Return what is wrong with the spelling of a type's name, or ""."""
    if _NAME.fullmatch(name):
        return ""
    package, _, rest = name.partition("/")
    meant = f"{package}/msg/{rest}"
    hint = f"; did you mean {meant!r}?" if _NAME.fullmatch(meant) else ""
    spelt = "package/msg/Name, package/srv/Name or package/action/Name"
    return f"type {name!r} is not spelt {spelt}{hint}"


def kind_of(name: str) -> str:
    """Return `msg`, `srv` or `action` of a well spelt type."""
    return name.split("/")[1]


def of_type(name: str) -> str:
    """Return what the errors about a type begin with."""
    return f"type {name!r}: "


def import_type(name: str) -> type:
    """Return the generated class of a type such as `sensor_msgs/msg/Image`.

    Raises:
        BridgeError: the package is not installed, or has no such type.
    """
    package, kind, type_name = name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
    except ImportError as error:
        missing = f"{package}.{kind}" if error.name is None else error.name
        text = (
            f"{of_type(name)}Python package {missing!r} cannot be imported ({error}); install "
            f"ros-<distribution>-{package.replace('_', '-')} (as ros-jazzy-...), have `uoarm ros2 "
            f"build-interfaces` build it of its definitions, or source the workspace that "
            f"provides {package!r}"
        )
        raise BridgeError(text, FailureReason.NOT_FOUND) from error
    found = getattr(module, type_name, None)
    if not isinstance(found, type):
        known = sorted(variable for variable in vars(module) if variable[:1].isupper())
        near = get_close_matches(type_name, known, n=1)
        meant = f"; did you mean {near[0]!r}?" if near else f", only {known}"
        text = f"{of_type(name)}package {package!r} has no {kind} {type_name!r}{meant}"
        raise BridgeError(text, FailureReason.NOT_FOUND)
    return found
