"""Fixtures for the tests of applications and components, which pytest finds by itself.

Nothing of uoarm's is imported before a test asks for it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from uoarm import RobotManager
    from uoarm.bridge import Bridge, Channel, Handler
    from uoarm.model import Schema
    from uoarm.testing import Emitter, Hang, MemoryBridge, MemoryService, Taker


class FakeComponents:
    """Makes components in memory, each providing a function of its own name."""

    def __init__(self, bridge: MemoryBridge) -> None:
        self._bridge = bridge
        self._ports: dict[str, dict[str, Any]] = {}

    def output(self, function: str, schema: Schema, *, latched: bool = False) -> Emitter:
        """Make a component that the test has emit messages."""
        self._add(function, "output")
        return self._bridge.emitter(function, schema, latched=latched)

    def input(self, function: str, schema: Schema) -> Taker:
        """Make a component whose messages the test reads, fed by the application."""
        self._add(function, "input")
        return self._bridge.taker(function, schema)

    def service(
        self, function: str, request: Schema, reply: Schema, answer: Handler
    ) -> MemoryService:
        """Make a component with a service that a function of the test answers."""
        self._add(function, "service")
        return self._bridge.service(function, request, reply, answer)

    def configuration(self) -> str:
        """Return the configuration of a robot that has these components."""
        functions = {
            name: {"components": [{"name": name, "bridge": self._bridge.name, **ports}]}
            for name, ports in self._ports.items()
        }
        bridges = {self._bridge.name: {"plugin": "memory"}}
        return json.dumps({"version": 1, "bridges": bridges, "functions": functions})

    def _add(self, function: str, port: str) -> None:
        self._ports[function] = {port: {"endpoint": [function]}}


class Robots:
    """Starts robot managers over the memory bridge, closed when the test ends."""

    def __init__(self, bridge: MemoryBridge, fakes: FakeComponents, stack: ExitStack) -> None:
        self._bridge = bridge
        self._fakes = fakes
        self._stack = stack

    def __call__(self, configuration: str | None = None) -> RobotManager:
        """Start a manager.

        Args:
            configuration: YAML, whose bridge `memory` is the test's; None: the fake components.

        Raises:
            ConfigurationError: the configuration is wrong.
        """
        from uoarm import RobotManager  # noqa: PLC0415 - see the module
        from uoarm.config import loads  # noqa: PLC0415

        text = self._fakes.configuration() if configuration is None else configuration
        bridges: dict[str, Bridge] = {self._bridge.name: self._bridge}
        return self._stack.enter_context(RobotManager(loads(text), bridges=bridges))


class Faults:
    """Has steps of a bridge or channel fail from here to the end of the test."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack

    def raising(self, subject: Bridge | Channel, step: str, error: BaseException) -> None:
        """Have a step raise."""
        self._begin("raising", subject, step, error)

    def hanging(self, subject: Bridge | Channel, step: str) -> Hang:
        """Have a step hang until its `release`."""
        return self._begin("hanging", subject, step)  # type: ignore[no-any-return] # by its name

    def lying(self, subject: Bridge | Channel, step: str, answer: object) -> None:
        """Have a step return something else."""
        self._begin("lying", subject, step, answer)

    def _begin(self, fault: str, *given: Any) -> Any:
        from uoarm import testing  # noqa: PLC0415 - see the module

        begun: AbstractContextManager[Any] = getattr(testing, fault)(*given)
        return self._stack.enter_context(begun)


@pytest.fixture
def memory_bridge() -> Iterator[MemoryBridge]:
    """A bridge named `memory` whose components the test plays; closed after the test."""
    from uoarm.testing import MemoryBridge  # noqa: PLC0415 - see the module

    made = MemoryBridge("memory", {})
    yield made
    made.close()


@pytest.fixture
def fake_component(memory_bridge: MemoryBridge) -> FakeComponents:
    """Makes components: `output`, `input`, `service`."""
    return FakeComponents(memory_bridge)


@pytest.fixture
def robot(memory_bridge: MemoryBridge, fake_component: FakeComponents) -> Iterator[Robots]:
    """Starts a robot manager: `robot()` has the fake components, `robot(yaml)` what it says."""
    with ExitStack() as stack:
        yield Robots(memory_bridge, fake_component, stack)


@pytest.fixture
def faults() -> Iterator[Faults]:
    """Faults that last until the test ends: `raising`, `hanging`, `lying`."""
    with ExitStack() as stack:
        yield Faults(stack)
