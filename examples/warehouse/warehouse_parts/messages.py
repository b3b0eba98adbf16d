"""What every vehicle takes and says, whatever its framework."""

from __future__ import annotations

from typing import Annotated

from typing_extensions import TypedDict

__all__ = ["NOTHING", "Command", "Point", "State"]

Metres = Annotated[float, {"x-unit": "m", "x-frame": "floor"}]


class Point(TypedDict):
    """A node of the floor."""

    node: str
    x: Metres
    y: Metres


class Command(TypedDict):
    """Drive along these points, then carry this box; without points, stand still."""

    leg: int
    points: list[Point]
    carry: str


class State(TypedDict):
    """A vehicle's state; `warehouse_orders.coordinator.Report` has its fields in words."""

    x: Metres
    y: Metres
    heading: Annotated[float, {"x-unit": "rad", "x-frame": "floor"}]
    speed: Annotated[float, {"x-unit": "m/s"}]
    battery: Annotated[float, {"x-unit": "%"}]
    payload: Annotated[float, {"x-unit": "kg"}]
    load: str
    leg: int
    stopped: int
    is_localised: bool
    is_blocked: bool
    drives_on: bool


NOTHING: Command = {"leg": 0, "points": [], "carry": ""}
"""The command of a vehicle when no client has one: to stand still."""
