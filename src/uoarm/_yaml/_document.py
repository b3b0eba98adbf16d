"""A configuration as plain values, and the place of each of its parts."""

from __future__ import annotations

from typing import TypeAlias

from attrs import define, field, frozen

from uoarm._yaml._problem import Place, Problem

__all__ = ["Document", "Path", "Spot"]

Path: TypeAlias = "tuple[str | int, ...]"


@define(eq=False)
class Spot:
    """Where one value stands, and in a mapping its key; `parts` mirrors what is inside it.

    A tree beside the values costs the same memory at every depth, where a table by path does not.
    """

    place: Place
    key: Place | None = None
    parts: dict[str, Spot] | list[Spot] | None = None


@frozen
class Document:
    """What was read of a file.

    Attributes:
        value: dicts, lists, strings, numbers, booleans, None.
        root: places of the value and all that is in it.
        problems: what is wrong with the file as YAML.
        whole: reading got to the end; else `value` says nothing.
        text: what was read, without a byte order mark.
    """

    value: object
    root: Spot
    problems: tuple[Problem, ...] = ()
    whole: bool = True
    text: str = field(default="", eq=False, repr=False)

    def place(self, path: Path) -> Place:
        """Return the place of the value at a path, or of the nearest value around it."""
        return self._spot(path)[0].place

    def key_place(self, path: Path) -> Place:
        """Return the place of the key at the end of a path, or of its value where it has none."""
        spot, found = self._spot(path)
        return spot.key if found and spot.key is not None else spot.place

    def _spot(self, path: Path) -> tuple[Spot, bool]:
        spot = self.root
        for part in path:
            inner: Spot | None = None
            if isinstance(spot.parts, dict) and isinstance(part, str):
                inner = spot.parts.get(part)
            elif isinstance(spot.parts, list) and isinstance(part, int):
                inner = spot.parts[part] if part < len(spot.parts) else None
            if inner is None:
                return spot, False
            spot = inner
        return spot, True
