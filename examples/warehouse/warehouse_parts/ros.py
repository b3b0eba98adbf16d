"""A vehicle that is a ROS 2 node with an action: commands become paths and goals."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Annotated, Final

from typing_extensions import TypedDict

from uoarm.local import Emit, Range
from warehouse_parts.messages import NOTHING, Command, Metres

__all__ = ["Amr", "Flag", "Odometry", "Result", "Text"]

_AGAIN_SECONDS: Final = 2.0


class Odometry(TypedDict):
    """What a map takes from nav_msgs/Odometry: metres, parts of a quaternion, metres a second."""

    x: Metres
    y: Metres
    qz: float
    qw: float
    speed: Annotated[float, {"x-unit": "m/s"}]


class Text(TypedDict):
    """std_msgs/String."""

    data: str


class Flag(TypedDict):
    """std_msgs/Bool."""

    data: bool


class Number(TypedDict):
    """std_msgs/Int32."""

    data: Annotated[int, Range(-(2**31), 2**31 - 1)]


class Battery(TypedDict):
    """What a map takes from sensor_msgs/BatteryState: per cent."""

    battery: float


class Sequence(TypedDict):
    """The result, or the feedback, of the action."""

    sequence: list[Annotated[int, Range(-(2**31), 2**31 - 1)]]


class Result(TypedDict):
    """How a goal ended."""

    goal_id: str
    status: str
    result: Sequence


class Feedback(TypedDict):
    """A goal goes on."""

    goal_id: str
    feedback: Sequence


class Amr:
    """The component; a state goes out with every odometry once everything else is known.

    A goal without any report is sent again: its node may have been started anew.

    Args:
        payload: kg that the vehicle carries.
    """

    def __init__(self, payload: float) -> None:
        self._command = NOTHING
        self._asked = (0, float("-inf"))
        self._done = 0
        self._payload = payload
        self._known: dict[str, object] = {}

    def command(self, command: Command) -> Iterator[Emit]:
        """Take a command; the path is what keeps the vehicle going and expires."""
        before, self._command = self._command, command
        leg, now = command["leg"], time.monotonic()
        yield Emit("carry", {"data": command["carry"]})
        yield Emit("path", {"leg": leg, "points": command["points"]})
        if not command["points"]:
            if before["points"]:
                yield Emit("cancel", {"goal_id": ""})
            self._asked = (0, now)
        elif leg != self._done and (leg != self._asked[0] or now > self._asked[1]):
            self._asked = (leg, now + _AGAIN_SECONDS)
            yield Emit("goal", {"order": leg})

    def result(self, message: Result) -> None:
        """Take that a goal has ended."""
        if message["status"] == "succeeded":
            self._done = message["result"]["sequence"][0]

    def feedback(self, message: Feedback) -> None:
        """Take that a goal is under way."""
        if message["feedback"]["sequence"][1:] == [self._asked[0]]:
            self._asked = (self._asked[0], time.monotonic() + _AGAIN_SECONDS)

    def battery(self, message: Battery) -> None:
        """Take the charge."""
        self._known["battery"] = message["battery"]

    def load(self, message: Text) -> None:
        """Take what is carried."""
        self._known["load"] = message["data"]

    def localised(self, message: Flag) -> None:
        """Take whether it knows where it is."""
        self._known["is_localised"] = message["data"]

    def blocked(self, message: Flag) -> None:
        """Take whether something stands in its way."""
        self._known["is_blocked"] = message["data"]

    def stopped(self, message: Number) -> None:
        """Take which command to stand it has taken."""
        self._known["stopped"] = message["data"]

    def odometry(self, message: Odometry) -> Emit | None:
        """Take where it is, and say how it is."""
        if len(self._known) < 5:  # noqa: PLR2004 - the five above
            return None
        heading = 2 * math.atan2(message["qz"], message["qw"])
        state = {
            "x": message["x"],
            "y": message["y"],
            "heading": heading,
            "speed": message["speed"],
            **self._known,
            "payload": self._payload,
            "leg": self._done,
            "drives_on": False,
        }
        return Emit("state", state)
