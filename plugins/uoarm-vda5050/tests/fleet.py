"""What the tests share: bridges, endpoints, and vehicles with a drive that arrives at once."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from brokers import Broker
from uoarm_vda5050.vehicle import Act, Drive, Task, Vehicle

from uoarm.bridge import Bridge, Registry
from uoarm.model import BridgeSpec, Endpoint, Role
from uoarm.testing import patience

MAKER = "uoa"
_PARTS = {"goal": Role.INPUT, "cancel": Role.INPUT}


def endpoint(serial: str, topic: str, *part: str, **options: Any) -> Endpoint:
    """An endpoint of a vehicle, with the role that its topic has."""
    role = {"order": Role.INPUT, "instantActions": Role.INPUT}.get(topic, Role.OUTPUT)
    if topic == "transport":
        role = _PARTS.get(part[0], Role.OUTPUT) if part else Role.SERVICE
    return Endpoint("fleet", serial, role, (MAKER, serial, topic, *part), options=options)


@contextmanager
def bridge_to(broker: Broker, **options: Any) -> Iterator[Bridge]:
    limits = {"retained_wait": 0, "accept_timeout": patience(), "state_timeout": patience()}
    spec = BridgeSpec("fleet", "vda5050", {"url": broker.url, **limits, **options})
    made = Registry().create(spec)
    try:
        yield made
    finally:
        made.close(timeout=patience())


def goal(*nodes: str, order: str = "", **actions: str) -> dict[str, Any]:
    """A transport order over nodes; actions by node."""
    made: dict[str, Any] = {"nodes": [{"nodeId": name} for name in nodes]}
    for node in made["nodes"]:
        if node["nodeId"] in actions:
            node["actions"] = [{"actionType": actions[node["nodeId"]]}]
    return {**made, "orderId": order} if order else made


class Driver:
    """Drives a vehicle in a thread; stands before whatever `holds` names."""

    def __init__(self, vehicle: Vehicle, *holds: str) -> None:
        self.vehicle = vehicle
        self.done: list[str] = []
        self._holds = set(holds)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def let(self, name: str) -> None:
        self._holds.discard(name)

    def close(self) -> None:
        self._ended.set()
        self._thread.join(patience())

    def _run(self) -> None:
        while not self._ended.wait(0.01):
            task = self.vehicle.task
            name = _name(task)
            is_held = name in self._holds
            self.vehicle.set(driving=isinstance(task, Drive) and is_held)
            if task is None or is_held:
                continue
            ended = self.vehicle.finished if isinstance(task, Act) else self.vehicle.reached
            if ended(task):
                self.done.append(name)


def _name(task: Task | None) -> str:
    if task is None:
        return ""
    return task.node_id if isinstance(task, Drive) else task.action_type


@contextmanager
def driven(broker: Broker, serial: str, *holds: str, **more: Any) -> Iterator[Driver]:
    """A vehicle that is driven while a block runs."""
    more.setdefault("actions", ("pick", "drop"))
    with Vehicle(broker.url, MAKER, serial, **more) as vehicle:
        vehicle.set(position=(0.0, 0.0, 0.0, "floor"))
        driver = Driver(vehicle, *holds)
        try:
            yield driver
        finally:
            driver.close()
