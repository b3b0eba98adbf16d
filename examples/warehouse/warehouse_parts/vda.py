"""A vehicle that speaks VDA 5050: commands become transport orders, a stop their cancellation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from time import monotonic
from typing import Any, Final

from typing_extensions import TypedDict

from uoarm.local import Emit, structure
from uoarm.model import Message
from warehouse_parts.messages import NOTHING, Command, Point

__all__ = ["Agv", "Ended"]

_AGAIN_SECONDS: Final = 2.0
_MOST_CANCELS: Final = 5
_NEAR_METRES: Final = 1.5  # to the first node, at which an order begins
_MAP: Final = "floor"


class Ended(TypedDict):
    """What became of an order."""

    goal_id: str
    status: str


class Agv:
    """The component; a state goes out with every state of the vehicle.

    The standard has one order at a time, so that one is cancelled and has ended before the next.
    An order that did not get through is given again under another number.

    Args:
        payload: kg that the vehicle carries.
    """

    def __init__(self, payload: float) -> None:
        self._command = NOTHING
        self._payload = payload
        self._load = ""
        self._done = 0
        self._attempts = 0
        self._order = ""
        self._is_accepted = False
        self._again = float("-inf")
        self._cancelled = 0

    def command(self, command: Command) -> Iterator[Emit]:
        """Take a command; one that is taken again changes nothing."""
        leg = command["leg"]
        self._command, now = command, monotonic()
        wanted = str(leg) if command["points"] and leg != self._done else ""
        if now < self._again:
            return
        if self._order and self._order.partition("-")[0] != wanted:
            self._again = now + _AGAIN_SECONDS
            yield Emit("cancel", {"goal_id": self._order})
            self._cancelled += 1
            if self._cancelled > _MOST_CANCELS:
                self._forget()  # it is not known
        elif wanted and not self._is_accepted:
            # A goal that did not get through is given again: the same order is taken once.
            self._again = now + _AGAIN_SECONDS
            if not self._order:
                self._attempts += 1
                self._order = f"{leg}-{self._attempts}"
            yield Emit("goal", {"orderId": self._order, "nodes": self._nodes(command)})

    def status(self, message: Ended) -> None:
        """Take that the order is under way, or how it ended."""
        status = message["status"]
        if message["goal_id"] != self._order:
            return
        if status == "accepted":
            self._is_accepted = True
            return
        if status == "succeeded":
            self._done = int(self._order.partition("-")[0])
        self._forget()
        if status not in {"succeeded", "canceled"}:
            self._again = monotonic() + _AGAIN_SECONDS

    def _forget(self) -> None:
        self._order, self._is_accepted, self._cancelled = "", False, 0
        self._again = float("-inf")

    @structure(input={"type": "object"})
    def state(self, message: Message) -> Emit | None:
        """Take how it is, and say it in our words."""
        position = message.get("agvPosition", message.get("mobileRobotPosition"))
        if position is None:
            return None
        loads = message.get("loads") or []
        self._load = loads[0].get("loadId", "") if loads else ""
        velocity = message.get("velocity") or {}
        state = {
            "x": float(position["x"]),
            "y": float(position["y"]),
            "heading": float(position["theta"]),
            "speed": float(velocity.get("vx", 0.0)),
            "battery": _battery(message),
            "payload": self._payload,
            "load": self._load,
            "leg": self._done,
            "stopped": 0
            if self._order or self._command["points"] or _is_busy(message)
            else self._command["leg"],
            "is_localised": position.get("positionInitialized", position.get("localized", False)),
            "is_blocked": "blockedPath" in {error["errorType"] for error in message["errors"]},
            "drives_on": True,
        }
        return Emit("state", state)

    def _nodes(self, command: Command) -> list[dict[str, Any]]:
        """Return the nodes of an order, with what is to be done at the last one."""
        nodes = [_node(point) for point in command["points"]]
        nodes[0]["nodePosition"]["allowedDeviationXY"] = _NEAR_METRES
        carry = command["carry"]
        if carry != self._load:
            box = {"key": "loadId", "value": carry or self._load}
            action = {"actionType": "pick" if carry else "drop", "actionParameters": [box]}
            nodes[-1]["actions"] = [action]
        return nodes


def _node(point: Point) -> dict[str, Any]:
    position = {"x": point["x"], "y": point["y"], "mapId": _MAP}
    return {"nodeId": point["node"], "nodePosition": position}


def _is_busy(message: Mapping[str, Any]) -> bool:
    """Whether it has an order, from any client and at any time."""
    states = message.get("actionStates") or ()
    acts = any(state["actionStatus"] not in {"FINISHED", "FAILED"} for state in states)
    return bool(message.get("nodeStates") or message.get("edgeStates") or acts)


def _battery(message: Mapping[str, Any]) -> float:
    """Return the charge in per cent: releases 2 and 3 name it differently."""
    if "batteryState" in message:
        return float(message["batteryState"]["batteryCharge"])
    return float(message["powerSupply"]["stateOfCharge"])
