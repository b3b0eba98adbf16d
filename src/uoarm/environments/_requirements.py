"""What an environment needs: this same uoarm, a plugin, and the plugin's middleware."""

from __future__ import annotations

import json
import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution, entry_points

__all__ = ["requirements"]

_GROUP = "uoarm.bridges"


def requirements(plugin: str, version: str | None, more: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return the requirements of an environment for one plugin.

    What is installed here from a folder is taken from that folder there, too.

    Args:
        plugin: name of the bridge type, `ros2`.
        version: version of its middleware, `jazzy`: an extra of the plugin's distribution.
        more: requirements to add, as pip reads them; a path of a project stands for itself.
    """
    ours = _requirement(_find("uoarm"), "uoarm", "hosts")
    point = next((one for one in entry_points(group=_GROUP) if one.name == plugin), None)
    provider = None if point is None else point.dist
    if provider is not None and provider.name == "uoarm":
        return (ours, *more)
    if provider is None and any(_names(one, f"uoarm-{plugin}") for one in more):
        return (ours, *more)
    return (ours, _requirement(provider, f"uoarm-{plugin}", version), *more)


def _find(name: str) -> Distribution | None:
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


def _requirement(found: Distribution | None, name: str, extra: str | None) -> str:
    if found is not None:
        name = found.name
    if extra:
        name = f"{name}[{extra}]"
    if found is None:
        return name
    place = _folder(found)
    return f"{name} @ {place}" if place else f"{name}=={found.version}"


def _folder(found: Distribution) -> str:
    """Return the folder that a distribution was installed from as a URL (PEP 610), or nothing."""
    said = json.loads(found.read_text("direct_url.json") or "{}")
    url = said.get("url", "") if "dir_info" in said else ""
    return url if isinstance(url, str) else ""


def _names(requirement: str, project: str) -> bool:
    """Say whether a requirement names a project or is the path of its folder or of its wheel."""
    longer = "(?![A-Za-z0-9]|-[A-Za-z])"  # uoarm-ros2 does not stand for uoarm-ros
    return re.search(re.escape(project) + longer, requirement.replace("_", "-")) is not None
