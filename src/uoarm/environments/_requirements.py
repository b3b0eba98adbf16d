"""What an environment needs: this same uoarm, a plugin, and the plugin's middleware."""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.metadata import Distribution, entry_points
from pathlib import Path

from uoarm._origin import installed, origin_of
from uoarm.environments._repack import repack
from uoarm.errors import PluginError

__all__ = ["extras_of", "handed_on", "requirements", "unknown_extra"]

_GROUP = "uoarm.bridges"
_CORE = "uoarm"
_WITH_EXTRAS = re.compile(r"([A-Za-z0-9._-]+)\[([^\]]*)\]")
_PINNED = re.compile(r"([A-Za-z0-9._-]+)(\[[^\]]*\])?==([^ ;]+)")


def requirements(plugin: str, version: str | None, more: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return the requirements of an environment for one plugin.

    What is installed here as an editable project is that project there, too; anything else is
    pinned to its version, for which `create` gives the files that are installed here.

    Args:
        plugin: name of the bridge type, `ros2`.
        version: version of its middleware, `jazzy`: an extra of the plugin's distribution.
        more: requirements to add, as pip reads them; a path of a project stands for itself.

    Raises:
        PluginError: the plugin is installed here, and says that it has no such version; or it is
            among the further requirements without its version, which nothing would install.
    """
    ours = _requirement(installed(_CORE), _CORE, "hosts")
    point = next((entry for entry in entry_points(group=_GROUP) if entry.name == plugin), None)
    provider = None if point is None else point.dist
    if provider is not None and provider.name == _CORE:
        if version is not None:
            raise PluginError(f"the plugin {plugin} has no middleware: leave {version!r} out")
        return (ours, *more)
    if provider is not None and version is not None:
        _require_extra(provider, version)
    given = [name for name in more if _names(name, f"uoarm-{plugin}")] if provider is None else []
    if given:
        asks = re.compile(rf"\[([^\]]*,)?\s*{re.escape(version or '')}\s*[,\]]")
        if version is not None and not any(map(asks.search, given)):
            text = f"{given[0]} stands for the plugin, and does not ask for {version!r}"
            raise PluginError(f"{text}: expected [{version}] after its name or path")
        return (ours, *more)
    return (ours, _requirement(provider, f"uoarm-{plugin}", version), *more)


def handed_on(requirement: str, folder: Path) -> str:
    """Return a requirement with the wheel of what is installed here, where it is pinned to that.

    Only uoarm and its plugins are handed on; everything else comes from an index.

    Args:
        requirement: as `requirements` returns it.
        folder: where the wheel is written.
    """
    pinned = _PINNED.fullmatch(requirement)
    found = None if pinned is None else installed(pinned[1])
    if pinned is None or found is None or found.version != pinned[3] or not _is_ours(found):
        return requirement
    wheel = repack(found, folder)
    return requirement if wheel is None else f"{pinned[1]}{pinned[2] or ''} @ {wheel.as_uri()}"


def extras_of(requirements: Iterable[str]) -> dict[str, list[str]]:
    """Return the extras that requirements name, by project; those of paths are not known."""
    found = (_WITH_EXTRAS.match(requirement) for requirement in requirements)
    return {match[1]: re.findall(r"[A-Za-z0-9._-]+", match[2]) for match in found if match}


def unknown_extra(name: str, extra: str, known: Iterable[str]) -> str:
    """Return that a project has no such extra, and which it has."""
    there = ", ".join(text for text in known if text != "dev")
    what = "distribution" if name.startswith(f"{_CORE}-") else "extra"
    return f"{name} has no {what} {extra!r}: there are {there or 'none'}"


def _require_extra(provider: Distribution, extra: str) -> None:
    """Pip only warns of an extra that a distribution has not."""
    known = provider.metadata.get_all("Provides-Extra") or []
    if extra not in known:
        raise PluginError(unknown_extra(provider.name, extra, known))


def _is_ours(found: Distribution) -> bool:
    return found.name == _CORE or any(point.group == _GROUP for point in found.entry_points)


def _requirement(found: Distribution | None, name: str, extra: str | None) -> str:
    if found is not None:
        name = found.name
    wanted = f"{name}[{extra}]" if extra else name
    origin = origin_of(name)
    if origin is not None and (origin.editable or found is None):
        return f"{wanted} @ {origin.path.as_uri()}"
    return wanted if found is None else f"{wanted}=={found.version}"


def _names(requirement: str, project: str) -> bool:
    """Say whether a requirement names a project or is the path of its folder or of its wheel."""
    longer = "(?![A-Za-z0-9]|-[A-Za-z])"  # uoarm-ros2 does not stand for uoarm-ros
    return re.search(re.escape(project) + longer, requirement.replace("_", "-")) is not None
