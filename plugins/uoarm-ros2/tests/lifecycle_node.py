"""An ordinary lifecycle node of rclpy, which notes what it is asked."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_msgs.msg import Int64
from std_srvs.srv import SetBool

_GOOD, _BAD = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class Numbers(LifecycleNode):  # type: ignore[misc]  # rclpy has no types
    """Publishes numbers while it is active; `late` is declared when it is configured.

    Args:
        name: of the node.
        topic: where it publishes.
        fails: a transition that fails, or raises where an exclamation mark follows.
    """

    def __init__(self, name: str, topic: str, fails: str = "") -> None:
        super().__init__(name)
        self.topic = topic
        self.fails = fails
        self.asked: list[str] = []
        self.gains: list[float] = []
        self.writes = 0
        gain = FloatingPointRange(from_value=0.0, to_value=10.0)
        rate = IntegerRange(from_value=10, to_value=100, step=10)
        self.declare_parameter("gain", 1.0, ParameterDescriptor(floating_point_range=[gain]))
        self.declare_parameter("rate", 100, ParameterDescriptor(integer_range=[rate]))
        self.declare_parameter("serial", "A1", ParameterDescriptor(read_only=True))
        self.declare_parameter("camera.names", ["left"])
        self.add_on_set_parameters_callback(self._judge)
        self.number = 0
        self.timer: Any = None

    def _judge(self, parameters: list[Parameter]) -> SetParametersResult:
        if any(
            parameter.name == "camera.names" and "top" in parameter.value
            for parameter in parameters
        ):
            return SetParametersResult(successful=False, reason="there is no camera on top")
        self.writes += sum(self.has_parameter(parameter.name) for parameter in parameters)
        return SetParametersResult(successful=True)

    def _end(self, step: str, begun: Any) -> Any:
        self.asked.append(step)
        if self.fails == f"{step}!":
            raise RuntimeError(f"{step} is broken")
        return _BAD if self.fails == step else begun

    def on_configure(self, state: Any) -> Any:
        self.gains.append(self.get_parameter("gain").value)
        if not self.has_parameter("late"):
            self.declare_parameter("late", 0)
        self.out = self.create_lifecycle_publisher(Int64, self.topic, 10)
        self.switch = self.create_service(SetBool, f"{self.topic}_switch", self._switched)
        return self._end("configure", super().on_configure(state))

    def _switched(self, request: Any, reply: Any) -> Any:
        reply.success, reply.message = request.data, f"late {self.get_parameter('late').value}"
        return reply

    def on_activate(self, state: Any) -> Any:
        self.timer = self.create_timer(0.02, self._publish)
        return self._end("activate", super().on_activate(state))

    def on_deactivate(self, state: Any) -> Any:
        self.destroy_timer(self.timer)
        return self._end("deactivate", super().on_deactivate(state))

    def on_cleanup(self, state: Any) -> Any:
        self.destroy_lifecycle_publisher(self.out)
        self.destroy_service(self.switch)
        return self._end("cleanup", _GOOD)

    def on_error(self, state: Any) -> Any:
        self.asked.append("error")
        return _GOOD

    def _publish(self) -> None:
        self.number += 1
        self.out.publish(Int64(data=self.number))
