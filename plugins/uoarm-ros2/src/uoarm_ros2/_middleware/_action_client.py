"""rclpy's client of actions, made fit for threads that send while another one takes."""

from __future__ import annotations

import threading
from typing import Any

from rclpy.action import ActionClient

__all__ = ["SharedActionClient"]


class SharedActionClient(ActionClient):  # type: ignore[misc]  # rclpy has no types
    """A client whose every answer finds what waits for it.

    rclpy notes what it waits for after it has sent the request. An answer that another thread takes
    in between belongs to nobody then, and is thrown away: the goal, its result or its end would
    never be told. So nothing is taken while something is sent. Callbacks run without the lock.
    """

    def __init__(self, node: Any, native: Any, name: str) -> None:
        self._sending = threading.Lock()
        super().__init__(node, native, name)

    def take_data(self) -> Any:
        with self._sending:
            return super().take_data()

    def send_goal_async(self, *args: Any, **keywords: Any) -> Any:
        with self._sending:
            return super().send_goal_async(*args, **keywords)

    def _cancel_goal_async(self, goal: Any) -> Any:
        with self._sending:
            return super()._cancel_goal_async(goal)

    def _get_result_async(self, goal: Any) -> Any:
        with self._sending:
            return super()._get_result_async(goal)
