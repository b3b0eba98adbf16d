"""Pretending that a package is not installed, to see what is chosen in its place."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

__all__ = ["hide"]


class _Hidden:
    """A finder that answers for one package: there is none."""

    def __init__(self, package: str) -> None:
        self._package = package

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        del path, target
        if name.partition(".")[0] == self._package:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


def hide(package: str) -> None:
    """Make every later import of a package fail as if it were not installed."""
    sys.meta_path.insert(0, _Hidden(package))
