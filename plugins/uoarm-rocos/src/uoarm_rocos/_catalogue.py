"""Catalogues: which APIs a device offers, and how two catalogues differ."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from attrs import field, frozen

from uoarm_rocos._fields import Fields

__all__ = ["PROFILE", "Api", "Catalogue", "Kind", "differences"]

PROFILE = 1


class Kind(Enum):
    """How an API is used."""

    SERVICE = "service"
    FLOW = "flow"


@frozen
class Api:
    """One API of a device.

    Attributes:
        name: what hosts ask for.
        kind: a service answers calls; a flow sends its output, takes its input, or both.
        input: what it takes.
        output: what it gives.
        period: seconds between two messages of a flow; None: whenever there is something.
        text: a description for people.
    """

    name: str
    kind: Kind
    input: Fields = field(factory=dict, hash=False)
    output: Fields = field(factory=dict, hash=False)
    period: float | None = None
    text: str = ""


@frozen
class Catalogue:
    """What one device offers; `heartbeat` is its period in seconds."""

    device: str
    apis: Mapping[str, Api] = field(factory=dict, hash=False)
    revision: str = ""
    heartbeat: float = 1.0


def differences(before: Catalogue, after: Catalogue) -> dict[str, str]:
    """Return a sentence for each API that is gone, new, or not what it was.

    Descriptions and the order of fields are no difference.
    """
    found = {}
    for name in sorted(before.apis.keys() | after.apis.keys()):
        old, new = before.apis.get(name), after.apis.get(name)
        if old is None or new is None:
            found[name] = f"API {name!r} is {'gone' if new is None else 'new'}"
            continue
        parts = [
            f"{part} was {_told(getattr(old, part))}, is {_told(getattr(new, part))}"
            for part in ("kind", "period")
            if getattr(old, part) != getattr(new, part)
        ]
        for part in ("input", "output"):
            parts += _changed(part, getattr(old, part), getattr(new, part))
        if parts:
            found[name] = f"API {name!r} changed: {'; '.join(parts)}"
    return found


def _changed(part: str, old: Fields, new: Fields) -> list[str]:
    sentences = []
    for name in sorted(old.keys() | new.keys()):
        if name not in new:
            sentences.append(f"{part}.{name} is gone")
        elif name not in old:
            sentences.append(f"{part}.{name} is new")
        elif old[name] != new[name]:
            sentences.append(f"{part}.{name} was {old[name]}, is {new[name]}")
    return sentences


def _told(value: object) -> str:
    return str(value.value if isinstance(value, Enum) else value)
