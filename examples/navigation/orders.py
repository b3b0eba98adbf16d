"""A component that takes the goals of Nav2, and has a vehicle of VDA 5050 drive to them.

A goal becomes a transport order, and what becomes of the order an answer as Nav2 gives it. The
component is itself an application of another robot, in fleet.yaml, whose functions it requests.
"""

from __future__ import annotations

import math
import queue
import threading
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypedDict

from uoarm import QueuePolicy, RobotManager
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.local import Emit, structure

HERE = Path(__file__).parent
_STATE_SECONDS = 5.0
_NOT_REACHED = 1


class Cancel(TypedDict):
    """Which goal is not wanted any more."""

    goal_id: str


class Orders:
    """One vehicle. It is lost when the vehicle is, so that another component takes its place.

    Raises:
        UoarmError: the vehicle is not there.
    """

    def __init__(self) -> None:
        self._news: queue.SimpleQueue[Emit | Exception | None] = queue.SimpleQueue()
        self._goals: dict[str, tuple[float, float]] = {}  # where each order leads
        self._accepted = ""  # before that is known nothing else is said of an order
        self._robot = RobotManager.from_file(HERE / "fleet.yaml")
        try:
            self._states = self._robot.request("state", queue=QueuePolicy(1))
            self._status = self._robot.request("transport.status")
            self._robot.request("transport.feedback", on_message=self._report)
            self._robot.request("transport.result", on_message=self._end)
        except BaseException:
            self._robot.close()
            raise
        threading.Thread(target=self._follow, daemon=True).start()

    @structure(input={"type": "object"})
    def goal(self, goal: Any) -> Emit | None:
        """Give the vehicle an order: from where it is to the pose."""
        pose, order = goal["pose"], uuid.uuid4().hex
        x, y = (pose["pose"]["position"][axis] for axis in "xy")
        try:
            state = self._states.get(timeout=_STATE_SECONDS)
        except TimeoutError:  # whose order would begin nowhere
            return Emit("status", {"goal_id": order, "status": "rejected"})
        at = state["agvPosition"]
        here = {"x": at["x"], "y": at["y"], "mapId": at["mapId"]}
        there = {"x": x, "y": y, "mapId": pose["header"]["frame_id"]}
        nodes = [
            {"nodeId": state["lastNodeId"] or "start", "nodePosition": here},
            {"nodeId": order, "nodePosition": there},
        ]
        self._goals[order] = x, y
        self._status.send({"orderId": order, "nodes": nodes}, "goal")
        return None

    def cancel(self, cancel: Cancel) -> None:
        """Cancel an order."""
        self._status.send({"goal_id": cancel["goal_id"]}, "cancel")

    def __iter__(self) -> Iterator[Emit]:
        """Yield what becomes of orders until the vehicle is lost."""
        while (news := self._news.get()) is not None:
            if isinstance(news, Exception):
                raise news
            yield news

    def close(self) -> None:
        """Let the vehicle go: what it was ordered to do it does."""
        self._robot.close()
        self._news.put(None)

    def _follow(self) -> None:
        lost: Exception = BridgeError("the vehicle is offline", FailureReason.UNAVAILABLE)
        try:
            for message in self._status:
                self._accepted = message["goal_id"]
                self._news.put(Emit("status", message))
        except UoarmError as error:
            lost = error
        self._news.put(lost)

    def _report(self, message: Any) -> None:
        at = message["feedback"].get("position")
        goal = self._goals.get(message["goal_id"])
        if at is not None and goal is not None and self._accepted == message["goal_id"]:
            left = math.dist(goal, (at["x"], at["y"]))
            feedback = {"goal_id": message["goal_id"], "feedback": {"distance_remaining": left}}
            self._news.put(Emit("feedback", feedback))

    def _end(self, message: Any) -> None:
        self._goals.pop(message["goal_id"], None)
        is_there = message["status"] == "succeeded"
        result = {
            "error_code": 0 if is_there else _NOT_REACHED,
            "error_msg": "" if is_there else message["result"]["reason"],
        }
        self._news.put(Emit("result", {**message, "result": result}))
