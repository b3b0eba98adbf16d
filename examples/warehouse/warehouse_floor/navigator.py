"""Drives a base along points: turns towards the next one, drives, and slows down before the end.

A plain function of what is seen now and of how far one has come, used by the vehicles that find
their own way and by the components that steer one from outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

from attrs import frozen

__all__ = ["STAND", "Driver", "Point", "Step", "drive_along"]

Point: TypeAlias = tuple[float, float]
STAND: Final = (0.0, 0.0, 0.0)

_NEAR: Final = 0.08
_PASSED: Final = 0.2
_FASTEST: Final = 1.3
_BRAKE: Final = 0.8
_BRAKE_STEERED: Final = (
    0.5  # from outside: blind for the lifetime of a velocity it overshoots 0.2 m
)
_TURN_GAIN, _MOST_TURN = 3.0, 2.0
_ALIGNED: Final = 0.15
_STRAIGHT: Final = 1e-6


@frozen
class Step:
    """What to do now.

    Attributes:
        velocity: forward, left, turn.
        passed: how many of the points were reached.
        is_there: whether the last one was.
    """

    velocity: tuple[float, float, float]
    passed: int
    is_there: bool


def drive_along(
    points: Sequence[Point], passed: int, pose: tuple[float, float, float], *, sideways: bool
) -> Step:
    """Return the next command for a base.

    Args:
        points: to be visited one after the other, in metres.
        passed: how many of them were reached before.
        pose: metres, metres, radians.
        sideways: whether the base can move in every direction without turning.
    """
    x, y, heading = pose
    while passed < len(points) and _is_reached(points, passed, x, y):
        passed += 1
    if passed == len(points):
        return Step(STAND, passed, is_there=True)
    ahead, aside = points[passed][0] - x, points[passed][1] - y
    brake = _BRAKE_STEERED if sideways else _BRAKE
    speed = min(_FASTEST, math.sqrt(2 * brake * _straight_on(points, passed, x, y)))
    bearing = (math.atan2(aside, ahead) - heading + math.pi) % (2 * math.pi) - math.pi
    if sideways:
        velocity = (speed * math.cos(bearing), speed * math.sin(bearing), 0.0)
        return Step(velocity, passed, is_there=False)
    turn = max(-_MOST_TURN, min(_MOST_TURN, _TURN_GAIN * bearing))
    return Step((speed if abs(bearing) < _ALIGNED else 0.0, 0.0, turn), passed, is_there=False)


class Driver:
    """Carries out one leg after another: drives along its points, then carries what it shall.

    Args:
        sideways: whether the base can move in every direction without turning.

    Attributes:
        done: the last leg that was carried out.
        carry: the box that the base shall carry now.
    """

    def __init__(self, *, sideways: bool = False) -> None:
        self.done = 0
        self.carry = ""
        self._sideways = sideways
        self._leg = 0
        self._points: Sequence[Point] = ()
        self._passed = 0

    def go(self, leg: int, points: Sequence[Point]) -> None:
        """Take a leg, or take it again: then nothing changes. Without points it stands still."""
        if leg != self._leg:
            self._leg, self._points, self._passed = leg, (), 0
        if not self._points or not points:
            self._points, self._passed = tuple(points), 0

    def step(self, pose: tuple[float, float, float], load: str, carry: str) -> Step:
        """Return what to do now.

        Args:
            pose: metres, metres, radians.
            load: the box that the base carries.
            carry: the one that it shall carry at the end of the leg.
        """
        if not self._points:
            self.carry = load
            return Step(STAND, 0, is_there=False)
        step = drive_along(self._points, self._passed, pose, sideways=self._sideways)
        self._passed = step.passed
        self.carry = carry if step.is_there else load
        if step.is_there and load == carry:
            self.done = self._leg
        return step


def _is_reached(points: Sequence[Point], index: int, x: float, y: float) -> bool:
    """A point within a straight line is reached as it is passed; a corner, where one stands."""
    near = _PASSED if _goes_straight(points, index) else _NEAR
    return math.hypot(points[index][0] - x, points[index][1] - y) < near


def _goes_straight(points: Sequence[Point], index: int) -> bool:
    if not 0 < index < len(points) - 1:
        return False
    (a, b), (c, d), (e, f) = points[index - 1 : index + 2]
    return (
        abs((c - a) * (f - d) - (d - b) * (e - c)) < _STRAIGHT
        and (c - a) * (e - c) + (d - b) * (f - d) > 0
    )


def _straight_on(points: Sequence[Point], index: int, x: float, y: float) -> float:
    """Return the metres until one must stand: to the next corner, or the end."""
    metres = math.hypot(points[index][0] - x, points[index][1] - y)
    while _goes_straight(points, index):
        metres += math.dist(points[index], points[index + 1])
        index += 1
    return metres
