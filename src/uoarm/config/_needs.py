"""Mistakes in what functions need of components that bridges discover."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from uoarm._yaml import Path, clip
from uoarm.config._parts import bridge_names, function_names, needs

__all__ = ["need_mistakes", "unknown_frameworks"]

_TELLING = ("structure", "request", "reply", "like", "name", "port", "label")


def need_mistakes(value: object) -> Iterator[tuple[Path, str, str, bool]]:
    """Yield where each mistake is, its sentence, a hint, and whether it is about the key."""
    for name, function in function_names(value).items():
        if isinstance(function, dict) and not {"components", "needs"} & function.keys():
            hint = "it has no candidates"
            yield ("functions", name), "components or needs is missing", hint, True
    for name, need in needs(value).items():
        path: Path = ("functions", name, "needs")
        if not any(key in need for key in _TELLING):
            yield path, "it does not say what is needed", f"one of {', '.join(_TELLING)}", True
        if "like" in need and "structure" in need:
            yield (*path, "like"), "give either structure or like, not both", "", True
        if need.get("like") == name:
            hint = "name another function, or a type of messages"
            yield (*path, "like"), "the function is like itself", hint, False
        is_service = need.get("role") == "service"
        for key in ("request", "reply"):
            if key in need and not is_service:
                yield (*path, key), f"only a service has a {key}", "add role: service", True
        if is_service and "structure" in need:
            hint = "give request, reply or both"
            yield (*path, "structure"), "a service has no structure of its own", hint, True


def unknown_frameworks(value: object) -> Iterator[tuple[Path, str]]:
    """Yield what `prefer` and `exclude` name and the file does not have."""
    bridges = bridge_names(value)
    plugins = {bridge.get("plugin") for bridge in bridges.values() if isinstance(bridge, dict)}
    for name, need in needs(value).items():
        for key in ("prefer", "exclude"):
            for word in _several(need.get(key)):
                if word not in bridges and word not in plugins:
                    sentence = f"no bridge is named {clip(word)}, and none has such a plugin"
                    yield ("functions", name, "needs", key), sentence


def _several(value: Any) -> list[str]:
    written = [value] if isinstance(value, str) else value
    return [item for item in written if isinstance(item, str)] if isinstance(written, list) else []
