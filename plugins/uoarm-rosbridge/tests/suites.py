"""What a real rosbridge_suite must do, of ROS 1 and of ROS 2, and how its tests address it."""

from __future__ import annotations

from typing import Any

from played import stream
from tests.server.talk import eventually  # type: ignore[import-not-found]

from uoarm.bridge import Bridge, Registry
from uoarm.errors import BridgeError
from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing import Collector, patience

WIDTH, HEIGHT = 64, 48


def made(address: str, **options: object) -> Bridge:
    given = {"url": address, "check": 0.2, "wait": min(patience(), 60), **options}
    return Registry().create(BridgeSpec("far", "rosbridge", given))


def at(role: Role, *address: str, **options: object) -> Endpoint:
    return Endpoint("far", "behind", role, address, options=options)


def is_there(bridge: Bridge, endpoint: Endpoint) -> bool:
    try:
        bridge.describe(endpoint)
    except BridgeError:
        return False
    return True


class EitherSuite:
    """What holds of both.

    Attributes:
        set_bool: the type of a service that is offered.
        parameter: the address of a parameter.
    """

    set_bool: str
    parameter: str

    def test_what_is_sent_comes_back_in_order(self, bridge: Bridge) -> None:
        asked, echoed = at(Role.INPUT, "/behind/asked"), at(Role.OUTPUT, "/behind/echoed")
        collector = Collector()
        structure = stream(bridge, asked)
        bridge.open_source(echoed, structure, collector.deliver)
        sink = bridge.open_sink(asked, structure)

        def has_come() -> bool:  # ROS connects nodes when it likes, of which rosbridge says nothing
            sink.send({"data": "first"})
            return bool(collector.messages)

        eventually(has_come, "the topics are connected")
        sent: list[Message] = [{"data": f"Kia ora ä {number}"} for number in range(200)]
        for message in sent:  # one at a time: of a burst the server loses some, and does not say so
            sink.send(message)
            eventually(lambda message=message: collector.messages[-1] == message, "it comes")
        assert [message for message in collector.messages if message != {"data": "first"}] == sent
        assert sink.drain(patience())

    def test_what_has_an_array_of_a_fixed_size_comes_too(self, bridge: Bridge) -> None:
        fix, collector = at(Role.OUTPUT, "/behind/fix"), Collector()
        eventually(lambda: is_there(bridge, fix), "the node is there")
        bridge.open_source(fix, stream(bridge, fix), collector.deliver)
        message: Any = collector.wait(1)[0]
        assert list(message["position_covariance"]) == list(range(9))

    def test_services_are_called_and_served(self, bridge: Bridge) -> None:
        for data in (True, False):
            reply = bridge.call(at(Role.SERVICE, "/behind/set"), {"data": data})
            assert reply == {"success": data, "message": f"data is {data}"}
        offered = at(Role.SERVICE, "/ours/set", self.set_bool, peer="optional")
        channel = bridge.serve(
            offered, lambda request: {"success": request["data"], "message": "ours"}
        )
        called = at(Role.SERVICE, "/ours/set")
        eventually(lambda: is_there(bridge, called), "the service is there")
        assert bridge.call(called, {"data": True}) == {"success": True, "message": "ours"}
        channel.close()

    def test_parameters_are_read_watched_and_set(self, bridge: Bridge) -> None:
        speed, collector = at(Role.OUTPUT, self.parameter, "parameter"), Collector()
        structure = stream(bridge, speed)
        sink = bridge.open_sink(at(Role.INPUT, self.parameter, "parameter"), structure)
        sink.send(7)
        bridge.open_source(speed, structure, collector.deliver)
        assert collector.wait(1) == [7]
        sink.send(9)
        assert collector.wait(2) == [7, 9]
